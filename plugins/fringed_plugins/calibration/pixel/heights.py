"""The thesis's reference-plane model, fitted: h = L dphi / (dphi + 2 pi f0 D), for each pixel or for the whole rig.

Owns the two fits. With L and 2 pi f0 D of each pixel's own the formula holds for every rig without distortion of the
projector; with one L and one D for all, only where camera and projector stand side by side and look the same way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.pixel.fit import PixelFit, Planes, sampled, thinned
from fringed_plugins.calibration.rig import Pinhole, camera_rays

Float64Array = npt.NDArray[np.float64]

_STRAIGHT = 1e-9  # the least curvature, for a formula that cannot be a straight line
_ROUNDS = 8
_DEVIATIONS = 5.0


class Rig(NamedTuple):
    """What the thesis calls L and D (mm) and f0 (periods per mm on the reference plane)."""

    distance_mm: float
    baseline_mm: float
    frequency_per_mm: float


def heights_of_pixels(fit: PixelFit, camera: Pinhole, plane: Float64Array, threads: int = 0) -> PixelFit:
    """Return L, 2 pi f0 D and the plane's phase of each pixel from its rational curve (`fit.fit_rational`).

    `plane` (nx, ny, nz, d) is where h = 0, n towards the camera. p of the result is in radians, from the middle of the
    plane's phases.

    References
    ----------
    thesis.md, section 3, eqs. 3.2-3.7.
    """
    x, y = camera_rays(camera, threads).astype(np.float64)
    facing = plane[0] * x + plane[1] * y + plane[2]
    a, b, c = fit.coefficients
    at_zero, rise = facing * a - plane[3], facing * b - plane[3] * c
    with np.errstate(divide="ignore", invalid="ignore"):
        bent = np.where(np.abs(c) < _STRAIGHT, np.copysign(_STRAIGHT, c), c)
        of_plane = -at_zero / rise
        distance, product = rise / bent, (of_plane + 1 / bent) / fit.scale
        phase = of_plane / fit.scale + fit.offset_rad
    middle = float(np.nanmedian(phase))
    return fit._replace(coefficients=np.stack([distance, product, phase - middle]), offset_rad=middle, scale=1.0)


def heights_of_rig(
    heights: PixelFit, planes: Planes, camera: Pinhole, plane: Float64Array
) -> tuple[PixelFit, Rig]:  # fmt: skip
    """Return `heights` with one L and one 2 pi f0 D for all pixels, and what they say of the rig.

    Raises
    ------
    ValueError
        planes of one height.
    """
    few, rays, depth = sampled(planes, camera)
    thin = heights.coefficients[thinned(heights.coefficients)]
    difference = few.phase_rad.astype(np.float64) - heights.offset_rad - thin[2]
    facing = plane[0] * rays[0].astype(np.float64) + plane[1] * rays[1] + plane[2]
    height = facing * depth - plane[3]
    good = np.isfinite(difference) & np.isfinite(height)
    along = np.sqrt(1 + rays[0].astype(np.float64) ** 2 + rays[1] ** 2) / np.abs(facing)
    d, h, length = difference[good], height[good], np.broadcast_to(along, height.shape)[good]
    distance, product = _line(d, h)
    curve = distance * d / (d + product)
    scatter = float(np.sqrt(np.mean(np.square((curve - h) * length))))
    coefficients = heights.coefficients.copy()
    holes = ~np.isfinite(coefficients[2])
    coefficients[0], coefficients[1] = distance, product
    coefficients[:, holes] = np.nan
    frequency = _frequency(thin[2], rays.astype(np.float64), plane)
    rig = Rig(distance, abs(product) / (2 * np.pi * frequency), frequency)
    return heights._replace(coefficients=coefficients, scatter_mm=scatter, sigma_mm=scatter), rig


def _line(d: Float64Array, h: Float64Array) -> tuple[float, float]:
    """Return L and K of h = L d / (d + K), by L d - K h = h d, weighted, without what is far off."""
    if np.ptp(h) < 1e-3 * max(float(np.abs(h).max()), 1.0):
        raise ValueError(f"the planes are all of one height, {np.median(h):.2f} mm; show planes at several heights")
    weight = np.ones_like(d)
    distance, product = 0.0, 0.0
    for _ in range(_ROUNDS):
        rows = np.stack([d, -h], -1) * weight[:, None]
        (distance, product), *_ = np.linalg.lstsq(rows, h * d * weight, rcond=None)
        below = d + product
        off = np.abs(distance * d / below - h)
        near = off <= _DEVIATIONS * 1.4826 * np.median(off) + 1e-6
        weight = np.where(near, 1 / np.abs(below), 0.0)
    return float(distance), float(product)


def _frequency(phase: Float64Array, rays: Float64Array, plane: Float64Array) -> float:
    """Return the periods per mm on the plane: how fast its phase rises, by a straight fit."""
    z = plane[3] / (plane[0] * rays[0] + plane[1] * rays[1] + plane[2])
    points = np.stack([rays[0] * z, rays[1] * z, z, np.ones_like(z)], -1)
    good = np.isfinite(phase) & np.isfinite(z)
    rise, *_ = np.linalg.lstsq(points[good], phase[good], rcond=None)
    normal = plane[:3] / np.linalg.norm(plane[:3])
    along = rise[:3] - normal * (rise[:3] @ normal)
    return float(np.linalg.norm(along) / (2 * np.pi))


def depth_of_height(fit: PixelFit, camera: Pinhole, plane: Float64Array, phase_rad: Float64Array) -> Float64Array:
    """Return the depths (mm) of phases (height, width) by the formula.

    Examples
    --------
    >>> camera = Pinhole(1, 1, np.array([[100.0, 0, 0], [0, 100, 0], [0, 0, 1]]), np.zeros(5))
    >>> one = np.ones((1, 1))
    >>> fit = PixelFit(np.stack([1000 * one, 150 * one, 0 * one]), 5.0, 1.0, 800, 1000, 0, 0)
    >>> float(depth_of_height(fit, camera, np.array([0, 0, -1.0, -1000.0]), 5.0 + 50.0 * one)[0, 0])
    750.0
    """
    x, y = camera_rays(camera).astype(np.float64)
    difference = (phase_rad - fit.offset_rad) * fit.scale - fit.coefficients[2]
    height = fit.coefficients[0] * difference / (difference + fit.coefficients[1])
    return np.asarray((plane[3] + height) / (plane[0] * x + plane[1] * y + plane[2]))
