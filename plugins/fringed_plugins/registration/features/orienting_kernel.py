"""Kernel of a spanning tree whose edges say whether two signs are alike.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]


@njit(cache=True, nogil=True)
def _root(parent: Array, sign: Array, i: int) -> tuple[int, int]:
    """Return the root of `i` and the sign of `i` relative to it, and halve the way for those who follow."""
    total = 1
    while parent[i] != i:
        above = parent[i]
        sign[i] *= sign[above]
        parent[i] = parent[above]
        total *= sign[i]
        i = parent[i]
    return i, total


@njit(cache=True, nogil=True)
def join(order: Array, near: Array, edges: int, alike: Array, parent: Array, sign: Array) -> None:
    """Join along edges `order` (m,): edge k is from point k // edges to its neighbour 1 + k % edges of `near` (n, _).

    Kruskal's tree with a sign at each vertex: `parent` (n,) and `sign` (n,) are a forest that has grown in place.
    `alike` (n x edges,) is +1 or -1.
    """
    for k in order:
        i = k // edges
        a, sign_a = _root(parent, sign, i)
        b, sign_b = _root(parent, sign, near[i, 1 + k % edges])
        if a != b:
            parent[a] = b
            sign[a] = sign_a * sign_b * alike[k]
