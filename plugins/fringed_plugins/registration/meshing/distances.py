"""The kernel of the volume: signed distances from voxels to one view's patches.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]
SIDE = 8  # voxels of a block
MOST_STEPS = 4
NEAR = 0.6  # of a pixel


@njit(cache=True, nogil=True, inline="always")
def _seen_at(x: float, y: float, z: float, transforms: Array) -> tuple[tuple[float, float, float], float, float]:
    """Return a place in the view's frame and its column and row, NaN where it is behind the view."""
    T, P = transforms[:4], transforms[4:]
    a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
    b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
    c = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    depth = P[2, 0] * a + P[2, 1] * b + P[2, 2] * c + P[2, 3]
    if depth < 1e-6:
        return (a, b, c), np.nan, np.nan
    u = (P[0, 0] * a + P[0, 1] * b + P[0, 2] * c + P[0, 3]) / depth
    v = (P[1, 0] * a + P[1, 1] * b + P[1, 2] * c + P[1, 3]) / depth
    return (a, b, c), u, v


@njit(cache=True, nogil=True, inline="always")
def _distance(
    place: tuple[float, float, float], c: int, r: int, table: Array, weights: Array
) -> tuple[int, int, float]:
    """Walk from pixel (c, r) to the foot of a place: its pixel and the signed distance; r is -1 without one."""
    height, width = weights.shape
    x, y, z = place
    du = dv = d = 0.0
    for step in range(MOST_STEPS):
        t = table[r, c]
        ox, oy, oz = x - t[0], y - t[1], z - t[2]
        E = t[3] * t[3] + t[4] * t[4] + t[5] * t[5]
        F = t[3] * t[6] + t[4] * t[7] + t[5] * t[8]
        G = t[6] * t[6] + t[7] * t[7] + t[8] * t[8]
        d = ox * t[9] + oy * t[10] + oz * t[11]
        a = ox * t[3] + oy * t[4] + oz * t[5]
        b = ox * t[6] + oy * t[7] + oz * t[8]
        det = E * G - F * F
        if det <= 0:
            return c, -1, 0.0
        du, dv = (G * a - F * b) / det, (E * b - F * a) / det
        if abs(du) <= NEAR and abs(dv) <= NEAR:
            return c, r, d - 0.5 * (du * (t[12] * du + 2 * t[13] * dv) + t[14] * dv * dv)
        if step == MOST_STEPS - 1:
            break
        c, r = int(np.floor(c + du + 0.5)), int(np.floor(r + dv + 0.5))
        if c < 0 or r < 0 or c >= width or r >= height or weights[r, c] <= 0:
            return c, -1, 0.0
    # steep or far: no foot within a pixel; the plane of the nearest patch, if it is not far either
    if abs(du) > 1.5 or abs(dv) > 1.5:
        return c, -1, 0.0
    return c, r, d


@njit(cache=True, nogil=True, inline="always")
def _voxel(
    place: tuple[float, float, float], c: int, r: int, view: tuple[Array, Array], truncation: float
) -> tuple[float, float]:
    """Return distance and weight of a place on the ray of pixel (c, r); -1: looked through, 0: unknown."""
    table, weights = view
    if weights[r, c] <= 0:
        return 0.0, 0.0
    t = table[r, c]
    # on the ray to the pixel's point: the distance from its plane tells front from back, near or far
    d = (place[0] - t[0]) * t[9] + (place[1] - t[1]) * t[10] + (place[2] - t[2]) * t[11]
    if d > 2 * truncation:
        return d, -1.0
    if d < -2 * truncation:
        return d, 0.0
    c, r, d = _distance(place, c, r, table, weights)
    if r < 0 or d <= -truncation:
        return d, 0.0
    if d >= truncation:
        return d, -1.0
    return d, weights[r, c]


@njit(cache=True, nogil=True)
def fuse(
    start: int,
    stop: int,
    corners: Array,
    sizes: tuple[float, float, float],
    view: tuple[Array, Array, Array],
    fused: tuple[Array, Array, Array],
) -> None:
    """Add one view's signed distances to the blocks from `start` to `stop`.

    `corners` (b, 3) of the first voxels; `sizes` voxel, truncation and margin in pixels; `view` transforms (7, 4),
    the motion's four rows into it and the projection's three, patches (h, w, 15) and weights (h, w), zero where a patch
    does not count. `fused` (b, 512) each: distances x weights, weights, and 1 where the view looks through.
    """
    voxel, truncation, margin = sizes
    sums, totals, free = fused
    transforms, table, weights = view
    height, width = weights.shape
    half = 0.5 * (SIDE - 1) * voxel
    for b in range(start, stop):
        x0, y0, z0 = corners[b, 0], corners[b, 1], corners[b, 2]
        _, u, v = _seen_at(x0 + half, y0 + half, z0 + half, transforms)
        if not (u > -margin and v > -margin and u < width + margin and v < height + margin):
            continue
        for k in range(SIDE * SIDE * SIDE):
            x, y, z = x0 + voxel * (k // (SIDE * SIDE)), y0 + voxel * (k // SIDE % SIDE), z0 + voxel * (k % SIDE)
            place, u, v = _seen_at(x, y, z, transforms)
            if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
                continue
            d, weight = _voxel(place, int(u + 0.5), int(v + 0.5), (table, weights), truncation)
            if weight > 0:
                sums[b, k] += weight * d
                totals[b, k] += weight
            elif weight < 0:
                free[b, k] = 1
