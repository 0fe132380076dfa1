"""Models of each pixel: points as a function of the phase, fitted to planes whose places are known.

Owns the choice of scales and tolerances, and what is said of a fit; the loops are in `fit_kernel`. The projector is
not modelled: whatever its lens does, a pixel sees as a smooth curve from phase to depth. Between the planes it is as
good as their phases and places are, beyond them nothing is known.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.pixel.fit_kernel import MOST_TERMS, Wanted, fit_rows
from fringed_plugins.calibration.rig import Pinhole, camera_rays, fixed
from fringed_plugins.parallel import run_rows

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

_SAMPLE = 30_000
_DEVIATIONS = 6.0
_ROUNDING_MM = 1e-3
_FEWEST = 0.01


class PixelFit(NamedTuple):
    """Coefficients (k, height, width) float64, NaN in holes, of p = (phase - offset_rad) scale, and how good they are.

    Depths are known from `near_mm` to `far_mm`, as the median pixel has them. `scatter_mm` is that of the planes along
    the ray, NaN where there are no more planes than coefficients; `sigma_mm` what of it is the model's.
    """

    coefficients: Float64Array
    offset_rad: float
    scale: float
    near_mm: float
    far_mm: float
    scatter_mm: float
    sigma_mm: float


class Planes(NamedTuple):
    """What was seen of planes: `phase_rad` (k, height, width) float32, NaN where nothing; `equations` (k, 4).

    An equation nx, ny, nz, d means n . X = d in the camera's frame, mm. `sigma_rad` as the phase, where it is known.
    """

    phase_rad: Float32Array
    equations: Float64Array
    sigma_rad: Float32Array | None = None


def fit_rational(planes: Planes, camera: Pinhole, threads: int = 0) -> PixelFit:
    """Return a, b and c of z = (a + b p) / (1 + c p) for each pixel, from 3 planes or more.

    Without distortion of the projector that is exact at every depth. With 5 planes or more, one whose phase is wrong
    at a pixel is found and left out there; with 4 the pixel becomes a hole.

    Raises
    ------
    ValueError
        too few planes, planes at one depth, or pictures of another size than the camera's.

    References
    ----------
    thesis.md, section 3: for a fixed rig X, Y and Z are rational in the phase; Sanathanan & Koerner 1963.

    Examples
    --------
    >>> camera = Pinhole(4, 3, np.array([[100.0, 0, 1.5], [0, 100, 1], [0, 0, 1]]), np.zeros(5))
    >>> depths = np.array([900.0, 1000.0, 1100.0])
    >>> phase = np.ones((3, 3, 4), np.float32) * (1e5 / depths).astype(np.float32)[:, None, None]
    >>> fit = fit_rational(Planes(phase, np.array([[0, 0, 1.0, z] for z in depths])), camera)
    >>> a, b, c = fit.coefficients[:, 1, 2]
    >>> p = (1e5 / 950.0 - fit.offset_rad) * fit.scale
    >>> round(float((a + b * p) / (1 + c * p)), 3)
    950.0
    """
    _check(planes, camera, 3, "rational")
    low, high, rising = _extent(planes, camera)
    # The pole is where a pixel's ray meets infinity, past its far end: p starts at the other end of the picture.
    offset, scale = (low, 1 / (high - low)) if rising else (high, 1 / (high - low))
    return _fit(planes, camera, Wanted(True, 3, offset, scale, np.inf), threads)


def fit_polynomial(planes: Planes, camera: Pinhole, degree: int, threads: int = 0) -> PixelFit:
    """Return the coefficients of X, Y and Z, polynomials of p of `degree` 1 to 5, the lowest power first.

    Raises
    ------
    ValueError
        a degree that is not offered, and as `fit_rational`, with degree + 1 planes or more.

    References
    ----------
    thesis.md, section 3 (the empirical model).
    """
    if not 1 <= degree < MOST_TERMS:
        raise ValueError(f"the degree is {degree}; 1 to {MOST_TERMS - 1} are offered")
    _check(planes, camera, degree + 1, f"polynomial of degree {degree}")
    low, high, _ = _extent(planes, camera)
    wanted = Wanted(False, degree + 1, (low + high) / 2, 2 / (high - low), np.inf)
    fit = _fit(planes, camera, wanted, threads)
    x, y = camera_rays(camera, threads).astype(np.float64)
    return fit._replace(coefficients=np.concatenate([x * fit.coefficients, y * fit.coefficients, fit.coefficients]))


def depth_of(fit: PixelFit, phase_rad: npt.NDArray[Any], rational: bool) -> tuple[Float64Array, Float64Array]:
    """Return depths (mm) and their derivatives by phase (mm/rad) of phases (..., height, width)."""
    p = (np.asarray(phase_rad, np.float64) - fit.offset_rad) * fit.scale
    if rational:
        a, b, c = fit.coefficients
        with np.errstate(divide="ignore", invalid="ignore"):
            return (a + b * p) / (1 + c * p), fit.scale * (b - a * c) / (1 + c * p) ** 2
    depth, slope = np.zeros_like(p), np.zeros_like(p)
    for part in fit.coefficients[::-1]:
        slope = slope * p + depth
        depth = depth * p + part
    return depth, fit.scale * slope


def thinned(maps: npt.NDArray[Any]) -> Any:
    """Return the index of some pixels, evenly spread, of maps (..., height, width)."""
    step = max(1, int(np.sqrt(maps.shape[-2] * maps.shape[-1] / _SAMPLE)))
    return (..., slice(step // 2, None, step), slice(step // 2, None, step))


def sampled(planes: Planes, camera: Pinhole) -> tuple[Planes, Float32Array, Float64Array]:
    """Return some of the pixels, their rays (2, rows, columns) and the planes' depths there (k, rows, columns)."""
    every = thinned(planes.phase_rad)
    rays = camera_rays(camera)[every]
    known = planes.sigma_rad[every] if planes.sigma_rad is not None else None
    slope = np.tensordot(planes.equations[:, :3], np.concatenate([rays, np.ones_like(rays[:1])]).astype(np.float64), 1)
    with np.errstate(divide="ignore"):
        depth = planes.equations[:, 3, None, None] / slope
    return planes._replace(phase_rad=planes.phase_rad[every], sigma_rad=known), rays, depth


def _check(planes: Planes, camera: Pinhole, terms: int, what: str) -> None:
    count = len(planes.equations)
    if planes.phase_rad.shape != (count, camera.height_px, camera.width_px):
        raise ValueError(
            f"{count} planes and phases of shape {planes.phase_rad.shape}; a camera of {camera.width_px} x "
            f"{camera.height_px} px has ({count}, {camera.height_px}, {camera.width_px})"
        )
    if count < terms:
        raise ValueError(f"{count} planes; a {what} model of each pixel takes {terms} or more")
    _, _, depth = sampled(planes, camera)
    middle = np.sort(np.nanmedian(np.where(np.isfinite(depth), depth, np.nan), axis=(1, 2)))
    apart = 1 + np.count_nonzero(np.diff(middle) > 1e-4 * abs(middle[-1]))
    if apart < terms:
        raise ValueError(
            f"the {count} planes stand at {apart} different depths ({', '.join(f'{z:.1f}' for z in middle)} mm); a "
            f"{what} model takes {terms} or more"
        )


def _extent(planes: Planes, camera: Pinhole) -> tuple[float, float, bool]:
    """Return the smallest and the largest phase, and whether depth rises with it."""
    few, _, depth = sampled(planes, camera)
    order = np.argsort(np.nanmedian(depth, axis=(1, 2)))
    with np.errstate(invalid="ignore"):
        rise = few.phase_rad[order[1:]] - few.phase_rad[order[:-1]]
    if not np.isfinite(rise).any():
        raise ValueError("no pixel sees two neighbouring planes; show every plane to the whole picture")
    low, high = float(np.nanmin(few.phase_rad)), float(np.nanmax(few.phase_rad))
    return low, high, bool(np.nanmedian(rise) > 0)


def _fit(planes: Planes, camera: Pinhole, wanted: Wanted, threads: int) -> PixelFit:
    """Fit twice: some pixels with all planes, which tells how they scatter, then every pixel without those beyond."""
    few, rays, depth = sampled(planes, camera)
    equations = fixed(np.asarray(planes.equations, np.float64))
    first = np.empty((wanted.terms, *rays.shape[1:]))
    fit_rows(0, rays.shape[1], (fixed(few.phase_rad), fixed(rays), equations), wanted, first)
    spare = len(equations) - wanted.terms
    fit = PixelFit(first, wanted.offset_rad, wanted.scale, np.nan, np.nan, np.nan, 0.0)
    if spare > 0:
        off = depth - depth_of(fit, few.phase_rad, wanted.rational)[0]
        usual = float(np.nanmedian(np.sqrt(np.nansum(off**2, axis=0) / spare)[np.isfinite(first[0])]))
        wanted = wanted._replace(tolerance_mm=_DEVIATIONS * usual + _ROUNDING_MM)
    found = np.empty((wanted.terms, camera.height_px, camera.width_px))
    seen = (fixed(planes.phase_rad), camera_rays(camera, threads), equations)
    run_rows(fit_rows, camera.height_px, seen, wanted, found, threads=threads)
    share = float(np.isfinite(found[0]).mean())
    if share < _FEWEST:
        raise ValueError(
            f"only {share:.1%} of the pixels have a curve through {wanted.terms} planes or more; show every plane to "
            "the whole picture, and check that each phase belongs to its plane"
        )
    return _judged(fit._replace(coefficients=found), planes, camera, wanted)


def _judged(fit: PixelFit, planes: Planes, camera: Pinhole, wanted: Wanted) -> PixelFit:
    """Return the fit with its range of depths, and how well its planes lie on it."""
    few, rays, depth = sampled(planes, camera)
    thin = fit._replace(coefficients=fit.coefficients[thinned(fit.coefficients)])
    found, slope = depth_of(thin, few.phase_rad, wanted.rational)
    length = np.sqrt(1 + rays[0].astype(np.float64) ** 2 + rays[1] ** 2)
    off = np.abs(found - depth)
    used = np.isfinite(off) & (off <= wanted.tolerance_mm)
    seen = np.where(used, depth, np.nan)[:, used.any(axis=0)]
    near, far = float(np.median(np.nanmin(seen, axis=0))), float(np.median(np.nanmax(seen, axis=0)))
    free = 1 - wanted.terms * np.count_nonzero(used.any(axis=0)) / np.count_nonzero(used)
    if free < 1e-3:
        return fit._replace(near_mm=near, far_mm=far)
    scatter = float(np.mean(np.square(off * length)[used]) / free)
    noise = 0.0
    if few.sigma_rad is not None:
        spread = np.square(slope * length * few.sigma_rad)[used]
        noise = min(float(np.nanmean(spread)), scatter)
    # Noise is averaged over the planes; what the curve cannot follow is not.
    left = scatter - noise * free
    return fit._replace(near_mm=near, far_mm=far, scatter_mm=float(np.sqrt(scatter)), sigma_mm=float(np.sqrt(left)))
