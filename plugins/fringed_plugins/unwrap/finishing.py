"""Turn groups of pixels and their turns into an unwrapped phase with numbered regions.

Owns the order of regions, the multiple of 2 pi that each is put at, and what is dropped; knows nothing of
how the turns were found.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

_TWO_PI = 2 * np.pi
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


class Unwrapped(NamedTuple):
    """An unwrapped phase, NaN where unknown, and its regions numbered from 1, the largest first; 0: none.

    `phase_rad` (height, width) is float64 where the wrapped phase was, else float32; `regions` is int32,
    `sizes` are their pixels. Between regions, and for the whole, the multiple of 2 pi is a convention:
    the lower median of each region lies within (-pi, pi].
    """

    phase_rad: npt.NDArray[np.floating[Any]]
    regions: npt.NDArray[np.int32]
    sizes: tuple[int, ...]


@njit(**_options)
def _collect_rows(start: int, stop: int, first: Any, turns: Any, region: Any, over: Any) -> None:
    """Replace the group of each pixel by the group's region, and count its turns over that."""
    for row in range(start, stop):
        for x in range(first.shape[1]):
            group = first[row, x]
            if group >= 0:
                first[row, x] = region[group]
                turns[row, x] += over[group]


@njit(**_options)
def _measure(first: Any, turns: Any, size: Any, low: Any, high: Any) -> None:
    """Count the pixels of each region and find its least and greatest turns; neighbours are taken together."""
    last, count, least, most = np.int32(-1), 0, np.int32(0), np.int32(0)
    for i in range(first.size):
        if first[i] != last:
            if last >= 0:
                size[last] += count
                low[last], high[last] = min(low[last], least), max(high[last], most)
            last, count, least, most = first[i], 0, turns[i], turns[i]
        count += 1
        least, most = min(least, turns[i]), max(most, turns[i])
    if last >= 0:
        size[last] += count
        low[last], high[last] = min(low[last], least), max(high[last], most)


@njit(**_options)
def _middle_turns(first: Any, turns: Any, size: Any, low: Any, high: Any) -> Any:
    """Return the lower median of each region's turns, by counting."""
    regions = size.size
    begin = np.zeros(regions + 1, np.int64)
    for region in range(regions):
        begin[region + 1] = begin[region] + max(high[region] - low[region] + 1, 1)
    counts = np.zeros(begin[regions], np.int64)
    for i in range(first.size):
        if first[i] >= 0:
            counts[begin[first[i]] + turns[i] - low[first[i]]] += 1
    middle = np.empty(regions, np.int64)
    for region in range(regions):
        place, seen = begin[region], counts[begin[region]]
        while 2 * seen < size[region]:
            place += 1
            seen += counts[place]
        middle[region] = low[region] + place - begin[region]
    return middle


@njit(**_options)
def _write_rows(start: int, stop: int, phase: Any, groups: Any, regions: Any, out: Any) -> None:
    """Write the phase of some rows, NaN outside the regions that have a rank, and the rank into `first`."""
    first, turns = groups
    rank, middle = regions
    for row in range(start, stop):
        for x in range(first.shape[1]):
            region = first[row, x]
            number = rank[region] if region >= 0 else np.int32(0)
            turn = turns[row, x] - middle[region] if number > 0 else 0
            value = phase[row, x] + _TWO_PI * turn
            out[row, x] = value if number > 0 else np.nan
            first[row, x] = number


def finish(
    phase_rad: npt.NDArray[Any], groups: tuple[Any, Any], regions: tuple[int, Any, Any], least_px: int, threads: int
) -> Unwrapped:
    """Return the unwrapped phase; `groups` are used up.

    Parameters
    ----------
    phase_rad
        (height, width) float, the wrapped phase.
    groups
        for each pixel its group from 0, -1 where unknown, and its turns over that group; int32.
    regions
        how many there are, and for each group its region from 0 and its turns over that.
    least_px
        regions of fewer pixels are dropped.
    """
    first, turns = groups
    count, region, over = regions
    height = phase_rad.shape[0]
    run_rows(_collect_rows, height, first, turns, region, over, threads=threads)
    size, limit = np.zeros(count, np.int64), np.int64(2**31)
    low, high = np.full(count, limit), np.full(count, -limit)
    _measure(first.ravel(), turns.ravel(), size, low, high)
    middle = _middle_turns(first.ravel(), turns.ravel(), size, low, high)
    order = np.argsort(-size, kind="stable")
    kept = order[size[order] >= max(least_px, 1)]
    rank = np.zeros(count, np.int32)
    rank[kept] = np.arange(1, kept.size + 1, dtype=np.int32)
    out = np.empty(phase_rad.shape, phase_rad.dtype)
    run_rows(_write_rows, height, phase_rad, (first, turns), (rank, middle), out, threads=threads)
    return Unwrapped(out, first, tuple(int(n) for n in size[kept]))
