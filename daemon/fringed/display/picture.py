"""The idle picture: a dim grid with the station's address.

Owns its looks. It is dim, so that it harms no measurement next door, and fine, so that one can focus on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fringed.display.patterns import Array8

GRID_PX = 64
DIM, BRIGHT = 24, 64
"""Grey levels of the grid and of its frame and text: about 0.5 % and 5 % of white at gamma 2.2."""


def grid(size_px: tuple[int, int]) -> Array8:
    """Return the grid, `(height, width, 1)`: lines of one pixel every 64, a frame on the outermost pixels, a cross."""
    width, height = size_px
    picture = np.zeros((height, width, 1), np.uint8)
    picture[GRID_PX // 2 :: GRID_PX] = DIM
    picture[:, GRID_PX // 2 :: GRID_PX] = DIM
    picture[[0, -1]] = BRIGHT
    picture[:, [0, -1]] = BRIGHT
    picture[height // 2, width // 2 - 16 : width // 2 + 17] = BRIGHT
    picture[height // 2 - 16 : height // 2 + 17, width // 2] = BRIGHT
    return picture


def with_text(picture: Array8, lines: Sequence[Array8], below: float = 0.6) -> Array8:
    """Return the picture with lines of text (masks of 0 or 1, `(height, width)`) centred `below` its upper edge."""
    height, width = picture.shape[:2]
    top = int(below * height)
    drawn = picture.copy()
    for line in lines:
        mask = line[: max(0, height - top), :width]
        left = (width - mask.shape[1]) // 2
        drawn[top : top + mask.shape[0], left : left + mask.shape[1], 0] = mask * np.uint8(BRIGHT)
        top += mask.shape[0] + 4
    return drawn
