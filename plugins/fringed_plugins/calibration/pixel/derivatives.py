"""How points of a calibrated rig move with each of its numbers.

Owns the order of those numbers and the derivatives, exact for both lenses; knows nothing of how well they are known.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.rig import Pinhole

Float64Array = npt.NDArray[np.float64]

LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
STEREO = ("rx", "ry", "rz", "tx", "ty", "tz")
NUMBERS = (
    *(f"camera.{name}" for name in LENS), *(f"projector.{name}" for name in LENS), *(f"stereo.{n}" for n in STEREO)
)  # fmt: skip
_NEWTON_STEPS = 20


def lens_derivatives(lens: Pinhole, xy: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the pixels of `xy` (..., 2) at z = 1, and their derivatives by xy (..., 2, 2) and by the lens (..., 2, 9).

    The lens's numbers come in the order of `LENS`.

    Examples
    --------
    >>> lens = Pinhole(9, 9, np.array([[100.0, 0, 4], [0, 100, 4], [0, 0, 1]]), np.array([-0.1, 0, 0, 0, 0]))
    >>> pixels, by_xy, by_lens = lens_derivatives(lens, np.array([0.1, 0.0]))
    >>> pixels.round(3).tolist(), by_xy.round(3).tolist(), by_lens[0, 4].round(3).tolist()
    ([13.99, 4.0], [[99.7, 0.0], [0.0, 99.9]], 0.1)
    """
    matrix = lens.matrix / lens.matrix[2, 2]
    k1, k2, p1, p2, k3 = (float(c) for c in lens.distortion)
    x, y = xy[..., 0], xy[..., 1]
    r2, both, none = x * x + y * y, x * y, np.zeros_like(x)
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    xd = x * radial + 2 * p1 * both + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * both
    cross = slope * both + 2 * p1 * x + 2 * p2 * y
    by_xy = _matrix([
        [radial + slope * x * x + 2 * p1 * y + 6 * p2 * x, cross],
        [cross, radial + slope * y * y + 6 * p1 * y + 2 * p2 * x],
    ])  # fmt: skip
    by_distortion = _matrix([
        [x * r2, x * r2**2, 2 * both, r2 + 2 * x * x, x * r2**3],
        [y * r2, y * r2**2, r2 + 2 * y * y, 2 * both, y * r2**3],
    ])  # fmt: skip
    by_matrix = _matrix([[xd, none, none + 1, none], [none, yd, none, none + 1]])
    spread = matrix[:2, :2]
    pixels = np.stack([xd, yd], -1) @ spread.T + matrix[:2, 2]
    return pixels, spread @ by_xy, np.concatenate([by_matrix, spread @ by_distortion], -1)


def undistorted(lens: Pinhole, pixels: Float64Array) -> Float64Array:
    """Return x and y at z = 1 (..., 2) of `pixels` (..., 2); NaN where the distortion has no inverse."""
    matrix = lens.matrix / lens.matrix[2, 2]
    wanted = np.asarray(pixels, np.float64)
    xy = (wanted - matrix[:2, 2]) @ np.linalg.inv(matrix[:2, :2]).T
    for _ in range(_NEWTON_STEPS):
        found, by_xy, _ = lens_derivatives(lens, xy)
        xy = xy - solved(by_xy, (found - wanted)[..., None])[..., 0]
    found, by_xy, _ = lens_derivatives(lens, xy)
    with np.errstate(invalid="ignore"):  # beyond the fold of a distortion it may have another, mirrored solution
        upright = (np.linalg.det(by_xy) > 0) & (np.trace(by_xy, axis1=-2, axis2=-1) > 0)
        good = upright & (np.abs(found - wanted).max(axis=-1) < 1e-6)
    return np.where(good[..., None], xy, np.nan)


def solved(matrices: Float64Array, values: Float64Array) -> Float64Array:
    """Return the solutions (..., 2, n) of (..., 2, 2) equations with `values` (..., 2, n), NaN where singular."""
    a, b, c, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = _matrix([[d, -b], [-c, a]]) / (a * d - b * c)[..., None, None]
        return np.asarray(inverse @ values)


def point_derivatives(
    camera: Pinhole, projector: Pinhole, T_projector_camera: Float64Array, pixels: Float64Array, depth_mm: Any,
    *, orientation: str = "columns",
) -> tuple[Float64Array, Float64Array]:  # fmt: skip
    """Return how points X (mm) in the camera's frame move with the rig's numbers (..., 3, 24), at the same phase.

    The points lie at `depth_mm` on the rays of the camera's `pixels` (..., 2). The numbers come in the order of
    `NUMBERS`: a rotation vector (rad) comes before T_projector_camera's rotation, R' = exp(r) R. The second result
    is the projector's pixels (..., 2), NaN behind it.

    References
    ----------
    Implicit differentiation of u(theta, z) = const; Hartley & Zisserman 2004, section 5.2.
    """
    rotation, translation = T_projector_camera[:3, :3], T_projector_camera[:3, 3]
    xy = undistorted(camera, pixels)
    _, by_xy, by_lens = lens_derivatives(camera, xy)
    z = np.broadcast_to(np.asarray(depth_mm, np.float64), xy.shape[:-1])[..., None]
    ray = np.concatenate([xy, np.ones_like(z)], -1)
    turned = (ray * z) @ rotation.T
    local = np.where((turned + translation)[..., 2:] > 0, turned + translation, np.nan)
    seen, by_seen, by_projector = lens_derivatives(projector, local[..., :2] / local[..., 2:])
    axis = 0 if orientation == "columns" else 1
    gradient = _by_point(local, by_seen[..., axis, :])
    moved = np.zeros((*xy.shape[:-1], 3, len(NUMBERS)))
    moved[..., :2, :9] = -solved(by_xy, by_lens) * z[..., None]
    by_stereo = np.concatenate([np.cross(turned, gradient), gradient], -1)
    by_camera = np.einsum("...i,ij,...jk->...k", gradient, rotation, moved[..., :9])
    by_all = np.concatenate([by_camera, by_projector[..., axis, :], by_stereo], -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -by_all / np.sum(gradient * (ray @ rotation.T), -1, keepdims=True)
    return moved + ray[..., :, None] * depth[..., None, :], seen


def _by_point(local: Float64Array, by_xy: Float64Array) -> Float64Array:
    """Return the derivative (..., 3) by a point (..., 3) of what has the derivative `by_xy` (..., 2) by x/z and y/z."""
    z = local[..., 2]
    along = -(by_xy[..., 0] * local[..., 0] + by_xy[..., 1] * local[..., 1]) / z**2
    return np.stack([by_xy[..., 0] / z, by_xy[..., 1] / z, along], -1)


def _matrix(rows: list[list[Float64Array]]) -> Float64Array:
    return np.stack([np.stack(row, -1) for row in rows], -2)
