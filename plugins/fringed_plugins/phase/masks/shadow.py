"""Shadow: light without fringes. Tells it from what is dark. Knows no contract."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

SHADOW = 512
_SHADOW = np.uint16(SHADOW)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _find(start: int, stop: int, maps: Any, limits: Any, rejected: Any) -> None:
    background, modulation = maps
    contrast, dark = limits
    for y in range(start, stop):
        light, fringe, flags = background[y], modulation[y], rejected[y]
        for x in range(flags.size):
            above = light[x] - dark
            flags[x] |= _SHADOW if above > dark and fringe[x] < contrast * above else np.uint16(0)


def flag_shadow(
    background: npt.NDArray[np.float32],
    modulation: npt.NDArray[np.float32],
    rejected: npt.NDArray[np.uint16],
    limits: tuple[float, float],
    threads: int = 0,
) -> None:
    """Flag `SHADOW`, in place, where there is light but hardly a fringe in it.

    `limits` is (contrast, dark_dn): light counts from the camera's dark level on, and is there from twice that;
    its fringes must be below `contrast` of it. What is darker stays `LOW_MODULATION` alone: a black backdrop, or
    nothing at all. Flagged pixels keep their values; the caller blanks them.

    Examples
    --------
    >>> light = np.array([[100.0, 100.0, 3.0]], np.float32)
    >>> fringe = np.array([[50.0, 2.0, 0.5]], np.float32)
    >>> flags = np.zeros((1, 3), np.uint16)
    >>> flag_shadow(light, fringe, flags, (0.05, 5.0), threads=1)
    >>> flags.tolist()
    [[0, 512, 0]]
    """
    numbers = (np.float32(limits[0]), np.float32(limits[1]))
    run_rows(_find, rejected.shape[0], (background, modulation), numbers, rejected, threads=threads)
