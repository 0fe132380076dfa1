"""Kernels of voting by pairs of oriented points: a table of one view's pairs, and votes of the other view's.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import acos, atan2, floor, pi, sqrt
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]
NEAREST = 2  # steps of distance: the direction between nearer points is not known well enough


@njit(cache=True, inline="always")
def _cell(points: Array, normals: Array, i: int, j: int, steps: tuple[float, float], counts: tuple[int, int]) -> int:
    """Return the cell of (distance, angles of both normals to the line, angle between them), -1 where there is none."""
    dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
    length = sqrt(dx * dx + dy * dy + dz * dz)
    far = int(length / steps[0])
    if far < NEAREST or far >= counts[0] or length <= 0:
        return -1
    a = (normals[i, 0] * dx + normals[i, 1] * dy + normals[i, 2] * dz) / length
    b = (normals[j, 0] * dx + normals[j, 1] * dy + normals[j, 2] * dz) / length
    c = normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1] + normals[i, 2] * normals[j, 2]
    cell = far
    for cosine in (a, b, c):
        cell = cell * counts[1] + int(acos(min(max(cosine, -1.0), 1.0)) / steps[1])
    return cell


@njit(cache=True, inline="always")
def _azimuth(points: Array, frames: Array, i: int, j: int) -> float:
    """Return the angle of point j about the normal of point i."""
    dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
    u = frames[i, 0, 0] * dx + frames[i, 0, 1] * dy + frames[i, 0, 2] * dz
    v = frames[i, 1, 0] * dx + frames[i, 1, 1] * dy + frames[i, 1, 2] * dz
    return atan2(v, u)


@njit(cache=True)
def tabulate(
    points: Array, normals: Array, frames: Array, steps: tuple[float, float], counts: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """Return all ordered pairs by cell: where each cell starts, the pairs' first points, their azimuths."""
    n = len(points)
    start = np.zeros(counts[0] * counts[1] ** 3 + 1, np.int64)
    cells = np.full(n * n, -1, np.int32)
    for i in range(n):
        for j in range(n):
            cell = _cell(points, normals, i, j, steps, counts)
            if cell >= 0:
                cells[i * n + j] = cell
                start[cell + 1] += 1
    for cell in range(1, len(start)):
        start[cell] += start[cell - 1]
    first, azimuth = np.empty(start[-1], np.int32), np.empty(start[-1])
    free = start.copy()
    for i in range(n):
        for j in range(n):
            cell = cells[i * n + j]
            if cell >= 0:
                first[free[cell]] = i
                azimuth[free[cell]] = _azimuth(points, frames, i, j)
                free[cell] += 1
    return start, first, azimuth


@njit(cache=True)
def vote(
    model: tuple[Array, Array, Array],
    chosen: Array,
    table: tuple[Array, Array, Array],
    steps: tuple[float, float],
    counts: tuple[int, int],
    size: tuple[int, int, int, int],
) -> Array:
    """Return the best (first point, turn about the normals, votes), (chosen, peaks, 3), for each chosen model point.

    `size` is how many points the reference has, into how many turns a circle is divided, how many peaks are taken
    and how many pairs a cell may hold at most. A model pair has one vote, which the pairs of its cell share: pairs that
    many others look like say little.
    """
    points, normals, frames = model
    start, first, azimuth = table
    n, turns, peaks, common = size
    out = np.zeros((len(chosen), peaks, 3))
    votes = np.empty((n, turns))
    for k in range(len(chosen)):
        i = chosen[k]
        votes[:] = 0
        for j in range(len(points)):
            cell = _cell(points, normals, i, j, steps, counts)
            if cell < 0:
                continue
            begin, end = start[cell], start[cell + 1]
            if end == begin or end - begin > common:
                continue
            share, own = 1.0 / (end - begin), _azimuth(points, frames, i, j)
            for e in range(begin, end):
                turn = (azimuth[e] - own) * turns / (2 * pi)
                turn -= turns * floor(turn / turns)
                low = min(int(turn), turns - 1)
                part = turn - low
                votes[first[e], low] += share * (1 - part)
                votes[first[e], (low + 1) % turns] += share * part
        for peak in range(peaks):
            at = np.argmax(votes)
            p, t = at // turns, at % turns
            out[k, peak, 0] = p
            out[k, peak, 1] = t * 2 * pi / turns
            out[k, peak, 2] = votes[p, t]
            for near in range(-2, 3):
                votes[p, (t + near) % turns] = 0
    return out
