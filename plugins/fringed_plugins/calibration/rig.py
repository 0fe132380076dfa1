"""A calibrated rig as kernels want it, and the rays of its camera.

Owns the pinhole with Brown distortion: its inverse for the camera's pixels, computed once for each
lens and kept, and the projector's axes, swapped where the phase counts rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.calibration.recent import Recent, key_of
from fringed_plugins.parallel import run_rows

Float64Array = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]

_KEPT_LENSES = 4
_NEWTON_STEPS = 12
_rays = Recent[Float32Array](_KEPT_LENSES)


@dataclass(frozen=True)
class Pinhole:
    """A lens: `matrix` (3, 3) px, `distortion` (5,) k1, k2, p1, p2, k3, and its picture's size."""

    width_px: int
    height_px: int
    matrix: Float64Array
    distortion: Float64Array

    @property
    def key(self) -> bytes:
        """Bytes that tell this lens from others."""
        return key_of(self.width_px, self.height_px, np.asarray(self.matrix), np.asarray(self.distortion))


class Axis(NamedTuple):
    """The projector as seen along the axis that the phase counts, for kernels; all float64.

    With X the point on a camera ray and w = 1/z, the projector's normalised coordinates are
    (rotation @ ray + w translation), first two over the third; the first runs along the axis.
    """

    rotation: Float64Array  # (3, 3)
    translation: Float64Array  # (3,)
    focal_px: float
    centre_px: float
    distortion: Float64Array  # (5,) k1, k2, p1, p2, k3 with p1 and p2 swapped for rows


def fixed(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a C-ordered read-only view, so that one compiled kernel serves all callers."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def projector_axis(projector: Pinhole, T_projector_camera: Float64Array, orientation: str) -> Axis:
    """Return the projector's axis for phases that count "columns" or "rows".

    Swapping x and y leaves Brown's model as it is, but for p1 and p2, which change places.

    Raises
    ------
    ValueError
        a sheared projector matrix, or a transform that is no rigid motion.
    """
    matrix = np.asarray(projector.matrix, np.float64) / projector.matrix[2, 2]
    if abs(matrix[0, 1]) > 1e-9 * abs(matrix[0, 0]) or abs(matrix[1, 0]) > 1e-9 * abs(matrix[1, 1]):
        raise ValueError(
            f"the projector's matrix has shear ({matrix[0, 1]:g}, {matrix[1, 0]:g}); it must be 0: calibrate without it"
        )
    rotation, translation = T_projector_camera[:3, :3], T_projector_camera[:3, 3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise ValueError("T_projector_camera holds no rotation; its first three rows and columns must be orthonormal")
    k1, k2, p1, p2, k3 = projector.distortion
    order = [0, 1, 2]
    if orientation == "rows":
        order, p1, p2 = [1, 0, 2], p2, p1
    along = order[0]
    return Axis(
        np.ascontiguousarray(rotation[order], np.float64),
        np.ascontiguousarray(translation[order], np.float64),
        float(matrix[along, along]),
        float(matrix[along, 2]),
        np.array([k1, k2, p1, p2, k3], np.float64),
    )


def sensitivity(axis: Axis) -> float:
    """Return how much of the baseline lies along the axis, 0 to 1, as seen by the projector's lens.

    With all of it across, a column's light meets a camera ray nowhere or everywhere.
    """
    ahead = axis.rotation @ np.array([0.0, 0.0, 1.0])
    t = axis.translation
    along = abs(ahead[0] * t[2] - t[0] * ahead[2])
    across = abs(ahead[1] * t[2] - t[1] * ahead[2])
    total = float(np.hypot(along, across))
    return float(along / total) if total > 0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _undistort_rows(start: int, stop: int, inverse: Any, distortion: Any, rays: Any) -> None:
    k1, k2, p1, p2, k3 = distortion
    for row in range(start, stop):
        for column in range(rays.shape[2]):
            xd = inverse[0, 0] * column + inverse[0, 1] * row + inverse[0, 2]
            yd = inverse[1, 0] * column + inverse[1, 1] * row + inverse[1, 2]
            x, y = xd, yd
            for _ in range(_NEWTON_STEPS):
                r2 = x * x + y * y
                radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
                slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)
                fx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - xd
                fy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - yd
                a = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
                b = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
                d = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
                determinant = a * d - b * b
                dx, dy = (d * fx - b * fy) / determinant, (a * fy - b * fx) / determinant
                x -= dx
                y -= dy
                if abs(dx) + abs(dy) < 1e-13:
                    break
            # Beyond the fold of a distortion there may be another, mirrored solution.
            good = abs(fx) + abs(fy) < 1e-9 and determinant > 0 and a + d > 0
            rays[0, row, column] = np.float32(x) if good else np.float32(np.nan)
            rays[1, row, column] = np.float32(y) if good else np.float32(np.nan)


def camera_rays(camera: Pinhole, threads: int = 0) -> Float32Array:
    """Return x and y of every pixel's ray at z = 1, (2, height, width) float32, without distortion.

    The last few lenses' rays are kept. Pixels at which the distortion has no inverse are NaN.
    """
    return _rays.get(camera.key, lambda: _camera_rays(camera, threads))


def _camera_rays(camera: Pinhole, threads: int) -> Float32Array:
    rays = np.empty((2, camera.height_px, camera.width_px), np.float32)
    inverse = np.linalg.inv(np.asarray(camera.matrix, np.float64))
    coefficients = tuple(float(c) for c in camera.distortion)
    run_rows(_undistort_rows, camera.height_px, inverse, coefficients, rays, threads=threads)
    rays.flags.writeable = False
    return rays
