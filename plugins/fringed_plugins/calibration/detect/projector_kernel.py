"""The projector's coordinate at a point of the camera's picture, from the pixels around it.

Owns the weighted, robust fit of a quadratic surface in a round window.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit

TERMS = 6  # 1, x, y, x^2, x y, y^2 over the window's radius
_SOFT, _ROUNDS = 12, 18  # rounds of least absolute misfit, which bears a third of wrong orders, then Tukey's
_SETTLED = 0.03  # deviations that a round moves the value
_TUKEY = 4.7
_CLEAN = 0.75  # of the middle misfit: noise alone makes 0.67
_AGREE = 0.6  # the least share of a window's pixels: with fewer, nothing tells which of them are wrong
_LEAST_PIXELS = 60


@njit(cache=True, nogil=True, error_model="numpy")
def _sums(maps: Any, at: tuple[float, float, float], fitted: Any, scale: float, out: Any) -> int:
    """Add up the normal equations and return the pixels that count.

    With a positive `scale` pixels that many deviations off the last fit do not, with a negative one they all do, by
    one over what they are off.
    """
    value, sigma, rejected = maps
    cx, cy, radius = at
    normal, right, row = out
    normal[:] = 0.0
    right[:] = 0.0
    count = 0
    for r in range(max(0, int(cy - radius)), min(value.shape[0], int(cy + radius) + 2)):
        for c in range(max(0, int(cx - radius)), min(value.shape[1], int(cx + radius) + 2)):
            x, y = (c - cx) / radius, (r - cy) / radius
            if x * x + y * y > 1.0 or rejected[r, c] != 0 or not np.isfinite(value[r, c]) or not sigma[r, c] > 0.0:
                continue
            row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, x, y, x * x, x * y, y * y
            weight = 1.0 / (sigma[r, c] * sigma[r, c])
            if scale != 0.0:
                predicted = 0.0
                for i in range(TERMS):
                    predicted += row[i] * fitted[i]
                off = abs(value[r, c] - predicted) / (sigma[r, c] * abs(scale))
                if scale < 0.0:
                    weight /= max(off, 1.0)
                elif off >= 1.0:
                    continue
                else:
                    weight *= (1.0 - off * off) ** 2
            count += 1
            for i in range(TERMS):
                right[i] += weight * row[i] * value[r, c]
                for j in range(TERMS):
                    normal[i, j] += weight * row[i] * row[j]
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _misfit(maps: Any, at: tuple[float, float, float], fitted: Any, room: Any) -> tuple[float, int]:
    """Return the middle of |misfit| over its deviation, and the pixels of the window that count."""
    value, sigma, rejected = maps
    cx, cy, radius = at
    count = 0
    for r in range(max(0, int(cy - radius)), min(value.shape[0], int(cy + radius) + 2)):
        for c in range(max(0, int(cx - radius)), min(value.shape[1], int(cx + radius) + 2)):
            x, y = (c - cx) / radius, (r - cy) / radius
            if x * x + y * y > 1.0 or rejected[r, c] != 0 or not np.isfinite(value[r, c]) or not sigma[r, c] > 0.0:
                continue
            predicted = fitted[0] + fitted[1] * x + fitted[2] * y + fitted[3] * x * x + fitted[4] * x * y
            if count < room.size:
                room[count] = abs(value[r, c] - predicted - fitted[5] * y * y) / sigma[r, c]
                count += 1
    return (float(np.median(room[:count])), count) if count else (np.inf, 0)


@njit(cache=True, nogil=True, error_model="numpy")
def surface_rows(first: int, end: int, maps: Any, at: Any, out: Any) -> None:
    """Fit the points `first` to `end`; `maps` is (value, sigma, rejected), `at` (n, 3) x, y and radius px.

    `out` is (value, sigma, gradient (n, 2), misfit): the last is the middle of |misfit| over its deviation, 0.67 where
    nothing but noise is in it. NaN where too few pixels are left.
    """
    found, spread, gradient, misfit = out
    normal, right, row = np.empty((TERMS, TERMS)), np.empty(TERMS), np.empty(TERMS)
    fitted = np.zeros(TERMS)
    for k in range(first, end):
        place = (at[k, 0], at[k, 1], at[k, 2])
        room = np.empty(int(4.0 * (place[2] + 2.0) ** 2) + 16)
        found[k], spread[k], misfit[k] = np.nan, np.nan, np.nan
        gradient[k, :] = np.nan
        sums = (normal, right, row)
        count = _sums(maps, place, fitted, 0.0, sums)
        every, middle, before, soft = count, np.inf, np.inf, True
        for number in range(_ROUNDS):
            if count < _LEAST_PIXELS:
                break
            for i in range(TERMS):
                normal[i, i] *= 1.0 + 1e-10
            fitted[:] = np.linalg.solve(normal, right)
            middle, _pixels = _misfit(maps, place, fitted, room)
            settled = abs(fitted[0] - before) < _SETTLED / sqrt(normal[0, 0])
            before = fitted[0]
            if soft and number < _SOFT and middle > _CLEAN and not settled:
                count = _sums(maps, place, fitted, -1.0, sums)
                continue
            count = _sums(maps, place, fitted, _TUKEY * max(middle / 0.6745, 1.0), sums)
            if settled and not soft:
                break
            soft = False
        if count < max(_LEAST_PIXELS, _AGREE * every):
            continue
        fitted[:] = np.linalg.solve(normal, right)
        covariance = np.linalg.inv(normal)
        found[k], misfit[k] = fitted[0], middle
        spread[k] = sqrt(max(covariance[0, 0], 0.0)) * max(middle / 0.6745, 1.0)
        gradient[k, 0], gradient[k, 1] = fitted[1] / place[2], fitted[2] / place[2]
