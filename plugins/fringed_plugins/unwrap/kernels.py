"""Kernels of quality-guided unwrapping.

Owns reliabilities, the ordering of edges and the merging of groups; `spatial` prepares and reads them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_TWO_PI = np.float32(2 * np.pi)
_PER_TURN = np.float32(0.5 / np.pi)
_ROUND = np.float32(12582912.0)
_UNKNOWN = np.float32(3.0)
LEVELS = 1 << 16
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def _wrap(difference: Any) -> Any:
    """Return the difference wrapped to (-pi, pi]."""
    return difference - _TWO_PI * ((difference * _PER_TURN + _ROUND) - _ROUND)


@njit(**_options)
def _bend(before: Any, here: Any, after: Any) -> Any:
    """Return the wrapped second difference; a NaN stays one."""
    return _wrap(before - here) - _wrap(here - after)


@njit(**_options)
def cost_rows(start: int, stop: int, phase: Any, weight: Any, cost: Any) -> None:
    """Write how little each pixel of rows `start` to `stop` can be trusted, in rad, 0 the best.

    Second differences of the wrapped phase along rows, columns and diagonals, times `weight`; pixels
    without all neighbours get a high value, but below those of real jumps.
    """
    height, width = phase.shape
    for row in range(start, stop):
        for x in range(width):
            value = _UNKNOWN
            if 0 < row < height - 1 and 0 < x < width - 1:
                here = phase[row, x]
                a = _bend(phase[row, x - 1], here, phase[row, x + 1])
                b = _bend(phase[row - 1, x], here, phase[row + 1, x])
                c = _bend(phase[row - 1, x - 1], here, phase[row + 1, x + 1])
                d = _bend(phase[row - 1, x + 1], here, phase[row + 1, x - 1])
                total = np.sqrt(a * a + b * b + c * c + d * d)
                value = _UNKNOWN if np.isnan(total) else total
            cost[row, x] = value * weight[row, x]


@njit(**_options)
def count_edges(phase: Any, cost: Any, scale: Any, counts: Any) -> None:
    """Count the edges of each level of cost: between a pixel and its right and its lower neighbour."""
    height, width = phase.shape
    for row in range(height):
        for x in range(width):
            if not np.isnan(phase[row, x]):
                if x + 1 < width and not np.isnan(phase[row, x + 1]):
                    counts[_level(cost[row, x] + cost[row, x + 1], scale) + 1] += 1
                if row + 1 < height and not np.isnan(phase[row + 1, x]):
                    counts[_level(cost[row, x] + cost[row + 1, x], scale) + 1] += 1


@njit(**_options)
def _level(cost: Any, scale: Any) -> Any:
    level = np.int64(cost * scale)
    return level if level < LEVELS else np.int64(LEVELS - 1)


@njit(**_options)
def sort_edges(phase: Any, cost: Any, scale: Any, start: Any, edges: Any) -> None:
    """Write the edges by rising cost: twice the pixel's number, plus one for its lower neighbour.

    `start` holds where each level begins and is used up.
    """
    height, width = phase.shape
    for row in range(height):
        for x in range(width):
            if not np.isnan(phase[row, x]):
                pixel = row * width + x
                if x + 1 < width and not np.isnan(phase[row, x + 1]):
                    level = _level(cost[row, x] + cost[row, x + 1], scale)
                    edges[start[level]] = 2 * pixel
                    start[level] += 1
                if row + 1 < height and not np.isnan(phase[row + 1, x]):
                    level = _level(cost[row, x] + cost[row + 1, x], scale)
                    edges[start[level]] = 2 * pixel + 1
                    start[level] += 1


@njit(**_options)
def _find(parent: Any, turns: Any, pixel: Any) -> Any:
    """Return the root of a pixel's group; afterwards it is the pixel's parent, with its turns."""
    root = pixel
    total = np.int32(0)
    while parent[root] != root:
        total += turns[root]
        root = parent[root]
    while parent[pixel] != root and pixel != root:
        after, own = parent[pixel], turns[pixel]
        parent[pixel] = root
        turns[pixel] = total
        total -= own
        pixel = after
    return root


@njit(**_options)
def merge(phase: Any, edges: Any, width: int, parent: Any, turns: Any, size: Any) -> None:
    """Join pixels along the edges, best first; `turns` of a pixel is its multiple of 2 pi over its parent's."""
    for edge in edges:
        p = np.int32(edge >> 1)
        q = p + np.int32(width) if edge & 1 else p + np.int32(1)
        a, b = _find(parent, turns, p), _find(parent, turns, q)
        if a == b:
            continue
        jump = np.int32(np.floor((phase[p] - phase[q]) * _PER_TURN + np.float32(0.5)))
        between = turns[p] + jump - turns[q]  # turns of b over a; those of a root are 0
        if size[a] < size[b]:
            a, b, between = b, a, -between
        parent[b] = a
        turns[b] = between
        size[a] += size[b]


@njit(**_options)
def resolve(phase: Any, parent: Any, turns: Any, region_of_root: Any, out: Any, regions: Any) -> int:
    """Write the unwrapped phase, relative to each group's root, and number the groups from 1; return how many."""
    count = np.int32(0)
    for pixel in range(phase.size):
        if np.isnan(phase[pixel]):
            out[pixel] = phase[pixel]
            regions[pixel] = 0
            continue
        root = _find(parent, turns, np.int32(pixel))
        own = turns[pixel] if root != pixel else np.int32(0)
        if region_of_root[root] == 0:
            count += np.int32(1)
            region_of_root[root] = count
        out[pixel] = phase[pixel] + _TWO_PI * np.float32(own)
        regions[pixel] = region_of_root[root]
    return int(count)
