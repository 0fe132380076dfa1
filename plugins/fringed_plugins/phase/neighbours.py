"""Drop pixels that their neighbours contradict: specks of wrong phase, and glow beside an edge.

Owns two tests on a phase map; knows nothing of how the phase came about.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

ISOLATED = 32
DISCONTINUITY = 64
_RADIUS = 2
_CHUNK = 64
_NAN = np.float32(np.nan)


@njit(cache=True, nogil=True)
def _count(row: Any, other: Any, tolerance: Any, counts: Any) -> None:
    """Add how many of the pixels of `other` up to two columns away are near those of `row`."""
    width = row.size
    inner = max(width - 4, 0)
    a, b, c, d, e = other[:inner], other[1:], other[2:], other[3:], other[4:]
    middle, sums = row[2:], counts[2:]
    for x in range(inner):  # slices instead of offsets: the compiler vectorises these
        here = middle[x]
        near = np.float32(1) if abs(here - a[x]) < tolerance else np.float32(0)
        near += np.float32(1) if abs(here - b[x]) < tolerance else np.float32(0)
        near += np.float32(1) if abs(here - c[x]) < tolerance else np.float32(0)
        near += np.float32(1) if abs(here - d[x]) < tolerance else np.float32(0)
        near += np.float32(1) if abs(here - e[x]) < tolerance else np.float32(0)
        sums[x] += near
    for i in range(min(width, 4)):
        x = i if i < 2 or width < 4 else width - 4 + i
        for column in range(max(0, x - 2), min(width, x + 3)):
            counts[x] += np.float32(1) if abs(row[x] - other[column]) < tolerance else np.float32(0)


@njit(cache=True, nogil=True)
def _border(phase: Any, modulation: Any, holes: Any, brightest: Any) -> None:
    """Add a row's part of how many of the eight neighbours are dropped, and of their greatest modulation."""
    inner = max(phase.size - 2, 0)
    p0, p1, p2 = phase[:inner], phase[1:], phase[2:]
    m0, m1, m2 = modulation[:inner], modulation[1:], modulation[2:]
    for x in range(inner):
        near = np.float32(1) if np.isnan(p0[x]) or np.isnan(p1[x]) or np.isnan(p2[x]) else np.float32(0)
        holes[x] += near
        high = m0[x] if m0[x] > m1[x] else m1[x]
        high = high if high > m2[x] else m2[x]
        brightest[x] = high if high > brightest[x] else brightest[x]


@njit(cache=True, nogil=True)
def _count_nearest(above: Any, row: Any, below: Any, tolerance: Any, counts: Any) -> None:
    """Write how many of the eight nearest pixels are near, for all but the first and the last of `row`."""
    inner = max(row.size - 2, 0)
    a, b, c, d, here = above[:inner], above[1:], above[2:], row[:inner], row[1:]
    e, f, g, h = row[2:], below[:inner], below[1:], below[2:]
    for x in range(inner):
        value = here[x]
        near = np.int32(1) if abs(value - a[x]) < tolerance else np.int32(0)
        near += np.int32(1) if abs(value - b[x]) < tolerance else np.int32(0)
        near += np.int32(1) if abs(value - c[x]) < tolerance else np.int32(0)
        near += np.int32(1) if abs(value - d[x]) < tolerance else np.int32(0)
        near += np.int32(1) if abs(value - e[x]) < tolerance else np.int32(0)
        near += np.int32(1) if abs(value - f[x]) < tolerance else np.int32(0)
        near += np.int32(1) if abs(value - g[x]) < tolerance else np.int32(0)
        near += np.int32(1) if abs(value - h[x]) < tolerance else np.int32(0)
        counts[x] = near


@njit(cache=True, nogil=True)
def _suspects(counts: Any, rejected: Any, least: int, places: Any) -> int:
    """Write the columns whose nearest pixels do not settle the tests, kept ones only; return how many there are."""
    width, found = rejected.size, 0
    places[found] = 0
    found += 1 if rejected[0] == 0 else 0
    for start in range(0, width - 2, _CHUNK):
        stop = min(start + _CHUNK, width - 2)
        total = np.int32(0)
        for x in range(start, stop):  # a sum of integers: the compiler vectorises it
            total += counts[x]
        if total == 8 * (stop - start) and least <= 8:
            continue
        for x in range(start, stop):
            if (counts[x] < 8 or least > 8) and rejected[x + 1] == 0:
                places[found] = x + 1
                found += 1
    if width > 1 and rejected[width - 1] == 0:
        places[found] = width - 1
        found += 1
    return found


@njit(cache=True, nogil=True)
def _judge(phase: Any, modulation: Any, y: int, x: int, limits: Any) -> np.uint16:
    """Return the flags of one pixel, looked at by itself."""
    tolerance, least, glow = limits
    height, width = phase.shape
    here, count, holes, brightest = phase[y, x], np.float32(0), False, np.float32(0)
    for i in range(max(0, y - _RADIUS), min(height, y + _RADIUS + 1)):
        for j in range(max(0, x - _RADIUS), min(width, x + _RADIUS + 1)):
            count += np.float32(1) if abs(here - phase[i, j]) < tolerance else np.float32(0)
            if abs(i - y) <= 1 and abs(j - x) <= 1:
                holes = holes or np.isnan(phase[i, j])
                brightest = max(brightest, modulation[i, j])
    flag = np.uint16(ISOLATED) if count < least + np.float32(1) else np.uint16(0)  # the pixel itself was counted
    flag |= np.uint16(DISCONTINUITY) if holes and modulation[y, x] < glow * brightest else np.uint16(0)
    return flag


@njit(cache=True, nogil=True)
def _find_all(y: int, fields: Any, limits: Any, scratch: Any) -> int:
    """Flag a row in which many pixels are suspect, all at once; return how many were flagged."""
    phase, modulation, rejected = fields
    tolerance, least, glow = limits
    counts, holes, brightest = scratch
    height, width = phase.shape
    counts[:] = np.float32(0)
    holes[:] = np.float32(0)
    brightest[:] = np.float32(0)
    for row in range(max(0, y - _RADIUS), min(height, y + _RADIUS + 1)):
        _count(phase[y], phase[row], tolerance, counts)
        if abs(row - y) <= 1:
            _border(phase[row], modulation[row], holes[1:], brightest[1:])
            _border_ends(phase[row], modulation[row], holes, brightest)
    hits = 0
    for x in range(width):  # the pixel itself was counted
        alone = counts[x] < least + np.float32(1)
        glows = holes[x] > np.float32(0) and modulation[y, x] < glow * brightest[x]
        flag = np.uint16(ISOLATED) if alone else np.uint16(0)
        flag |= np.uint16(DISCONTINUITY) if glows else np.uint16(0)
        flag = flag if rejected[y, x] == 0 else np.uint16(0)
        rejected[y, x] |= flag
        hits += 1 if flag > 0 else 0
    return hits


@njit(cache=True, nogil=True)
def _border_ends(phase: Any, modulation: Any, holes: Any, brightest: Any) -> None:
    """Do for the first and the last pixel of a row what `_border` does for the others."""
    width = phase.size
    for end in (0, width - 1):
        for x in range(max(end - 1, 0), min(end + 2, width)):
            holes[end] += np.float32(1) if np.isnan(phase[x]) else np.float32(0)
            brightest[end] = max(brightest[end], modulation[x])


@njit(cache=True, nogil=True)
def _find(start: int, stop: int, fields: Any, found: Any, limits: Any) -> None:
    """Flag, in rows `start` to `stop`, what is isolated and what only glows at a border.

    Where all of a pixel's eight neighbours are near, none of them is dropped and it is not alone: nothing is left to
    ask. That settles nearly all pixels of most images with a third of the comparisons.
    """
    phase, modulation, rejected = fields
    height, width = phase.shape
    scratch = (np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.float32))
    counts, places = np.zeros(max(width - 2, 0), np.int32), np.zeros(width + 1, np.int64)
    least = int(limits[1])
    for y in range(start, stop):
        if 0 < y < height - 1:
            _count_nearest(phase[y - 1], phase[y], phase[y + 1], limits[0], counts)
        else:
            counts[:] = np.int32(0)
        suspects = _suspects(counts, rejected[y], least, places)
        if suspects > width // 8:
            found[y] = _find_all(y, fields, limits, scratch)
            continue
        hits = 0
        for n in range(suspects):
            flag = _judge(phase, modulation, y, places[n], limits)
            rejected[y, places[n]] |= flag
            hits += 1 if flag > 0 else 0
        found[y] = hits


@njit(cache=True, nogil=True)
def _blank(start: int, stop: int, phase: Any, rejected: Any, found: Any) -> None:
    for y in range(start, stop):
        if found[y] > 0:
            for x in range(phase.shape[1]):
                phase[y, x] = _NAN if rejected[y, x] != 0 else phase[y, x]


def blank(phase_rad: npt.NDArray[np.float32], rejected: npt.NDArray[np.uint16], threads: int = 0) -> None:
    """Write NaN, in place, into `phase_rad` (height, width) where `rejected` is not 0."""
    height = phase_rad.shape[0]
    run_rows(_blank, height, phase_rad, rejected, np.ones(height, np.int64), threads=threads)


def drop_strays(
    phase_rad: npt.NDArray[np.float32],
    modulation: npt.NDArray[np.float32],
    rejected: npt.NDArray[np.uint16],
    limits: tuple[float, int, float],
    threads: int = 0,
) -> None:
    """Reject, in place, what its neighbours contradict; `phase_rad` (height, width) is NaN where `rejected`.

    `limits` is (tolerance_rad, least, glow). `ISOLATED` are pixels with fewer than `least` of 24
    neighbours within `tolerance_rad`. `DISCONTINUITY` are pixels at the border of what is lit whose
    modulation is below `glow` of their brightest neighbour's: the lens spreads that neighbour's light over
    them, and its phase with it.
    """
    height = phase_rad.shape[0]
    found = np.zeros(height, np.int64)
    numbers = tuple(np.float32(limit) for limit in limits)
    run_rows(_find, height, (phase_rad, modulation, rejected), found, numbers, threads=threads)
    run_rows(_blank, height, phase_rad, rejected, found, threads=threads)
