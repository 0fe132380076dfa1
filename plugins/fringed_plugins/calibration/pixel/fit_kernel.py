"""Kernel: one smooth curve from phase to depth for each pixel, through planes, without those that do not fit.

Owns the loops over pixels and the small systems of equations; `fit` prepares them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

MOST_TERMS = 6
_ROUNDS = 4
_NEAREST_POLE = 0.02
_options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


class Wanted(NamedTuple):
    """What is fitted: z = (a + b p) / (1 + c p), or a polynomial, of p = (phase - offset) scale."""

    rational: bool
    terms: int
    offset_rad: float
    scale: float
    tolerance_mm: float  # of a plane; beyond, it is dropped, where more planes than terms + 1 are left


@njit(**_options)
def _solve(a: Any, b: Any, terms: int) -> bool:
    """Solve the equations in place, by elimination with pivots; False where they are singular."""
    for i in range(terms):
        best = i
        for j in range(i + 1, terms):
            best = j if abs(a[j, i]) > abs(a[best, i]) else best
        if not abs(a[best, i]) > 1e-13:
            return False
        for k in range(terms):
            a[i, k], a[best, k] = a[best, k], a[i, k]
        b[i], b[best] = b[best], b[i]
        for j in range(i + 1, terms):
            factor = a[j, i] / a[i, i]
            for k in range(i, terms):
                a[j, k] -= factor * a[i, k]
            b[j] -= factor * b[i]
    for i in range(terms - 1, -1, -1):
        for k in range(i + 1, terms):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    return True


@njit(**_options)
def _curve(t: Any, y: Any, use: Any, wanted: Any, room: Any) -> bool:
    """Fit the used samples by least squares; the coefficients are in `room`'s last array.

    The rational form is made linear, y (1 + c t) = a + b t, and weighted with what it was multiplied by, in a few
    rounds (Sanathanan & Koerner 1963).
    """
    matrix, row, found = room
    terms = wanted.terms
    slope = 0.0
    for _ in range(_ROUNDS if wanted.rational else 1):
        matrix[:, :] = 0.0
        found[:] = 0.0
        for j in range(t.size):
            if not use[j]:
                continue
            row[0] = 1.0
            for n in range(1, terms):
                row[n] = row[n - 1] * t[j]
            weight = 1.0
            if wanted.rational:
                row[2] = -t[j] * y[j]
                below = 1.0 + slope * t[j]
                if below < _NEAREST_POLE:
                    return False
                weight = 1.0 / (below * below)
            for n in range(terms):
                for m in range(terms):
                    matrix[n, m] += weight * row[n] * row[m]
                found[n] += weight * row[n] * y[j]
        if not _solve(matrix, found, terms):
            return False
        slope = found[2] if wanted.rational else 0.0
    return True


@njit(**_options)
def _worst(t: Any, y: Any, use: Any, wanted: Any, found: Any) -> Any:
    """Return the largest error of a used sample."""
    worst = 0.0
    for j in range(t.size):
        if not use[j]:
            continue
        if wanted.rational:
            below = 1.0 + found[2] * t[j]
            value = (found[0] + found[1] * t[j]) / below
            value = value if below > _NEAREST_POLE else np.inf
        else:
            value = 0.0
            for n in range(wanted.terms - 1, -1, -1):
                value = value * t[j] + found[n]
        worst = max(worst, abs(value - y[j]))
    return worst


@njit(**_options)
def _robust(t: Any, y: Any, use: Any, limit: float, wanted: Any, room: Any) -> bool:
    """Fit, and drop one sample after the other until the rest is within `limit`; False where that cannot be."""
    found = room[2]
    left = 0
    for j in range(t.size):
        left += 1 if use[j] else 0
    while left >= wanted.terms:
        if _curve(t, y, use, wanted, room) and _worst(t, y, use, wanted, found) <= limit:
            return True
        if left <= wanted.terms + 1:  # whichever one is dropped, the rest fits
            return False
        best, least = -1, np.inf
        for j in range(t.size):
            if use[j]:
                use[j] = False
                if _curve(t, y, use, wanted, room):
                    worst = _worst(t, y, use, wanted, found)
                    best, least = (j, worst) if worst < least else (best, least)
                use[j] = True
        if best < 0:
            return False
        use[best] = False
        left -= 1
    return False


@njit(**_options)
def _unscaled(found: Any, middle: Any, half: Any, wanted: Any, out: Any) -> None:
    """Write the coefficients for p and z of those for t = (p - p0) / ps and y = (z - z0) / zs."""
    p0, z0 = middle
    ps, zs = half
    if wanted.rational:
        a, b, c = found[0] - found[1] * p0 / ps, found[1] / ps, found[2] / ps
        unit = 1.0 - c * p0
        out[0], out[1], out[2] = z0 + zs * a / unit, (zs * b + z0 * c) / unit, c / unit
        return
    for n in range(wanted.terms):
        out[n] = 0.0
    for n in range(wanted.terms - 1, -1, -1):  # Horner's scheme, with polynomials for numbers
        for m in range(wanted.terms - 1, 0, -1):
            out[m] = out[m - 1] / ps - out[m] * p0 / ps
        out[0] = zs * found[n] - out[0] * p0 / ps
    out[0] += z0


@njit(cache=True, **_options)
def fit_rows(start: int, stop: int, seen: Any, wanted: Any, out: Any) -> None:
    """Write the coefficients (terms, height, width) of rows `start` to `stop` to `out`, NaN where there are none.

    `seen` is (phases, rays, planes): phases (k, height, width) are NaN where a plane is not seen, planes (k, 4) are
    nx, ny, nz, d.
    """
    phases, rays, planes = seen
    count = phases.shape[0]
    t, y, use = np.empty(count), np.empty(count), np.empty(count, np.bool_)
    room = (np.empty((MOST_TERMS, MOST_TERMS)), np.empty(MOST_TERMS), np.empty(MOST_TERMS))
    for row in range(start, stop):
        for i in range(phases.shape[2]):
            x, v = np.float64(rays[0, row, i]), np.float64(rays[1, row, i])
            low, high, near, far, left = np.inf, -np.inf, np.inf, -np.inf, 0
            for j in range(count):
                t[j] = (np.float64(phases[j, row, i]) - wanted.offset_rad) * wanted.scale
                y[j] = planes[j, 3] / (planes[j, 0] * x + planes[j, 1] * v + planes[j, 2])
                use[j] = abs(t[j]) < np.inf and y[j] > 0 and y[j] < np.inf
                if use[j]:
                    low, high, left = min(low, t[j]), max(high, t[j]), left + 1
                    near, far = min(near, y[j]), max(far, y[j])
            out[:, row, i] = np.nan
            if left < wanted.terms or not high > low or not far > near:
                continue
            middle, half = ((low + high) / 2, (near + far) / 2), ((high - low) / 2, (far - near) / 2)
            for j in range(count):
                t[j], y[j] = (t[j] - middle[0]) / half[0], (y[j] - middle[1]) / half[1]
            if _robust(t, y, use, wanted.tolerance_mm / half[1], wanted, room):
                _unscaled(room[2], middle, half, wanted, out[:, row, i])
