"""Drop pixels that agree with too few of their neighbours: isolated specks of wrong phase.

Owns one test on a phase map; knows nothing of how the phase came about.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

ISOLATED = 32
_RADIUS = 2
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
def _find(start: int, stop: int, phase: Any, rejected: Any, found: Any, limits: Any) -> None:
    tolerance, least = limits
    height, width = phase.shape
    counts = np.zeros(width, np.float32)
    for y in range(start, stop):
        counts[:] = np.float32(0)
        for dy in range(max(0, y - _RADIUS), min(height, y + _RADIUS + 1)):
            _count(phase[y], phase[dy], tolerance, counts)
        hits = 0
        for x in range(width):  # the pixel itself was counted
            alone = rejected[y, x] == 0 and counts[x] < least + np.float32(1)
            rejected[y, x] |= np.uint8(ISOLATED) if alone else np.uint8(0)
            hits += 1 if alone else 0
        found[y] = hits


@njit(cache=True, nogil=True)
def _blank(start: int, stop: int, phase: Any, rejected: Any, found: Any) -> None:
    for y in range(start, stop):
        if found[y] > 0:
            for x in range(phase.shape[1]):
                phase[y, x] = _NAN if rejected[y, x] != 0 else phase[y, x]


def drop_isolated(
    phase_rad: npt.NDArray[np.float32],
    rejected: npt.NDArray[np.uint8],
    tolerance_rad: float,
    least: int,
    threads: int = 0,
) -> None:
    """Reject, in place, pixels with fewer than `least` of 24 neighbours within `tolerance_rad`.

    `phase_rad` (height, width) is NaN where `rejected`; the flag is `ISOLATED`.
    """
    height = phase_rad.shape[0]
    found = np.zeros(height, np.int64)
    limits = (np.float32(tolerance_rad), np.float32(least))
    run_rows(_find, height, phase_rad, rejected, found, limits, threads=threads)
    run_rows(_blank, height, phase_rad, rejected, found, threads=threads)
