"""Camera pixels that repeat a projector pixel, where the camera out-resolves the projector (the thesis, section 2).

Owns the choice of the one that stays. Knows no contract.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

REPEATED = 1024
_REPEATED = np.uint16(REPEATED)


@njit(cache=True, nogil=True, error_model="numpy")
def _find(start: int, stop: int, phase: Any, scale: Any, rejected: Any) -> None:
    per_rad, initial = scale
    for y in range(start, stop):
        best, best_off, best_cell = -1, 0.0, 0.0
        for x in range(phase.shape[1]):
            if rejected[y, x] != 0:
                best = -1
                continue
            u = (np.float64(phase[y, x]) - initial) * per_rad
            cell = np.rint(u)
            off = abs(u - cell)
            if best < 0 or cell != best_cell:
                best, best_off, best_cell = x, off, cell
            elif off < best_off:
                rejected[y, best] |= _REPEATED
                best, best_off = x, off
            else:
                rejected[y, x] |= _REPEATED


def flag_repeated(
    phase_rad: npt.NDArray[np.float32],
    rejected: npt.NDArray[np.uint16],
    scale: tuple[float, float],
    *,
    down: bool = False,
    threads: int = 0,
) -> None:
    """Flag `REPEATED`, in place, all but one of a run of pixels that see the same projector column.

    `scale` is (period_px, initial_rad) of the absolute phase. Runs go along camera rows, or `down` its columns, for a
    phase that counts rows. The pixel nearest to the projector pixel's centre stays. A dropped pixel ends a run: what
    lies behind it is another part of the surface. Flagged pixels keep their values; the caller blanks them.

    Examples
    --------
    >>> u = np.array([[0.6, 1.0, 1.4, 1.9]], np.float32)
    >>> flags = np.zeros((1, 4), np.uint16)
    >>> flag_repeated(2 * np.pi * u / 16, flags, (16.0, 0.0), threads=1)
    >>> flags.tolist()
    [[1024, 0, 1024, 0]]
    """
    period_px, initial_rad = scale
    phase, flags = (phase_rad.T, rejected.T) if down else (phase_rad, rejected)
    numbers = (period_px / (2 * np.pi), float(initial_rad))
    run_rows(_find, flags.shape[0], phase, numbers, flags, threads=threads)
