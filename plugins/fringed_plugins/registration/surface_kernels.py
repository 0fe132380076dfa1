"""Kernels of preparation: what counts, relative to an origin, without depth jumps.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]


@njit(cache=True)
def finite(xyz: Array, valid: Array) -> int:
    """Set `valid` (height, width) where a point (height, width, 3) is finite, and return how many are."""
    count = 0
    for r in range(valid.shape[0]):
        for c in range(valid.shape[1]):
            ok = isfinite(xyz[r, c, 0] + xyz[r, c, 1] + xyz[r, c, 2])
            valid[r, c] = ok
            count += ok
    return count


@njit(cache=True)
def centre(xyz: Array, valid: Array, origin: Array, limit: float, out: Array) -> int:
    """Write points relative to `origin` into `out` float32, zero where not `valid`, and return how many are left.

    Both sides of a step of more than `limit` to the next row or column are no longer valid, in place.
    """
    height, width = valid.shape
    for r in range(height):
        for c in range(width):
            for k in range(3):
                out[r, c, k] = xyz[r, c, k] - origin[k] if valid[r, c] else 0.0
    jump = np.zeros((height, width), np.bool_)
    for r in range(height):
        for c in range(width):
            for r2, c2 in ((r, c + 1), (r + 1, c)):
                inside = r2 < height and c2 < width and valid[r, c]
                if inside and valid[r2, c2] and _apart(out, r, c, r2, c2) > limit * limit:
                    jump[r, c] = jump[r2, c2] = True
    count = 0
    for r in range(height):
        for c in range(width):
            if jump[r, c]:
                valid[r, c] = False
                out[r, c] = 0.0
            count += valid[r, c]
    return count


@njit(cache=True, inline="always")
def _apart(points: Array, r: int, c: int, r2: int, c2: int) -> float:
    total = 0.0
    for k in range(3):
        off = points[r, c, k] - points[r2, c2, k]
        total += off * off
    return total
