"""Kernels that sort triangles into the perspective cells of a lens that each may cover.

Owns the light buffer (Haines & Greenberg 1986); knows nothing of rays and light.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit


class Grid(NamedTuple):
    """Which triangles a perspective cell may show: `items[start[cell] : start[cell + 1]]`."""

    bounds: Any  # (4,) x0, y0, cells per unit of x and of y; normalised coordinates
    nx: int
    ny: int
    start: Any  # (nx * ny + 1,) int64
    items: Any  # int32


@njit(cache=True, nogil=True)
def bin_triangles(boxes: Any, nx: int, start: Any, items: Any, filling: bool) -> None:
    """Count the triangles of each cell into `start[cell + 1]`, or file them; boxes (n, 4) int32, empty if x1 < x0."""
    for i in range(boxes.shape[0]):
        for y in range(boxes[i, 1], boxes[i, 3] + 1):
            for x in range(boxes[i, 0], boxes[i, 2] + 1):
                cell = y * nx + x
                if filling:
                    items[start[cell]] = i
                    start[cell] += 1
                else:
                    start[cell + 1] += 1


@njit(cache=True, nogil=True)
def box_triangles(triangles: Any, T: Any, low: Any, high: Any, out: Any) -> None:
    """Write each triangle's box (n, 4) in a lens's normalised coordinates: x0, y0, x1, y1; x1 < x0 if out of sight."""
    for i in range(triangles.shape[0]):
        ahead = 0
        x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
        for corner in range(3):
            p0, p1, p2 = triangles[i, 0, 0], triangles[i, 0, 1], triangles[i, 0, 2]
            if corner > 0:
                p0, p1, p2 = p0 + triangles[i, corner, 0], p1 + triangles[i, corner, 1], p2 + triangles[i, corner, 2]
            z = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
            if z > 1.0:
                ahead += 1
                x = (T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]) / z
                y = (T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]) / z
                x0, y0, x1, y1 = min(x0, x), min(y0, y), max(x1, x), max(y1, y)
        if 0 < ahead < 3:  # reaches behind the lens: it may be anywhere
            x0, y0, x1, y1 = low[0], low[1], high[0], high[1]
        if ahead == 0 or x0 > high[0] or y0 > high[1] or x1 < low[0] or y1 < low[1]:
            x0, y0, x1, y1 = 1.0, 1.0, -1.0, -1.0
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = x0, y0, x1, y1
