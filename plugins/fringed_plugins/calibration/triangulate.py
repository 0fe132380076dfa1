"""Absolute phase and a calibrated rig to points in millimetres.

Owns the choice of tolerances; the loops are in `triangulate_kernel`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration import triangulate_kernel as kernel
from fringed_plugins.calibration.rig import Axis, Pinhole, camera_rays
from fringed_plugins.parallel import run_rows

Float32Array = npt.NDArray[np.float32]
UInt8Array = npt.NDArray[np.uint8]
UInt16Array = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class Tolerances:
    """Which points are kept.

    Depths outside `near_mm` to `far_mm` are dropped. A point is a flyer where it departs from the line
    through its two neighbours by more than `bend_px` (pixels on the object) and `sigmas` standard
    deviations, or from the next one by more than `step_px`, on both sides along its row or its column;
    `step_px` is the steepest slope, tan of the angle of incidence. `flyers=True` keeps them. Points whose
    deviation is above `sigma_ratio` times the median are as good as flyers: grazing, hardly lit.
    """

    near_mm: float = 0.0
    far_mm: float = float("inf")
    bend_px: float = 1.5
    step_px: float = 8.0
    sigmas: float = 4.0
    sigma_ratio: float = 7.0
    flyers: bool = False


class Points(NamedTuple):
    """Points (height, width, 3) float32 mm, deviation along the ray, mask and intensity."""

    xyz_mm: Float32Array
    sigma_mm: Float32Array
    rejected: UInt16Array
    intensity: UInt8Array


def triangulate(
    phase_rad: Float32Array,
    rejected: UInt16Array,
    camera: Pinhole,
    axis: Axis,
    fringes: tuple[float, float],
    *,
    sigma_rad: Float32Array | None = None,
    background: Float32Array | None = None,
    tolerances: Tolerances = Tolerances(),
    threads: int = 0,
) -> Points:
    """Return where each camera ray meets the surface of its projector column (or row).

    `phase_rad` (height, width) is absolute and NaN where `rejected`; `fringes` is (period_px,
    initial_rad). Both lenses' distortions are exact: no plane stands for a distorted column.
    `sigma_mm` is |dX/dphase| sigma_rad, NaN without `sigma_rad`.

    References
    ----------
    Zhang & Huang 2006 (the projector as an inverse camera).
    """
    shape = phase_rad.shape
    rays = camera_rays(camera, threads)
    depth, sigma_mm = np.empty(shape, np.float32), np.empty(shape, np.float32)
    flags, intensity = np.empty(shape, np.uint16), np.empty(shape, np.uint8)
    xyz = np.empty((*shape, 3), np.float32)
    surfaces = kernel.Surfaces(
        fringes[0] / (2 * np.pi), float(fringes[1]), float(tolerances.near_mm), float(tolerances.far_mm)
    )
    noise = _fixed(sigma_rad) if sigma_rad is not None else _fixed(np.empty((0, 0), np.float32))
    measured = (_fixed(phase_rad), noise, _fixed(rejected))
    run_rows(
        kernel.depth_rows, shape[0], rays, measured, (axis, surfaces), (depth, sigma_mm, flags), threads=threads
    )  # fmt: skip
    light = _fixed(background if background is not None else np.zeros(shape, np.float32))
    most_mm = _largest_sigma(sigma_mm, tolerances) if sigma_rad is not None else np.float32(np.inf)
    seen = (depth, light, _brightness(light, flags), most_mm)
    out = (xyz, sigma_mm, flags, intensity)
    run_rows(kernel.point_rows, shape[0], rays, seen, _smoothness(camera, tolerances), out, threads=threads)
    return Points(xyz, sigma_mm, flags, intensity)


def _smoothness(camera: Pinhole, tolerances: Tolerances) -> kernel.Smoothness:
    focal_px = float(np.sqrt(abs(camera.matrix[0, 0] * camera.matrix[1, 1])) / abs(camera.matrix[2, 2]))
    return kernel.Smoothness(
        per_depth=np.float32(1 / focal_px),
        bend_px=np.float32(tolerances.bend_px),
        step_px=np.float32(tolerances.step_px),
        sigmas=np.float32(tolerances.sigmas * np.sqrt(6)),
        active=not tolerances.flyers,
    )


def _largest_sigma(sigma_mm: Float32Array, tolerances: Tolerances) -> np.float32:
    sample = _sample(sigma_mm)
    sample = sample[np.isfinite(sample)]
    if tolerances.flyers or not sample.size:
        return np.float32(np.inf)
    return np.float32(tolerances.sigma_ratio * np.median(sample))


def _sample(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return about twenty thousand pixels, evenly spread."""
    step = max(1, int(np.sqrt(image.size / 20_000)))
    return image[::step, ::step]


def _brightness(background: Float32Array, rejected: UInt16Array) -> np.float32:
    """Return the factor that brings nearly the brightest kept pixel to 255."""
    sample = _sample(background)[_sample(rejected) == 0]
    white = float(np.percentile(sample, 99.5)) if sample.size else 0.0
    return np.float32(255 / white if white > 0 else 0.0)


def _fixed(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a read-only view, so that one compiled kernel serves all callers."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view
