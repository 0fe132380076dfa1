"""The median of the fringe order in a window: the common cure for single wrong orders.

Owns the choice of the order; the wrapped phase is never touched. Knows no contract.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

_PI = np.float32(np.pi)
_TWO_PI = np.float32(2 * np.pi)
_MOST_RADIUS = 4


@njit(cache=True, nogil=True, error_model="numpy")
def _settle(start: int, stop: int, before: Any, radius: int, phase: Any) -> None:
    height, width = before.shape
    values = np.empty((2 * radius + 1) ** 2, np.float32)
    for y in range(start, stop):
        for x in range(width):
            here = before[y, x]
            if np.isnan(here):
                continue
            count, near = 0, 0
            for i in range(max(0, y - radius), min(height, y + radius + 1)):
                for j in range(max(0, x - radius), min(width, x + radius + 1)):
                    if not np.isnan(before[i, j]):
                        values[count] = before[i, j]
                        near += 1 if abs(before[i, j] - here) < _PI else 0
                        count += 1
            if 2 * near > count:
                continue  # the median is among those within half a turn: nothing to move, nothing to sort
            middle = np.sort(values[:count])[count // 2]
            phase[y, x] = here + _TWO_PI * np.rint((middle - here) / _TWO_PI)


def settle_by_median(phase_rad: npt.NDArray[np.float32], window_px: int, threads: int = 0) -> None:
    """Move each phase, in place, by whole turns to the one nearest to the median of its window.

    The median is that of the absolute phase, not of the order: the order itself jumps wherever the phase is cut, and
    the median of a jump is wrong on one side. `window_px` is odd, 3 to 9. NaN pixels count for nothing and stay.
    Where the surface steps by more than half a period, a pixel follows the side that has more of its window; a
    detail narrower than half the window is lost, so it is off by default.

    Raises
    ------
    ValueError
        a window that is even or too large.

    References
    ----------
    Zuo et al. 2016, section 6 (median filters of the fringe order).

    Examples
    --------
    >>> phase = np.full((5, 5), 30.0, np.float32)
    >>> phase[2, 2] += np.float32(2 * np.pi)
    >>> settle_by_median(phase, 3, threads=1)
    >>> bool(np.abs(phase - 30).max() < 1e-5)
    True
    """
    radius = window_px // 2
    if window_px % 2 == 0 or not 1 <= radius <= _MOST_RADIUS:
        raise ValueError(f"a median of {window_px} x {window_px} px; the window is odd, from 3 to 9 px")
    run_rows(_settle, phase_rad.shape[0], phase_rad.copy(), radius, phase_rad, threads=threads)
