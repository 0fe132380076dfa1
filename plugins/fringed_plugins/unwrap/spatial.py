"""Quality-guided spatial unwrapping of one wrapped phase map.

Owns the algorithm's outer steps and the offsets of regions; the loops are in `kernels`. What it cannot
know, it does not claim: between regions, and for the whole, the multiple of 2 pi is a convention.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.unwrap import kernels

Float32Array = npt.NDArray[np.float32]
Int32Array = npt.NDArray[np.int32]

_COST_AT_TOP = 16.0  # rad; costs beyond it share the last level


class Unwrapped(NamedTuple):
    """Phase (height, width) float32, NaN where unknown; regions numbered from 1, the largest first."""

    phase_rad: Float32Array
    regions: Int32Array
    sizes: tuple[int, ...]


def unwrap(
    wrapped_rad: npt.NDArray[Any], quality: npt.NDArray[Any] | None = None, min_region_px: int = 1, threads: int = 0
) -> Unwrapped:
    """Unwrap a phase (height, width), the most reliable pixels first.

    NaN pixels are left out; whatever they separate becomes a region of its own. `quality` (height,
    width), such as the modulation, makes pixels above its median count as more reliable. Each region
    is put where the median of its phase lies within (-pi, pi]. Regions of fewer than `min_region_px`
    pixels become NaN.

    Edges between neighbours are merged in the order of the reliability of their pixels (Herraez et al.
    2002), here with a counting sort and a union-find that carries multiples of 2 pi.

    Raises
    ------
    ValueError
        arrays of other shapes.

    References
    ----------
    Herraez, Burton, Lalor, Gdeisat 2002, Applied Optics 41, 7437.

    Examples
    --------
    >>> ramp = np.linspace(0, 20, 50)[None, :] + np.zeros((5, 1))
    >>> result = unwrap(np.angle(np.exp(1j * ramp)))
    >>> bool(np.ptp(result.phase_rad - ramp) < 1e-5)
    True
    """
    phase = np.ascontiguousarray(wrapped_rad, np.float32)
    if phase.ndim != 2 or (quality is not None and quality.shape != phase.shape):
        shape = None if quality is None else quality.shape
        raise ValueError(f"a phase of shape {phase.shape} with a quality of {shape}; both must be (height, width)")
    phase = np.where(np.isfinite(phase), phase, np.float32(np.nan))
    edges = _sorted_edges(phase, _weights(phase, quality), threads)
    flat = phase.ravel()
    parent = np.arange(flat.size, dtype=np.int32)
    turns, size = np.zeros(flat.size, np.int32), np.ones(flat.size, np.int32)
    kernels.merge(flat, edges, phase.shape[1], parent, turns, size)
    out, regions = np.empty_like(flat), np.empty(flat.size, np.int32)
    count = kernels.resolve(flat, parent, turns, np.zeros(flat.size, np.int32), out, regions)
    return _ordered(out.reshape(phase.shape), regions.reshape(phase.shape), count, min_region_px)


def _weights(phase: Float32Array, quality: npt.NDArray[Any] | None) -> Float32Array:
    """Return factors of the cost: 1 at the median quality, more where it is lower."""
    if quality is None:
        return np.ones(phase.shape, np.float32)
    good = np.isfinite(phase) & np.isfinite(quality) & (quality > 0)
    if not good.any():
        return np.ones(phase.shape, np.float32)
    middle = np.float32(np.median(quality[good]))
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.float32(0.5) + np.float32(0.5) * middle / np.asarray(quality, np.float32)
    return np.where(good, np.clip(weight, 0.5, 10.0), 10.0).astype(np.float32)


def _sorted_edges(phase: Float32Array, weight: Float32Array, threads: int) -> Int32Array:
    cost = np.empty_like(phase)
    run_rows(kernels.cost_rows, phase.shape[0], phase, weight, cost, threads=threads)
    scale = np.float32(kernels.LEVELS / _COST_AT_TOP)
    counts = np.zeros(kernels.LEVELS + 1, np.int64)
    kernels.count_edges(phase, cost, scale, counts)
    start = np.cumsum(counts)
    edges: Int32Array = np.empty(int(start[-1]), np.int32)
    kernels.sort_edges(phase, cost, scale, start[:-1].copy(), edges)
    return edges


def _ordered(phase: Float32Array, regions: Int32Array, count: int, least: int) -> Unwrapped:
    """Sort the regions by size, drop small ones, and set each region's multiple of 2 pi."""
    sizes = np.bincount(regions.ravel(), minlength=count + 1)
    sizes[0] = 0
    order = np.argsort(-sizes[1:], kind="stable") + 1
    kept = order[sizes[order] >= max(least, 1)]
    renumber = np.zeros(count + 1, np.int32)
    renumber[kept] = np.arange(1, len(kept) + 1, dtype=np.int32)
    regions = renumber[regions]
    shift = _median_turns(phase, regions, len(kept))
    phase -= (2 * np.pi * shift).astype(np.float32)[regions]
    phase[regions == 0] = np.nan
    return Unwrapped(phase, regions, tuple(int(n) for n in sizes[kept]))


def _median_turns(phase: Float32Array, regions: Int32Array, count: int) -> npt.NDArray[np.float64]:
    """Return the multiple of 2 pi nearest to each region's median, by number; 0 for number 0."""
    shift = np.zeros(count + 1)
    if count == 0:
        return shift
    if count == 1:
        shift[1] = np.round(np.median(phase[regions == 1]) / (2 * np.pi))
        return shift
    flat = regions.ravel()
    order = np.argsort(flat, kind="stable")
    edges = np.searchsorted(flat[order], np.arange(count + 2))
    values = phase.ravel()[order]
    for number in range(1, count + 1):
        shift[number] = np.round(np.median(values[edges[number] : edges[number + 1]]) / (2 * np.pi))
    return shift
