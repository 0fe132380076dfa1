"""Quality-guided spatial unwrapping of one wrapped phase map.

Owns the algorithm's outer steps; the loops are in `reliability`, `joining` and `contracting`. What it cannot
know, it does not claim: between regions, and for the whole, the multiple of 2 pi is a convention.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.unwrap import basins, contracting, joining, reliability
from fringed_plugins.unwrap.checking import check_range, sealed, weights, wrapped_phase
from fringed_plugins.unwrap.finishing import Unwrapped, finish

Float32Array = npt.NDArray[np.float32]
Groups = tuple[Any, Any, Any, Any]

_FEW_RESIDUES = 0.003  # of the pixels; with more, pairs that cost less than any residue are too few to be worth it


def unwrap(
    wrapped_rad: npt.NDArray[Any], quality: npt.NDArray[Any] | None = None, min_region_px: int = 1, threads: int = 0
) -> Unwrapped:
    """Unwrap a phase (height, width) in [-pi, pi] rad, the most reliable pairs of neighbours first.

    NaN and infinite pixels are left out; whatever they separate becomes a region of its own, and regions
    of fewer than `min_region_px` pixels become NaN. `quality` (height, width), such as the modulation,
    makes pixels above its median count as more reliable. The result is the wrapped phase plus multiples
    of 2 pi, whatever the input; where a surface jumps by more than half a period it is wrong, and does not
    know it.

    Pairs of neighbours are joined by rising cost, as in Herraez et al., which builds the spanning tree of
    least cost. A pixel's cost is `2 s + D / 2`, from the variance `s^2` of the wrapped differences in its
    3 x 3 neighbourhood and its second differences `D`. The tree is not built by sorting pairs: see
    `joining` for the bulk of a good map, `contracting` for the rest.

    Raises
    ------
    ValueError
        arrays of other shapes; a phase beyond [-pi, pi].

    References
    ----------
    Herraez, Burton, Lalor, Gdeisat 2002, Applied Optics 41, 7437. The variance: Ghiglia, Pritt 1998,
    Two-Dimensional Phase Unwrapping, chapter 3. Rounds of cheapest pairs: Boruvka 1926.

    Examples
    --------
    >>> ramp = np.linspace(0, 20, 50)[None, :] + np.zeros((5, 1))
    >>> result = unwrap(np.angle(np.exp(1j * ramp)))
    >>> bool(np.ptp(result.phase_rad - ramp) < 1e-5)
    True
    """
    original = wrapped_phase(wrapped_rad)
    factors = weights(quality, original.shape)
    phase = original if original.dtype == np.float32 else sealed(original.astype(np.float32))
    cost, largest = np.empty_like(phase), np.empty(phase.shape[0], np.float32)
    run_rows(reliability.cost_rows, phase.shape[0], phase, factors, cost, largest, threads=threads)
    check_range(float(largest.max()))
    groups, regions = _tree(phase, cost, threads)
    return finish(original, groups, regions, min_region_px, threads)


def _tree(phase: Float32Array, cost: Float32Array, threads: int) -> tuple[tuple[Any, Any], tuple[int, Any, Any]]:
    """Return groups of pixels, and the regions that they belong to, as `finish` takes them."""
    first, turns = np.empty(phase.shape, np.int32), np.empty(phase.shape, np.int32)
    groups = (first, turns, np.empty(phase.size, np.int32), np.empty(phase.size, np.int32))
    bulk = _bulk(phase, cost, groups, threads)
    count = _basins(phase, cost, groups, threads) if bulk is None else bulk
    region, over = np.zeros(count, np.int32), np.zeros(count, np.int32)
    if count < 2:
        return (first, turns), (count, region, over)
    pairs = _pairs(phase, cost, (first, turns), threads)
    return (first, turns), (contracting.join_groups(pairs, region, over), region, over)


def _bulk(phase: Float32Array, cost: Float32Array, groups: Groups, threads: int) -> int | None:
    """Join what is cheaper than any loop around a residue; return how many groups, None where loops contradict."""
    height = phase.shape[0]
    bound, residues = np.full(height, np.inf, np.float32), np.zeros(height, np.int64)
    run_rows(joining.bound_rows, height - 1, phase, cost, bound, residues, threads=threads)
    if residues.sum() > _FEW_RESIDUES * phase.size:
        return None
    limit, bad = bound.min(), np.empty(height, np.int64)
    run_rows(joining.join_rows, height, (phase, cost), limit, groups, bad, threads=threads)
    if joining.join_seams((phase, cost), limit, groups, bad) > 0:
        return None
    return int(joining.settle_runs(groups))


def _basins(phase: Float32Array, cost: Float32Array, groups: Groups, threads: int) -> int:
    """Join each pixel to its most reliable neighbour; return how many groups that makes."""
    flat, forest = (groups[0].ravel(), groups[1].ravel()), groups[2:]
    height, width = phase.shape
    border = np.zeros(height, np.uint8)
    run_rows(basins.point_rows, height, phase, cost, *forest, threads=threads)
    run_rows(basins.settle_rows, height, cost, forest, flat, border, threads=threads)
    count = int(basins.number_basins(width, forest[0], flat, border))
    run_rows(basins.label_rows, height, forest[0], flat, border, threads=threads)
    basins.label_border(forest[0], flat, border)
    return count


def _pairs(phase: Float32Array, cost: Float32Array, groups: tuple[Any, Any], threads: int) -> tuple[Any, ...]:
    """Return the pairs of neighbours between groups that may be in the cheapest tree."""
    height = phase.shape[0]
    counts, flags = np.empty(height, np.int64), np.empty(phase.shape, np.uint8)
    run_rows(contracting.flag_rows, height, cost, groups[0], flags, counts, threads=threads)
    ends = np.cumsum(counts)
    pairs = (*(np.empty(ends[-1], np.int32) for _ in range(3)), np.empty(ends[-1], np.float32))
    run_rows(contracting.list_rows, height, (phase, cost, *groups), flags, ends, pairs, threads=threads)
    return pairs
