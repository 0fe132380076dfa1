"""Kernel of curvatures on the grid: quadratics of square windows, row by row.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.compiled import kept
from fringed_plugins.registration.features import forms_kernel
from fringed_plugins.registration.features.forms_kernel import principal

Array = np.ndarray[Any, Any]


@njit(cache=True, nogil=True)
def _moments(flat: Array, row: int, half: int, down: Array, across: Array) -> None:
    """Fill `across` (6, width x 3) with sums of f, u f, v f, u^2 f, u v f, v^2 f over the windows of one row.

    `flat` (height, width x 3); first down the columns into `down` (3, width x 3), then along the row.
    """
    down[:] = 0
    across[:] = 0
    for v in range(-half, half + 1):
        line = flat[row + v]
        d0, d1, d2 = down[0], down[1], down[2]
        for j in range(line.size):
            d0[j] += line[j]
            d1[j] += v * line[j]
            d2[j] += v * v * line[j]
    inner = down.shape[1] - 6 * half
    m00, m10, m01, m20, m11, m02 = across[0], across[1], across[2], across[3], across[4], across[5]
    for u in range(-half, half + 1):
        first = 3 * (half + u)
        a, b, c = down[0, first : first + inner], down[1, first : first + inner], down[2, first : first + inner]
        for j in range(inner):
            m00[j] += a[j]
            m10[j] += u * a[j]
            m20[j] += u * u * a[j]
        for j in range(inner):  # two loops: one with all nine arrays is not vectorised
            m01[j] += b[j]
            m11[j] += u * b[j]
            m02[j] += c[j]


@kept(forms_kernel, nogil=True, error_model="numpy")
def grid_curvatures(xyz: Array, half: int, how: Array, variance: Array, valid: Array, out: Array) -> None:
    """Fill `out` (height, width, 9) with k1, k2, the normal, and the deviations of k1, k2, H and K where `valid`.

    `how` (13,) holds the weights of a window's moments (4), the variances of the five derivatives in units of a
    point's (5), the viewpoint and whether there is one (4). `variance` (height, width) is that of the points.
    A pixel without a tangent plane becomes invalid, in place.
    """
    height, width = valid.shape
    flat = xyz.reshape(height, 3 * width)
    w, gains, eye = how[:4], how[4:9], how[9:]
    down, across = np.empty((3, 3 * width)), np.empty((6, 3 * width))
    d, ray, n, change = np.empty((5, 3)), np.zeros(3), np.empty(3), np.empty((2, 5))
    for r in range(half, height - half):
        _moments(flat, r, half, down, across)
        for c in range(half, width - half):
            if not valid[r, c]:
                continue
            length = 0.0
            for k in range(3):
                j = 3 * (c - half) + k
                f, uu, vv = across[0, j], across[3, j], across[5, j]
                d[0, k], d[1, k] = w[0] * across[1, j], w[0] * across[2, j]
                d[2, k], d[3, k], d[4, k] = w[1] * f + w[2] * uu, w[3] * across[4, j], w[1] * f + w[2] * vv
                ray[k] = xyz[r, c, k] - eye[k]
                length += ray[k] * ray[k]
            if length > 0:
                size = 1.0 / sqrt(length)
                ray[0], ray[1], ray[2] = ray[0] * size, ray[1] * size, ray[2] * size
            k1, k2, ok = principal(d, ray, eye[3] == 0 or not length > 0, n, change)
            if not ok:
                valid[r, c] = False
                continue
            v1 = v2 = vH = vK = 0.0
            for i in range(5):
                one, two = change[0, i], change[1, i]
                v1 += gains[i] * one * one
                v2 += gains[i] * two * two
                vH += gains[i] * (one + two) ** 2
                vK += gains[i] * (k1 * two + k2 * one) ** 2
            noise = sqrt(variance[r, c])
            out[r, c, 0], out[r, c, 1] = k1, k2
            out[r, c, 2], out[r, c, 3], out[r, c, 4] = n[0], n[1], n[2]
            out[r, c, 5], out[r, c, 6] = noise * sqrt(v1), noise * sqrt(v2)
            out[r, c, 7], out[r, c, 8] = 0.5 * noise * sqrt(vH), noise * sqrt(vK)
