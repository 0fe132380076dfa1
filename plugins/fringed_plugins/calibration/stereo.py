"""The stereo model as the kernels want it, with as many steps of Newton's method as this rig needs.

Owns that number: it is found on rays all over the picture, so that a lens with much distortion is exact as well.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.depth_kernel import Stereo
from fringed_plugins.calibration.pixel.derivatives import undistorted
from fringed_plugins.calibration.pixel.uncertainty import grid_pixels
from fringed_plugins.calibration.recent import Recent, key_of
from fringed_plugins.calibration.reference import axes_crossing_mm
from fringed_plugins.calibration.rig import Axis, Pinhole

Float64Array = npt.NDArray[np.float64]

_GRID = (9, 11)
_PARTS = np.linspace(0.4, 2.0, 17)  # of the depth where the rig is aimed
_BASELINES = 4.0
_EXACT = 1e-9  # of the projector's focal length; a few nanometres of depth
_MOST_STEPS = 8
_KEPT_RIGS = 8
_steps = Recent[int](_KEPT_RIGS)


def aim_mm(axis: Axis) -> float:
    """Return the depth where the rig is aimed, or a few baselines where the optical axes do not cross."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = axis.rotation, axis.translation
    try:
        return axes_crossing_mm(transform)
    except ValueError:
        return _BASELINES * float(np.linalg.norm(axis.translation))


def stereo_of(camera: Pinhole, axis: Axis, fringes: tuple[float, float]) -> Stereo:
    """Return the model for fringes of (period_px, initial_rad)."""
    scale = fringes[0] / (2 * np.pi) / axis.focal_px
    key = key_of(camera.key, axis.rotation, axis.translation, axis.distortion, axis.focal_px)
    return Stereo(
        axis.rotation,
        axis.translation,
        axis.distortion,
        scale,
        fringes[1] * scale + axis.centre_px / axis.focal_px,
        _steps.get(key, lambda: newton_steps(camera, axis)),
    )


def newton_steps(camera: Pinhole, axis: Axis) -> int:
    """Return how many steps of Newton's method undo the projector's distortion along the camera's rays, 1 to 8."""
    around_mm = aim_mm(axis)
    rays = undistorted(camera, grid_pixels(camera, _GRID)).reshape(-1, 2)
    rays = np.concatenate([rays, np.ones_like(rays[:, :1])], -1) @ axis.rotation.T
    local = rays[:, None] + axis.translation / (around_mm * _PARTS)[:, None]
    ahead = np.nanmin(local[..., 2], axis=1) > 0
    u, v = np.moveaxis(local[ahead][..., :2] / local[ahead][..., 2:], -1, 0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        steep = np.diff(v[:, ::16], axis=1) / np.diff(u[:, ::16], axis=1)
        seen = u + _displacement(axis, u, v)[0]
        found = np.zeros_like(u)
        off = []
        for _ in range(_MOST_STEPS + 1):
            off.append(np.abs(seen + found - u))
            place = seen + found
            moved, by_u, by_v = _displacement(axis, place, v + steep * (place - u))
            found = found - (found + moved) / (1 + by_u + steep * by_v)
    # Where even many steps do not arrive, the distortion has no inverse, and nothing is measured.
    solvable = off[-1] < _EXACT
    worst = [float(np.max(part[solvable], initial=0.0)) for part in off]
    return next((n for n, value in enumerate(worst) if n and value < _EXACT), _MOST_STEPS)


def _displacement(axis: Axis, u: Float64Array, v: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return how far the distortion moves u, and that by u and by v."""
    k1, k2, p1, p2, k3 = axis.distortion
    r2 = u * u + v * v
    radial = r2 * (k1 + r2 * (k2 + r2 * k3))
    twice = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    moved = u * radial + 2 * p1 * u * v + p2 * (3 * u * u + v * v)
    return moved, radial + twice * u * u + 2 * p1 * v + 6 * p2 * u, twice * u * v + 2 * p1 * u + 2 * p2 * v
