"""Kernels between pixels and the rays that a lens with Brown's distortion takes to them.

Lenses are packed; see `optics.packed`.
"""

from __future__ import annotations

from typing import Any

from numba import njit


@njit(cache=True, nogil=True)
def pixel_ray(xd: float, yd: float, guess: tuple[float, float], lens: Any) -> tuple[float, float]:
    """Return the normalised coordinates that Brown's distortion takes to (xd, yd), by fixed-point iteration."""
    x, y = guess
    for _ in range(40):
        r2 = x * x + y * y
        scale = 1.0 / (1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8])))
        xn = (xd - 2.0 * lens[6] * x * y - lens[7] * (r2 + 2.0 * x * x)) * scale
        yn = (yd - lens[6] * (r2 + 2.0 * y * y) - 2.0 * lens[7] * x * y) * scale
        step = abs(xn - x) + abs(yn - y)
        x, y = xn, yn
        if step < 1e-11:
            break
    return x, y


@njit(cache=True, nogil=True)
def ray_pixel(x: float, y: float, lens: Any) -> tuple[float, float]:
    """Return the pixel (column, row) of normalised coordinates."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
    xd = x * radial + 2.0 * lens[6] * x * y + lens[7] * (r2 + 2.0 * x * x)
    yd = y * radial + lens[6] * (r2 + 2.0 * y * y) + 2.0 * lens[7] * x * y
    return lens[0] * xd + lens[2], lens[1] * yd + lens[3]


@njit(cache=True, nogil=True)
def points_rows(first: int, end: int, lens: Any, depth: Any, out: Any) -> None:
    """Turn depth (height, width) into points (height, width, 3) on the pixels' rays."""
    for r in range(first, end):
        yd, ahead, below = (r - lens[3]) / lens[1], 0.0, 0.0
        for c in range(depth.shape[1]):
            xd = (c - lens[2]) / lens[0]
            x, y = pixel_ray(xd, yd, (xd + ahead, yd + below), lens)
            ahead, below = x - xd, y - yd
            out[r, c, 0], out[r, c, 1], out[r, c, 2] = x * depth[r, c], y * depth[r, c], depth[r, c]
