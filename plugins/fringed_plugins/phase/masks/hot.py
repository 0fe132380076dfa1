"""Hot, stuck and dead pixels of the camera: what differs from all neighbours in every frame.

Owns three ways to know them: a decoded map, a dark frame, a list. Knows no contract.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

HOT_PIXEL = 256
_DEAD = np.float32(0.5)
_HOT = np.uint16(HOT_PIXEL)


@njit(cache=True, nogil=True, error_model="numpy")
def _find(start: int, stop: int, maps: Any, limits: Any, rejected: Any) -> None:
    """Flag what lies outside the range of its eight neighbours by `spread` times that range and `least`."""
    background, modulation = maps
    spread, least = limits
    height, width = background.shape
    for y in range(max(start, 1), min(stop, height - 1)):
        for x in range(1, width - 1):
            low, high = background[y, x - 1], background[y, x - 1]
            weakest, strongest = modulation[y, x - 1], modulation[y, x - 1]
            for i in range(y - 1, y + 2):
                for j in range(x - 1, x + 2):
                    if i != y or j != x:
                        low, high = min(low, background[i, j]), max(high, background[i, j])
                        weakest, strongest = min(weakest, modulation[i, j]), max(strongest, modulation[i, j])
            margin = spread * (high - low) + least
            hot = background[y, x] > high + margin or background[y, x] < low - margin
            apart = weakest - modulation[y, x] > spread * (strongest - weakest) + least
            dead = apart and modulation[y, x] < _DEAD * weakest
            rejected[y, x] |= _HOT if hot or dead else np.uint16(0)


def flag_hot(
    background: npt.NDArray[np.float32],
    modulation: npt.NDArray[np.float32],
    rejected: npt.NDArray[np.uint16],
    limits: tuple[float, float],
    threads: int = 0,
) -> None:
    """Flag `HOT_PIXEL`, in place, where one pixel stands out of its eight neighbours.

    `limits` is (spread, least_dn): the mean light must leave the range of the neighbours' by `spread` times that range
    and `least_dn`; or the modulation must fall as far below all neighbours' and under half the weakest. An edge of
    the surface's reflectivity makes the range itself wide, so it flags nothing; a bright speck of one
    pixel on a surface cannot be told from a hot pixel. The image's border is not judged. Flagged pixels keep their
    values; the caller blanks them.

    Examples
    --------
    >>> light = np.full((5, 5), 100, np.float32)
    >>> light[2, 2] = 180
    >>> flags = np.zeros((5, 5), np.uint16)
    >>> flag_hot(light, light / 2, flags, (1.0, 20.0), threads=1)
    >>> np.argwhere(flags).tolist()
    [[2, 2]]
    """
    numbers = (np.float32(limits[0]), np.float32(limits[1]))
    run_rows(_find, rejected.shape[0], (background, modulation), numbers, rejected, threads=threads)


def hot_in_dark(dark: npt.NDArray[Any], sigmas: float = 8.0) -> npt.NDArray[np.bool_]:
    """Return which pixels of a dark frame (height, width) are hot: `sigmas` robust deviations above its median.

    Examples
    --------
    >>> frame = np.random.default_rng(1).normal(5, 1, (64, 64))
    >>> frame[3, 4] = 40
    >>> np.argwhere(hot_in_dark(frame)).tolist()
    [[3, 4]]
    """
    values = np.asarray(dark, np.float64)
    middle = float(np.median(values))
    deviation = max(float(np.median(np.abs(values - middle))) / 0.6745, 0.5)
    return np.asarray(values > middle + sigmas * deviation)


def flag_listed(rejected: npt.NDArray[np.uint16], places: Sequence[tuple[int, int]]) -> None:
    """Flag `HOT_PIXEL`, in place, at (row, column) of `places`.

    Raises
    ------
    ValueError
        a place outside the image.
    """
    height, width = rejected.shape
    for row, column in places:
        if not (0 <= row < height and 0 <= column < width):
            raise ValueError(
                f"the hot pixel at row {row}, column {column} is not in an image of {height} rows and {width} columns"
            )
        rejected[row, column] |= _HOT
