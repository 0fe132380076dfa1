"""Kernels that find equal numbers, or equal points, in one pass: an open table, as large as twice the numbers.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]
_MIX = np.uint64(0x9E3779B97F4A7C15)  # Knuth's: 2^64 over the golden ratio


@njit(cache=True, nogil=True)
def grouped(keys: Array, group: Array, first: Array) -> int:
    """Write each key's group (n,), numbered as they first appear, and where each begins (n,); return how many.

    `keys` (n, m) uint64 are equal where all their m numbers are.
    """
    n, m = keys.shape
    bits = 4
    while (1 << bits) < 2 * n:
        bits += 1
    table = np.full(1 << bits, -1, np.int64)
    shift, mask, found = np.uint64(64 - bits), (1 << bits) - 1, 0
    for i in range(n):
        mixed = np.uint64(0)
        for k in range(m):
            mixed = (mixed ^ keys[i, k]) * _MIX
            mixed ^= mixed >> np.uint64(29)
        at = np.int64((mixed * _MIX) >> shift)
        while table[at] >= 0:
            same = True
            for k in range(m):
                same = same and keys[first[table[at]], k] == keys[i, k]
            if same:
                break
            at = (at + 1) & mask
        if table[at] < 0:
            table[at] = found
            first[found] = i
            found += 1
        group[i] = table[at]
    return found


@njit(cache=True, nogil=True)
def summed(values: Array, weights: Array, group: Array, sums: Array, totals: Array) -> None:
    """Add weighted rows (n, m) and weights (n,) to the sums (g, m) and totals (g,) of their groups."""
    for i in range(len(values)):
        g = group[i]
        totals[g] += weights[i]
        for k in range(values.shape[1]):
            sums[g, k] += weights[i] * values[i, k]
