"""Kernels of fast point feature histograms: of pairs of oriented points, and of neighbours' histograms.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import atan2, pi, sqrt
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]
BINS = 11  # of each of three angles


@njit(cache=True)
def simple(points: Array, normals: Array, pairs: Array) -> Array:
    """Return histograms (n, 33) of the three angles of Darboux frames of all `pairs` (m, 2) of neighbours."""
    out = np.zeros((len(points), 3 * BINS), np.float32)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
        length = sqrt(dx * dx + dy * dy + dz * dz)
        if length <= 0:
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        a1 = normals[i, 0] * dx + normals[i, 1] * dy + normals[i, 2] * dz
        a2 = normals[j, 0] * dx + normals[j, 1] * dy + normals[j, 2] * dz
        s, t = i, j
        if abs(a1) < abs(a2):  # the frame stands on the point whose normal leans more towards the line
            s, t, dx, dy, dz, a1 = j, i, -dx, -dy, -dz, -a2
        ux, uy, uz = normals[s, 0], normals[s, 1], normals[s, 2]
        vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
        size = sqrt(vx * vx + vy * vy + vz * vz)
        if size <= 1e-9:
            continue
        vx, vy, vz = vx / size, vy / size, vz / size
        wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        tx, ty, tz = normals[t, 0], normals[t, 1], normals[t, 2]
        alpha = 0.5 * (vx * tx + vy * ty + vz * tz + 1)
        phi = 0.5 * (a1 + 1)
        theta = (atan2(wx * tx + wy * ty + wz * tz, ux * tx + uy * ty + uz * tz) + pi) / (2 * pi)
        for where, value in ((0, alpha), (1, phi), (2, theta)):
            b = where * BINS + min(max(int(value * BINS), 0), BINS - 1)
            out[i, b] += 1
            out[j, b] += 1
    return out


@njit(cache=True)
def blended(points: Array, pairs: Array, histograms: Array) -> Array:
    """Return each point's histogram with its neighbours' by the inverse of their distance, each angle summing to 1."""
    n, width = histograms.shape
    out, total = histograms.copy(), np.zeros(n, np.float32)
    for i in range(n):
        count = np.float32(0)
        for b in range(BINS):
            count += histograms[i, b]
        if count > 0:
            for b in range(width):
                histograms[i, b] /= count
                out[i, b] = histograms[i, b]
    near = np.zeros((n, width), np.float32)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        square = 0.0
        for a in range(3):
            square += (points[j, a] - points[i, a]) ** 2
        weight = np.float32(1.0 / sqrt(square)) if square > 0 else np.float32(0)
        total[i] += weight
        total[j] += weight
        for b in range(width):
            near[i, b] += weight * histograms[j, b]
            near[j, b] += weight * histograms[i, b]
    for i in range(n):
        for b in range(width):
            if total[i] > 0:
                out[i, b] = 0.5 * (out[i, b] + near[i, b] / total[i])
    return out
