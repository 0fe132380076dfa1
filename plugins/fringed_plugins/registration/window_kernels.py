"""Kernels that build patches: least squares of windows, what they cut off, and what a sample of them is.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit, prange

Array = np.ndarray[Any, Any]
ROWS = 16  # of one band


@njit(cache=True, fastmath=True)
def _moments(flat: Array, row: int, half: int, down: Array, across: Array) -> None:
    """Fill `across` (6, width x 3) with sums of f, u f, v f, u^2 f, u v f, v^2 f over windows of one row.

    `flat` (height, width x 3); first down the columns, into `down` (3, width x 3), then along the row.
    """
    down[:] = 0
    across[:] = 0
    d0, d1, d2 = down[0], down[1], down[2]
    for v in range(-half, half + 1):
        w, w2 = np.float32(v), np.float32(v * v)
        line = flat[row + v]
        for j in range(line.size):
            d0[j] += line[j]
            d1[j] += w * line[j]
            d2[j] += w2 * line[j]
    inner = d0.size - 6 * half
    for u in range(-half, half + 1):
        w, w2, first = np.float32(u), np.float32(u * u), 3 * (half + u)
        a, b, c = d0[first : first + inner], d1[first : first + inner], d2[first : first + inner]
        out = across[:, 3 * half : 3 * half + inner]
        m00, m10, m01, m20, m11, m02 = out[0], out[1], out[2], out[3], out[4], out[5]
        for j in range(inner):
            m00[j] += a[j]
            m10[j] += w * a[j]
            m20[j] += w2 * a[j]
        for j in range(inner):
            m01[j] += b[j]
            m11[j] += w * b[j]
            m02[j] += c[j]


@njit(cache=True, parallel=True)
def build(xyz: Array, half: int, w: Array, usable: Array, steep: float, table: Array) -> None:
    """Fill `table` (height, width, 15) from windows of 2 half + 1 pixels where `usable`; `w` is a `quadratic`'s.

    Where the squares of both tangents add up to more than `steep`, the point is the measured one.
    """
    height, width = usable.shape
    flat = xyz.reshape(height, 3 * width)
    w0, w1, w2 = np.float32(w[0]), np.float32(w[1]), np.float32(w[2])
    a0, a1, a2 = np.float32(2 * w[3]), np.float32(2 * w[4]), np.float32(2 * w[5])
    b0, b1, b2 = np.float32(2 * w[6]), np.float32(2 * w[7]), np.float32(2 * w[8])
    slope, twist = np.float32(w[9]), np.float32(w[10])
    for band in prange((height + ROWS - 1) // ROWS):
        x = np.empty(18, np.float32)
        down, across = np.empty((3, 3 * width), np.float32), np.empty((6, 3 * width), np.float32)
        for r in range(max(half, band * ROWS), min(height - half, (band + 1) * ROWS)):
            _moments(flat, r, half, down, across)
            for c in range(half, width - half):
                if not usable[r, c]:
                    continue
                for k in range(3):
                    j = 3 * c + k
                    p, q, s = across[0, j], across[3, j], across[5, j]
                    x[k] = w0 * p + w1 * q + w2 * s
                    x[3 + k] = slope * across[1, j]
                    x[6 + k] = slope * across[2, j]
                    x[9 + k] = a0 * p + a1 * q + a2 * s
                    x[12 + k] = twist * across[4, j]
                    x[15 + k] = b0 * p + b1 * q + b2 * s
                # rows x columns points towards the sensor
                nx = x[7] * x[5] - x[8] * x[4]
                ny = x[8] * x[3] - x[6] * x[5]
                nz = x[6] * x[4] - x[7] * x[3]
                length = sqrt(nx * nx + ny * ny + nz * nz)
                if length <= 0:
                    usable[r, c] = False
                    continue
                nx, ny, nz = nx / length, ny / length, nz / length
                keep = x[3] * x[3] + x[4] * x[4] + x[5] * x[5] + x[6] * x[6] + x[7] * x[7] + x[8] * x[8] > steep
                for k in range(9):
                    table[r, c, k] = xyz[r, c, k] if keep and k < 3 else x[k]
                table[r, c, 9], table[r, c, 10], table[r, c, 11] = nx, ny, nz
                table[r, c, 12] = x[9] * nx + x[10] * ny + x[11] * nz
                table[r, c, 13] = x[12] * nx + x[13] * ny + x[14] * nz
                table[r, c, 14] = x[15] * nx + x[16] * ny + x[17] * nz


@njit(cache=True, inline="always")
def _middle(usable: Array, r: int, c: int, down: int, across: int) -> int:
    """Return how many steps of (down, across) from a pixel three usable ones have their middle: 0, 1, -1, or 9."""
    height, width = usable.shape
    for step in (0, 1, -1):
        r0, c0, r1, c1 = r + (step - 1) * down, c + (step - 1) * across, r + (step + 1) * down, c + (step + 1) * across
        if r0 < 0 or c0 < 0 or r1 >= height or c1 >= width:
            continue
        if usable[r0, c0] and usable[r0 + down, c0 + across] and usable[r1, c1]:
            return step
    return 9


@njit(cache=True)
def truncations(table: Array, usable: Array, along: float, across: float, out: Array) -> None:
    """Fill the last of `out` (height, width, 2) with the mean square of the distance that third derivatives add.

    `along` and `across` are the mean squares of a unit of x_uuu and of x_uvv between the middle and the edge. The
    third derivatives are second differences of the tangents; at a rim those of the pixel next to it.
    """
    height, width = usable.shape
    for r in range(height):
        for c in range(width):
            if not usable[r, c]:
                out[r, c, 1] = 0.0
                continue
            total = 0.0
            for axis in range(2):
                down, right = axis, 1 - axis
                step = _middle(usable, r, c, down, right)
                if step == 9:
                    continue
                y, x = r + step * down, c + step * right
                here, before, after = table[y, x], table[y - down, x - right], table[y + down, x + right]
                a = b = 0.0
                for k in range(3):
                    n = here[9 + k]
                    a += n * (after[3 + k] - 2.0 * here[3 + k] + before[3 + k])
                    b += n * (after[6 + k] - 2.0 * here[6 + k] + before[6 + k])
                if axis == 0:
                    total += along * a * a + across * b * b
                else:
                    total += along * b * b + across * a * a
            out[r, c, 1] = total


@njit(cache=True)
def gather(table: Array, pixels: Array, out: Array) -> None:
    """Fill `out` (n, 7) with points, normals and areas of a pixel at flat `pixels` (n,) of `table` (pixels, 15)."""
    for i in range(len(pixels)):
        t = table[pixels[i]]
        for k in range(3):
            out[i, k], out[i, 3 + k] = t[k], t[9 + k]
        x, y, z = t[4] * t[8] - t[5] * t[7], t[5] * t[6] - t[3] * t[8], t[3] * t[7] - t[4] * t[6]
        out[i, 6] = sqrt(x * x + y * y + z * z)
