"""Absolute phase and a calibrated rig to points in millimetres.

Owns the choice of tolerances; the loops are in `triangulate_kernel`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration import triangulate_kernel as kernel
from fringed_plugins.calibration.depth_kernel import STEREO, PixelForm, Stereo
from fringed_plugins.calibration.rig import Axis, Pinhole, camera_rays, fixed
from fringed_plugins.calibration.stereo import stereo_of
from fringed_plugins.calibration.triangulate_kernel import Spread
from fringed_plugins.parallel import run_rows

Float32Array = npt.NDArray[np.float32]
UInt8Array = npt.NDArray[np.uint8]
UInt16Array = npt.NDArray[np.uint16]


_NO_MAP: Float32Array = fixed(np.empty((0, 0), np.float32))
_NO_TABLE: Float32Array = fixed(np.empty((3, 0, 0), np.float32))
_NO_FORM = PixelForm(STEREO, _NO_TABLE, np.zeros(4), 1.0, 0.0)
_NO_STEREO = Stereo(np.eye(3), np.zeros(3), np.zeros(5), 1.0, 0.0, 1)


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


class Measured(NamedTuple):
    """What is known of every pixel (height, width): phase NaN where `rejected`, and float32 maps that may lack."""

    phase_rad: Float32Array
    rejected: UInt16Array
    sigma_rad: Float32Array | None = None
    background: Float32Array | None = None


def triangulate(
    measured: Measured,
    camera: Pinhole,
    axis: Axis,
    fringes: tuple[float, float],
    *,
    tolerances: Tolerances = Tolerances(),
    spread: Float32Array | None = None,
    threads: int = 0,
) -> Points:
    """Return where each camera ray meets the surface of its projector column (or row).

    The phase is absolute, `fringes` (period_px, initial_rad). Both lenses' distortions are exact: no plane stands for
    a distorted column. `sigma_mm` is |dX/dphase| sigma_rad, NaN without `sigma_rad`, and with `spread`
    (`pixel.spread.spread_table`) the root of the sum of its square and of what the calibration leaves.

    References
    ----------
    Zhang & Huang 2006 (the projector as an inverse camera).
    """
    left = Spread(np.float32(0), spread if spread is not None else _NO_TABLE)
    return _points(measured, camera, (stereo_of(camera, axis, fringes), _NO_FORM), left, (tolerances, threads))


def triangulate_pixels(
    measured: Measured,
    camera: Pinhole,
    form: PixelForm,
    *,
    scatter_mm: float = 0.0,
    tolerances: Tolerances = Tolerances(),
    threads: int = 0,
) -> Points:
    """Return the points that a model of each pixel has for its phase; otherwise as `triangulate`.

    `scatter_mm` is what the model leaves along the ray.
    """
    left = Spread(np.float32(scatter_mm**2), _NO_TABLE)
    return _points(measured, camera, (_NO_STEREO, form), left, (tolerances, threads))


def _points(
    measured: Measured, camera: Pinhole, models: tuple[Stereo, PixelForm], left: Spread,
    wanted: tuple[Tolerances, int],
) -> Points:  # fmt: skip
    tolerances, threads = wanted
    shape = measured.phase_rad.shape
    noise = fixed(measured.sigma_rad) if measured.sigma_rad is not None else _NO_MAP
    maps = (camera_rays(camera, threads), fixed(measured.phase_rad), noise, fixed(measured.rejected))
    light = fixed(measured.background) if measured.background is not None else _NO_MAP
    keeping = _keeping(tolerances, camera)
    factor, most = _global((*maps, light), (*models, keeping))
    keeping = keeping._replace(most_mm=most)
    points = Points(
        np.empty((*shape, 3), np.float32), np.empty(shape, np.float32), np.empty(shape, np.uint16),
        np.empty(shape, np.uint8),
    )  # fmt: skip
    out = (points.xyz_mm.reshape(shape[0], -1), points.sigma_mm, points.rejected, points.intensity)
    run_rows(kernel.point_rows, shape[0], maps, (*models, keeping), (light, factor, left), out, threads=threads)
    return points


def _keeping(tolerances: Tolerances, camera: Pinhole) -> kernel.Keeping:
    """Return what the kernels keep; `most_mm`, for now, as a multiple of the median."""
    focal_px = float(np.sqrt(abs(camera.matrix[0, 0] * camera.matrix[1, 1])) / abs(camera.matrix[2, 2]))
    return kernel.Keeping(
        near_mm=np.float32(tolerances.near_mm),
        far_mm=np.float32(tolerances.far_mm),
        most_mm=np.float32(np.inf if tolerances.flyers else tolerances.sigma_ratio),
        per_depth=np.float32(1 / focal_px),
        bend_px=np.float32(tolerances.bend_px),
        step_px=np.float32(tolerances.step_px),
        sigmas=np.float32(tolerances.sigmas * np.sqrt(6)),
        active=not tolerances.flyers,
    )


def _global(maps: Any, models: Any) -> tuple[np.float32, np.float32]:
    """Return what brings nearly the brightest point to 255, and the largest deviation by noise of a point.

    Both come from about twenty thousand pixels, evenly spread.
    """
    stereo, pixels, keeping = models
    rays, phase, noise, rejected, light = (_sample(image) for image in maps)
    depth, deviation = np.empty(phase.shape, np.float32), np.empty(phase.shape, np.float32)
    sparse = pixels._replace(coefficients=_sample(pixels.coefficients))
    measured = (rays, phase, noise, rejected)
    kernel.depth_rows(0, len(depth), measured, (stereo, sparse, keeping), (depth, deviation))
    seen = np.isfinite(depth)
    known = deviation[np.isfinite(deviation)]
    most = np.float32(keeping.most_mm * np.median(known)) if known.size else np.float32(np.inf)
    white = float(np.percentile(light[seen], 99.5)) if light.size > 0 and seen.any() else 0.0
    return np.float32(255 / white if white > 0 else 0.0), most


def _sample(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return about twenty thousand pixels (..., rows, columns), evenly spread."""
    step = max(1, int(np.sqrt(image.shape[-2] * image.shape[-1] / 20_000)))
    return fixed(image[..., ::step, ::step])
