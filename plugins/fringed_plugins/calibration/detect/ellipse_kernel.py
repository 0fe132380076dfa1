"""A blurred ellipse fitted to the grey levels around it: centre, shape, blur and light at once.

Owns the loop of Gauss and Newton on one window; `ellipses` prepares them. The picture of a mark is
L (G + (M - G) e(d, w)): light L = 1 + lx x + ly y, ground G, mark M, d the distance from the ellipse |A (x - c)| = 1,
e what a pixel sees of an edge that a lens has blurred by w. Least squares on it has the least variance that noise
allows, and light that falls off does not pull the centre.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.calibration.detect.edge_kernel import edge

PARAMETERS = 10  # cx, cy, a11, a12, a22, w, G, M, lx, ly
_LIGHT = 6  # the first parameter that matters away from the edge
_LEAST_BLUR = 0.05
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def _model(p: Any, start: Any, x: float, y: float, row: Any) -> tuple[float, int]:
    """Return the grey level at (x, y) and the first parameter that moves it; write its derivatives to `row`.

    Light is counted from where the fit started, so that away from the edge nothing but light and levels matters.
    """
    rx, ry = x - p[0], y - p[1]
    mx, my = p[2] * rx + p[3] * ry, p[3] * rx + p[4] * ry
    q = sqrt(mx * mx + my * my)
    q = max(q, 1e-6)
    hx, hy = (p[2] * mx + p[3] * my) / q, (p[3] * mx + p[4] * my) / q  # the gradient of q
    steep = sqrt(hx * hx + hy * hy)
    steep = max(steep, 1e-12)
    inside, by_distance, by_blur = edge((q - 1.0) / steep, hx / steep, hy / steep, p[5])
    lx, ly = x - start[0], y - start[1]
    light = 1.0 + p[8] * lx + p[9] * ly
    value = p[6] + (p[7] - p[6]) * inside
    row[6] = light * (1.0 - inside)
    row[7] = light * inside
    row[8] = value * lx
    row[9] = value * ly
    if by_distance == 0.0 and by_blur == 0.0:
        return light * value, _LIGHT
    by_d = -light * (p[7] - p[6]) * by_distance
    row[0] = -by_d * hx / steep
    row[1] = -by_d * hy / steep
    row[2] = by_d * mx * rx / (q * steep)
    row[3] = by_d * (mx * ry + my * rx) / (q * steep)
    row[4] = by_d * my * ry / (q * steep)
    row[5] = -light * (p[7] - p[6]) * by_blur
    return light * value, 0


@njit(**_options)
def _sums(image: Any, window: Any, reach: float, p: Any, out: Any) -> tuple[float, int]:
    """Add up the normal equations of one window; return the squared misfit and the pixels that count."""
    normal, right, row, start = out
    normal[:] = 0.0
    right[:] = 0.0
    total, count = 0.0, 0
    for r in range(window[0], window[1]):
        for c in range(window[2], window[3]):
            rx, ry = c - start[0], r - start[1]
            mx, my = start[2] * rx + start[3] * ry, start[3] * rx + start[4] * ry
            if mx * mx + my * my > reach * reach or not np.isfinite(image[r, c]):
                continue
            value, first = _model(p, start, float(c), float(r), row)
            off = image[r, c] - value
            total += off * off
            count += 1
            for i in range(first, PARAMETERS):
                right[i] += row[i] * off
                for j in range(first, i + 1):
                    normal[i, j] += row[i] * row[j]
    for i in range(PARAMETERS):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return total, count


@njit(**_options)
def _acceptable(p: Any, start: Any) -> bool:
    """Whether parameters are still those of the mark that was looked at."""
    grown = (p[2] * p[4] - p[3] * p[3]) / (start[2] * start[4] - start[3] * start[3])
    mx = start[2] * (p[0] - start[0]) + start[3] * (p[1] - start[1])
    my = start[3] * (p[0] - start[0]) + start[4] * (p[1] - start[1])
    return bool(p[5] > 0.0 and p[2] > 0.0 and p[4] > 0.0 and 0.25 < grown < 4.0 and mx * mx + my * my < 0.3)


@njit(**_options)
def _window(start: Any, reach: float, shape: Any) -> Any:
    """Return the rows and columns that hold an ellipse, `reach` times as large."""
    det = start[2] * start[4] - start[3] * start[3]
    hx = reach * sqrt(start[3] ** 2 + start[4] ** 2) / det
    hy = reach * sqrt(start[2] ** 2 + start[3] ** 2) / det
    return (
        max(0, int(start[1] - hy)), min(shape[0], int(start[1] + hy) + 2),
        max(0, int(start[0] - hx)), min(shape[1], int(start[0] + hx) + 2),
    )  # fmt: skip


@njit(**_options)
def _fit(image: Any, window: Any, reach: float, p: Any, sums: Any) -> bool:
    """Improve `p` until it moves no more, by damped steps; return whether it stayed with the mark."""
    normal, right, _, start = sums
    tried, damped = np.empty(PARAMETERS), np.empty((PARAMETERS, PARAMETERS))
    best, slope = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    total, count = _sums(image, window, reach, p, sums)
    best[:], slope[:] = normal, right
    damping = 1e-3
    for _ in range(40 if count > 3 * PARAMETERS else 0):
        damped[:] = best
        for i in range(PARAMETERS):
            damped[i, i] = damped[i, i] * (1.0 + damping) + 1e-12
        tried[:] = p + np.linalg.solve(damped, slope)
        tried[5] = max(tried[5], _LEAST_BLUR)
        now = np.inf
        if _acceptable(tried, start):
            now, count = _sums(image, window, reach, tried, sums)
        small = abs(tried[0] - p[0]) + abs(tried[1] - p[1]) < 1e-4 and abs(total - now) < 1e-6 * total
        if now <= total:
            p[:] = tried
            total = now
            best[:], slope[:] = normal, right
            damping *= 0.2
        else:
            damping *= 10.0
        if small or damping > 1e8:
            break
    return bool(count > 3 * PARAMETERS and _acceptable(p, start))


@njit(**_options)
def fit_ellipses(first: int, end: int, image: Any, starts: Any, reach: float, out: Any) -> None:
    """Fit the ellipses `first` to `end` from `starts` (n, 10); write them, deviations and misfits.

    `out` is (fitted (n, 10), sigma (n, 2) of the centre, misfit (n,) RMS in grey levels; NaN where it failed).
    """
    fitted, sigma, misfit = out
    normal, right, row = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS), np.empty(PARAMETERS)
    for k in range(first, end):
        p, start = fitted[k], starts[k]
        p[:] = start
        sigma[k, :] = np.nan
        misfit[k] = np.nan
        window = _window(start, reach, image.shape)
        sums = (normal, right, row, start)
        if not _fit(image, window, reach, p, sums):
            continue
        total, count = _sums(image, window, reach, p, sums)
        variance = total / max(count - PARAMETERS, 1)
        for i in range(PARAMETERS):
            normal[i, i] += 1e-12 * (1.0 + normal[i, i])
        covariance = np.linalg.inv(normal)
        sigma[k, 0] = sqrt(max(covariance[0, 0] * variance, 0.0))
        sigma[k, 1] = sqrt(max(covariance[1, 1] * variance, 0.0))
        misfit[k] = sqrt(variance)
