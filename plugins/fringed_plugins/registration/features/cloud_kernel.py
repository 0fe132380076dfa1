"""Kernel of quadrics through the neighbours of points that have no grid.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import acos, atan2, cos, pi, sqrt
from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.compiled import kept
from fringed_plugins.registration.features import forms_kernel
from fringed_plugins.registration.features.forms_kernel import principal

Array = np.ndarray[Any, Any]
FLAT = 1e-6  # of the largest: a smaller second eigenvalue is a line
PIVOT = 1e-6  # a quadratic's smallest pivot, of radius one: below, its points lie on a conic


@njit(cache=True, nogil=True, error_model="numpy")
def _least(a: Array, axes: Array) -> bool:
    """Fill `axes` (3, 3) with a basis whose last row is the eigenvector of the least eigenvalue of `a` (3, 3).

    False where the two smaller eigenvalues vanish: coincident points, or a line. By the cubic's trigonometric roots.
    """
    mean = (a[0, 0] + a[1, 1] + a[2, 2]) / 3
    x, y, z = a[0, 0] - mean, a[1, 1] - mean, a[2, 2] - mean
    p, q, r = a[0, 1], a[0, 2], a[1, 2]
    size = sqrt((x * x + y * y + z * z + 2 * (p * p + q * q + r * r)) / 6)
    if not size > 0:
        return False
    det = x * (y * z - r * r) - p * (p * z - r * q) + q * (p * r - y * q)
    angle = acos(min(1.0, max(-1.0, 0.5 * det / size**3))) / 3
    largest = mean + 2 * size * cos(angle)
    least = mean + 2 * size * cos(angle + 2 * pi / 3)
    if 3 * mean - largest - least < FLAT * largest:
        return False
    x, y, z = a[0, 0] - least, a[1, 1] - least, a[2, 2] - least
    best = 0.0
    for u0, u1, u2, v0, v1, v2 in ((x, p, q, p, y, r), (x, p, q, q, r, z), (p, y, r, q, r, z)):
        w0, w1, w2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
        square = w0 * w0 + w1 * w1 + w2 * w2
        if square > best:
            best = square
            axes[2, 0], axes[2, 1], axes[2, 2] = w0, w1, w2
    if not best > 0:
        return False
    n = axes[2]
    n /= sqrt(best)
    sign = 1.0 if n[2] >= 0 else -1.0  # Duff et al. 2017: a basis without a case
    m = -1.0 / (sign + n[2])
    axes[0, 0], axes[0, 1], axes[0, 2] = 1 + sign * n[0] * n[0] * m, sign * n[0] * n[1] * m, -sign * n[0]
    axes[1, 0], axes[1, 1], axes[1, 2] = n[0] * n[1] * m, sign + n[1] * n[1] * m, -n[1]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse(a: Array, low: Array, out: Array) -> bool:
    """Fill `out` with the inverse of a symmetric `a` (6, 6) by Cholesky's factor `low`; False where it is singular."""
    for i in range(6):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= low[i, k] * low[j, k]
            if i > j:
                low[i, j] = total / low[j, j]
            elif total > PIVOT * a[0, 0]:
                low[i, i] = sqrt(total)
            else:
                return False
    for c in range(6):
        for i in range(6):
            total = 1.0 if i == c else 0.0
            for k in range(i):
                total -= low[i, k] * out[k, c]
            out[i, c] = total / low[i, i]
        for i in range(5, -1, -1):
            total = out[i, c]
            for k in range(i + 1, 6):
                total -= low[k, i] * out[k, c]
            out[i, c] = total / low[i, i]
    return True


@njit(cache=True, nogil=True)
def _widest(local: Array, angles: Array) -> float:
    """Return the largest angle in radians between the directions (x, y) of `local` (m, 3) that follow each other."""
    m = 0
    for k in range(local.shape[0]):
        x, y = local[k, 0], local[k, 1]
        if x == 0 and y == 0:
            continue
        value = atan2(y, x)
        at = m
        while at > 0 and angles[at - 1] > value:
            angles[at] = angles[at - 1]
            at -= 1
        angles[at] = value
        m += 1
    if m < 2:
        return 2 * pi
    widest: float = angles[0] + 2 * pi - angles[m - 1]
    for k in range(1, m):
        widest = max(widest, angles[k] - angles[k - 1])
    return widest


@njit(cache=True, nogil=True, error_model="numpy")
def _quadric(local: Array, work: Array, c: Array) -> float:
    """Fit z = c0 + c1 x + c2 y + c3 x^2 + c4 x y + c5 y^2 to `local` (m, 3); return the sum of squares that is left.

    `work` (3, 6, 6) gets the normal equations and their inverse, the last; negative where they are singular.
    """
    a, right, row = work[0], np.zeros(6), np.empty(6)
    a[:] = 0
    for k in range(local.shape[0]):
        x, y, z = local[k, 0], local[k, 1], local[k, 2]
        row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, x, y, x * x, x * y, y * y
        for i in range(6):
            right[i] += row[i] * z
            for j in range(i + 1):
                a[i, j] += row[i] * row[j]
    if not _inverse(a, work[1], work[2]):
        return -1.0
    for i in range(6):
        c[i] = 0.0
        for j in range(6):
            c[i] += work[2, i, j] * right[j]
    left = 0.0
    for k in range(local.shape[0]):
        x, y, z = local[k, 0], local[k, 1], local[k, 2]
        off = z - (c[0] + x * (c[1] + c[3] * x + c[4] * y) + y * (c[2] + c[5] * y))
        left += off * off
    return left


@njit(cache=True, nogil=True, error_model="numpy")
def _local(points: Array, around: Array, axes: Array, local: Array) -> float:
    """Fill `local` (m, 3) with the neighbours `around` (m,) relative to the first, in units of the farthest one's way.

    In a frame `axes` of the directions of least variance; return the unit, negative where there is no such frame.
    """
    centre, spread, radius = points[around[0]], np.zeros((3, 3)), 0.0
    middle = np.zeros(3)
    for k in range(around.size):
        for i in range(3):
            local[k, i] = points[around[k], i] - centre[i]
            middle[i] += local[k, i] / around.size
    for k in range(around.size):
        square = 0.0
        for i in range(3):
            square += local[k, i] ** 2
            for j in range(3):
                spread[i, j] += (local[k, i] - middle[i]) * (local[k, j] - middle[j])
        radius = max(radius, square)
    if not radius > 0 or not _least(spread, axes):
        return -1.0
    radius = sqrt(radius)
    for k in range(around.size):
        x, y, z = local[k, 0] / radius, local[k, 1] / radius, local[k, 2] / radius
        for i in range(3):
            local[k, i] = axes[i, 0] * x + axes[i, 1] * y + axes[i, 2] * z
    return radius


@kept(forms_kernel, nogil=True, error_model="numpy")
def fit(points: Array, near: Array, out: Array) -> None:
    """Fill `out` (m, 10) of the points near[:, 0] with their neighbours `near` (m, k), each point its own first.

    k1, k2, normal, residual's deviation, deviations of k1, k2 and of the slope for points with a deviation of one,
    and the widest gap in radians. The gap is NaN without a tangent plane, k1 to sigma where the quadric is singular.
    """
    k = near.shape[1]
    local, angles, work, c = np.empty((k, 3)), np.empty(k), np.zeros((3, 6, 6)), np.empty(6)
    axes, d, n, change = np.empty((3, 3)), np.zeros((5, 3)), np.empty(3), np.empty((2, 5))
    scale = np.array([1.0, 1.0, 2.0, 1.0, 2.0])
    d[0, 0] = d[1, 1] = 1.0
    for at in range(near.shape[0]):
        out[at] = np.nan
        radius = _local(points, near[at], axes, local)
        if radius < 0:
            continue
        out[at, 2:5] = axes[2]
        out[at, 9] = _widest(local[1:], angles)
        left = _quadric(local, work, c)
        if left < 0:
            continue
        for i in range(5):
            d[i, 2] = scale[i] * c[i + 1]
        k1, k2, ok = principal(d, n, True, n, change)
        if not ok:
            continue
        for i in range(3):  # the form's normal looks down the frame's last axis: the caller turns both together
            out[at, 2 + i] = n[0] * axes[0, i] + n[1] * axes[1, i] + n[2] * axes[2, i]
        v1 = v2 = 0.0
        for i in range(5):
            for j in range(5):
                covariance = scale[i] * scale[j] * work[2, i + 1, j + 1]
                v1 += change[0, i] * change[0, j] * covariance
                v2 += change[1, i] * change[1, j] * covariance
        unit = 1.0 / radius
        out[at, 0], out[at, 1] = k1 * unit, k2 * unit
        out[at, 5] = radius * sqrt(left / max(k - 6, 1))
        out[at, 6], out[at, 7] = sqrt(max(v1, 0.0)) * unit * unit, sqrt(max(v2, 0.0)) * unit * unit
        out[at, 8] = sqrt(0.5 * (work[2, 1, 1] + work[2, 2, 2])) * unit
