"""A corner of a chessboard fitted to the grey levels around it: where two blurred edges cross.

Owns the loop of Gauss and Newton on one round window; `corners` prepares them. The picture is
L (G + (M - G) (e1 + e2 - 2 e1 e2)): light L = 1 + lx x + ly y, e1 and e2 what a pixel sees of either edge. Where edges
cross at a slant blur rounds the tips differently, but each tip like the one opposite, so the crossing is not pulled.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.calibration.detect.edge_kernel import edge

PARAMETERS = 9  # cx, cy, the edges' directions (rad), w, G, M, lx, ly
_LEAST_BLUR = 0.05
_ROUNDS = 20
_MOST_PX = 2.0  # that a fit may move
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def _model(p: Any, x: float, y: float, row: Any) -> float:
    """Return the grey level at (x, y), counted from where the fit started; write its derivatives to `row`."""
    rx, ry = x - p[0], y - p[1]
    c1, s1, c2, s2 = cos(p[2]), sin(p[2]), cos(p[3]), sin(p[3])
    e1, by_distance1, by_blur1 = edge(c1 * ry - s1 * rx, -s1, c1, p[4])
    e2, by_distance2, by_blur2 = edge(c2 * ry - s2 * rx, -s2, c2, p[4])
    light = 1.0 + p[7] * x + p[8] * y
    crossed = e1 + e2 - 2.0 * e1 * e2
    value = p[5] + (p[6] - p[5]) * crossed
    g1 = light * (p[6] - p[5]) * (1.0 - 2.0 * e2)
    g2 = light * (p[6] - p[5]) * (1.0 - 2.0 * e1)
    row[0] = -g1 * by_distance1 * s1 - g2 * by_distance2 * s2
    row[1] = g1 * by_distance1 * c1 + g2 * by_distance2 * c2
    row[2] = g1 * by_distance1 * (c1 * rx + s1 * ry)
    row[3] = g2 * by_distance2 * (c2 * rx + s2 * ry)
    row[4] = -g1 * by_blur1 - g2 * by_blur2
    row[5] = light * (1.0 - crossed)
    row[6] = light * crossed
    row[7] = value * x
    row[8] = value * y
    return float(light * value)


@njit(**_options)
def _sums(image: Any, at: Any, p: Any, out: Any) -> tuple[float, int]:
    """Add up the normal equations of the window `at` (x, y, radius); return the squared misfit and the pixels."""
    normal, right, row = out
    normal[:] = 0.0
    right[:] = 0.0
    total, count = 0.0, 0
    x0, y0, radius = at[0], at[1], at[2]
    for r in range(max(0, int(y0 - radius)), min(image.shape[0], int(y0 + radius) + 2)):
        for c in range(max(0, int(x0 - radius)), min(image.shape[1], int(x0 + radius) + 2)):
            x, y = c - x0, r - y0
            if x * x + y * y > radius * radius or not np.isfinite(image[r, c]):
                continue
            off = image[r, c] - _model(p, x, y, row)
            total += off * off
            count += 1
            for i in range(PARAMETERS):
                right[i] += row[i] * off
                for j in range(i + 1):
                    normal[i, j] += row[i] * row[j]
    for i in range(PARAMETERS):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return total, count


@njit(**_options)
def fit_corners(first: int, end: int, image: Any, starts: Any, out: Any) -> None:
    """Fit the corners `first` to `end`; `starts` (n, 8) are x, y, radius, two directions (rad), blur, G and M.

    `out` is (centres (n, 2), sigma (n,) of a coordinate, blur (n,), levels (n, 2)), NaN where the fit went away.
    """
    px, sigma, blur, levels = out
    sums = (np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS), np.empty(PARAMETERS))
    p = np.zeros(PARAMETERS)
    for k in range(first, end):
        at = starts[k]
        p[:2], p[2:7], p[7:] = 0.0, at[3:8], 0.0
        px[k, :], sigma[k], blur[k], levels[k, :] = np.nan, np.nan, np.nan, np.nan
        total, count, before = 0.0, 0, np.inf
        for _ in range(_ROUNDS):
            total, count = _sums(image, at, p, sums)
            if count <= 2 * PARAMETERS or abs(before - total) <= 1e-6 * total:
                break
            before = total
            for i in range(PARAMETERS):
                sums[0][i, i] = sums[0][i, i] * (1.0 + 1e-4) + 1e-12
            p += np.linalg.solve(sums[0], sums[1])
            p[4] = min(max(p[4], _LEAST_BLUR), at[2])
            if p[0] * p[0] + p[1] * p[1] > _MOST_PX * _MOST_PX:
                break
        if count <= 2 * PARAMETERS or p[0] * p[0] + p[1] * p[1] > _MOST_PX * _MOST_PX:
            continue
        for i in range(PARAMETERS):
            sums[0][i, i] += 1e-12 * (1.0 + sums[0][i, i])
        covariance = np.linalg.inv(sums[0]) * (total / (count - PARAMETERS))
        px[k, 0], px[k, 1] = at[0] + p[0], at[1] + p[1]
        sigma[k] = sqrt(max(0.5 * (covariance[0, 0] + covariance[1, 1]), 0.0))
        blur[k], levels[k, 0], levels[k, 1] = p[4], p[5], p[6]
