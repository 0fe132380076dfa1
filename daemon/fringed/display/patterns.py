"""Patterns in memory that two processes share, and as the window's pixels.

Owns the packing; most patterns are one row or one column, and travel as that. No I/O.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fringed.errors import DataError

Array8 = np.ndarray[Any, np.dtype[np.uint8]]
Pixels = np.ndarray[Any, np.dtype[np.uint32]]
Table = tuple[tuple[int, tuple[int, int, int]], ...]


def packed(patterns: Sequence[Array8]) -> tuple[bytes, Table]:
    """Return the patterns' bytes, one after the other, and for each its place and its shape."""
    table: list[tuple[int, tuple[int, int, int]]] = []
    parts: list[bytes] = []
    place = 0
    for pattern in patterns:
        height, width, channels = pattern.shape
        table.append((place, (height, width, channels)))
        parts.append(np.ascontiguousarray(pattern).tobytes())
        place += len(parts[-1])
    return b"".join(parts), tuple(table)


def unpacked(memory: bytes | memoryview, table: Table, size_px: tuple[int, int]) -> list[Array8]:
    """Return the patterns: views of `memory`, `(height or 1, width or 1, 1 or 3)`.

    Raises
    ------
    DataError
        the table does not fit the memory, or a pattern does not fit the panel.
    """
    width_px, height_px = size_px
    found = []
    for index, (place, (height, width, channels)) in enumerate(table):
        if height not in (1, height_px) or width not in (1, width_px) or channels not in (1, 3):
            raise DataError(
                f"pattern {index} is {(height, width, channels)}; expected ({height_px} or 1, {width_px} or 1, 1 or 3)"
            )
        count = height * width * channels
        if place < 0 or place + count > len(memory):
            raise DataError(f"pattern {index} ends at byte {place + count}; the memory has {len(memory)}")
        flat: Array8 = np.frombuffer(memory, np.uint8, count, place)
        found.append(flat.reshape(height, width, channels))
    return found


def pixels(pattern: Array8, shifts: tuple[int, int, int]) -> Pixels:
    """Return the pattern's pixels, `(height or 1, width or 1)`, red, green and blue at these bits; grey is all three.

    Nothing is scaled or rounded: level 137 of a pattern is 137 on the cable.

    >>> hex(pixels(np.array([[[1, 2, 3]]], np.uint8), (16, 8, 0))[0, 0])
    '0x10203'
    """
    wide = pattern.astype(np.uint32)
    red, green, blue = (wide[..., min(channel, wide.shape[2] - 1)] for channel in range(3))
    return np.asarray(red << shifts[0] | green << shifts[1] | blue << shifts[2], np.uint32)
