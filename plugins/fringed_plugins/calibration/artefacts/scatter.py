"""What deviations from a fitted surface say: their range, their scatter, and how sure a fit is of its numbers.

Owns the filter, the share of points that may be left out, and the blocks that uncertainties come from: neighbours
share errors, blocks of pixels hardly do.

References
----------
VDI/VDE 2634 part 2 (2012): 3 per mille of the points may be left out. Cameron & Miller 2015, section II: sums of
blocks as the covariance of a fit. Efron & Tibshirani 1993, section 8.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.artefacts.cells import box_mean

Array = npt.NDArray[Any]
LEFT_OUT = 0.003
STRAY = 6.0
_BLOCKS = 144
_LARGEST_BLOCK_PX = 32
_DRAWS = 200
_BINS = 2000


@dataclass(frozen=True)
class Form:
    """The form of a surface: `range_mm` of the smoothed deviations, with its standard uncertainty `range_u_mm`.

    `raw_rms_mm` is the RMS of the points, `rms_mm` that of the smoothed ones, `noise_mm` what neighbours differ by.
    `strays` is the share of points that are far off. `map_mm` (height, width) has the smoothed deviations, NaN outside.
    """

    range_mm: float
    range_u_mm: float
    rms_mm: float
    raw_rms_mm: float
    noise_mm: float
    strays: float
    map_mm: Array


def spread(values: Array) -> float:
    """Return the standard deviation of most values, whatever the others do: the median absolute value, scaled."""
    return float(np.median(np.abs(values - np.median(values))) / 0.6745) if len(values) else 0.0


def blocks_of(inside: Array) -> Array:
    """Return the number of each pixel's block (n,), of the pixels inside (height, width), row by row."""
    count = int(np.count_nonzero(inside))
    side = int(np.clip(np.sqrt(count / _BLOCKS), 1, _LARGEST_BLOCK_PX))
    rows, columns = np.nonzero(inside)
    whole = rows // side * (inside.shape[1] // side + 1) + columns // side
    return np.asarray(np.unique(whole, return_inverse=True)[1])


def covariance(rows: Array, weights: Array, residuals: Array, blocks: Array) -> Array:
    """Return the covariance (p, p) of a fit with derivatives `rows` (n, p), from the scatter between blocks.

    No model of the noise is needed; errors shared within a block count once.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> e = rng.normal(0, 2, 14400)
    >>> C = covariance(np.ones((14400, 1)), np.ones(14400), e - e.mean(), np.arange(14400) // 100)
    >>> bool(abs(np.sqrt(C[0, 0]) - 2 / 120) < 0.003)
    True
    """
    size, count = rows.shape[1], int(blocks.max()) + 1
    weighted = rows * weights[:, None]
    bread = np.linalg.pinv(np.einsum("ni,nj->ij", weighted, rows))
    sums = np.stack([np.bincount(blocks, weighted[:, i] * residuals, count) for i in range(size)], axis=1)
    few = count / max(count - size, 1)
    found: Array = bread @ np.einsum("bi,bj->ij", sums, sums) @ bread * few
    return found


def form_of(deviations_mm: Array, inside: Array, smooth_px: int) -> Form:
    """Return the form of deviations (height, width) of the pixels inside, each a mean over `smooth_px` squared.

    The range of points grows with their number, since noise has tails; that of means over a window tells of form. All
    points inside count, far ones too; only 3 per mille of the means, half of them at each end, are left out.
    """
    mean = box_mean(np.where(inside, deviations_mm, 0.0), inside, smooth_px)
    known = np.isfinite(mean)
    if not known.any():
        raise ValueError(f"no window of {smooth_px} px is inside the artefact; choose a smaller smooth_px")
    values, raw = mean[known], deviations_mm[inside]
    noise = _noise_mm(deviations_mm, inside)
    low, high = _trimmed(values)
    strays = float(np.mean(np.abs(raw - np.median(raw)) > STRAY * max(spread(raw), 1e-12)))
    uncertainty = _range_u(values, blocks_of(known))
    return Form(
        high - low,
        uncertainty,
        float(np.sqrt(np.mean(values**2))),
        float(np.sqrt(np.mean(raw**2))),
        noise,
        strays,
        mean,
    )


def _noise_mm(deviations_mm: Array, inside: Array) -> float:
    pairs = inside[:, 1:] & inside[:, :-1]
    differences = (deviations_mm[:, 1:] - deviations_mm[:, :-1])[pairs]
    return float(spread(differences) / np.sqrt(2))


def _trimmed(values: Array) -> tuple[float, float]:
    """Return the least and the largest value after leaving out what may be."""
    out = int(len(values) * LEFT_OUT) // 2
    ordered = np.partition(values, (out, len(values) - 1 - out))
    return float(ordered[out]), float(ordered[len(values) - 1 - out])


def _range_u(values: Array, blocks: Array) -> float:
    """Return the standard uncertainty of the trimmed range: blocks are drawn anew, with replacement."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return 0.0
    count = int(blocks.max()) + 1
    place = np.minimum(((values - low) / (high - low) * _BINS).astype(np.int64), _BINS - 1)
    table = np.bincount(blocks * _BINS + place, minlength=count * _BINS).reshape(count, _BINS).astype(np.float32)
    draws = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), _DRAWS).astype(np.float32)
    summed = np.cumsum(draws @ table, axis=1, dtype=np.float64)
    total = summed[:, -1:]
    first = (summed > total * LEFT_OUT / 2).argmax(axis=1)
    last = (summed >= total * (1 - LEFT_OUT / 2)).argmax(axis=1)
    return float(np.std(last - first) * (high - low) / _BINS)
