"""Kernels on patches: build them, walk to feet of perpendiculars, sum up the normal equations.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit, prange

Array = np.ndarray[Any, Any]
ROWS = 16  # of one band
MOST_STEPS = 5
NEAR = 0.6  # of a pixel: half would let a foot on the edge walk to and fro
FACING_COS = 0.7
SUMS = 29  # 21 of H's upper triangle, 6 of the gradient, weights, weighted squares


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
def build(xyz: Array, half: int, w: Array, usable: Array, table: Array) -> None:
    """Fill `table` (height, width, 15) from windows of 2 half + 1 pixels where `usable`; `w` is a `quadratic`'s."""
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
                for k in range(9):
                    table[r, c, k] = x[k]
                table[r, c, 9], table[r, c, 10], table[r, c, 11] = nx, ny, nz
                table[r, c, 12] = x[9] * nx + x[10] * ny + x[11] * nz
                table[r, c, 13] = x[12] * nx + x[13] * ny + x[14] * nz
                table[r, c, 14] = x[15] * nx + x[16] * ny + x[17] * nz


@njit(cache=True, inline="always")
def _foot(
    place: tuple[float, float, float], c: int, r: int, table: Array, usable: Array
) -> tuple[int, int, float, float]:
    """Walk from pixel (c, r) to the foot of a place: its pixel and the way on from there; r is -1 without one."""
    height, width = usable.shape
    x, y, z = place
    du = dv = 0.0
    for _ in range(MOST_STEPS):
        if not usable[r, c]:
            return c, -1, du, dv
        t = table[r, c]
        ox, oy, oz = x - t[0], y - t[1], z - t[2]
        E = t[3] * t[3] + t[4] * t[4] + t[5] * t[5]
        F = t[3] * t[6] + t[4] * t[7] + t[5] * t[8]
        G = t[6] * t[6] + t[7] * t[7] + t[8] * t[8]
        d = ox * t[9] + oy * t[10] + oz * t[11]
        # the foot on the quadratic, not on its plane: the form is I - d II
        A, B, D = E - d * t[12], F - d * t[13], G - d * t[14]
        det = A * D - B * B
        if det <= 0.1 * (E * G - F * F):
            A, B, D = E, F, G
            det = E * G - F * F
        a = ox * t[3] + oy * t[4] + oz * t[5]
        b = ox * t[6] + oy * t[7] + oz * t[8]
        du, dv = (D * a - B * b) / det, (A * b - B * a) / det
        if abs(du) <= NEAR and abs(dv) <= NEAR:
            return c, r, du, dv
        nc, nr = int(np.floor(c + du + 0.5)), int(np.floor(r + dv + 0.5))
        if nc < 0 or nr < 0 or nc >= width or nr >= height:
            return c, -1, du, dv
        c, r = nc, nr
    if not usable[r, c] or abs(du) > 1.0 or abs(dv) > 1.0:
        return c, -1, du, dv
    return c, r, du, dv


@njit(cache=True, inline="always")
def _normal(t: Array, du: float, dv: float) -> tuple[float, float, float, float, float]:
    """Return the unit normal of a patch at (du, dv) by Weingarten's equations, its cosine to the middle's, the area."""
    E = t[3] * t[3] + t[4] * t[4] + t[5] * t[5]
    F = t[3] * t[6] + t[4] * t[7] + t[5] * t[8]
    G = t[6] * t[6] + t[7] * t[7] + t[8] * t[8]
    det = E * G - F * F
    lu, lv = t[12] * du + t[13] * dv, t[13] * du + t[14] * dv
    a, b = (G * lu - F * lv) / det, (E * lv - F * lu) / det
    nx = t[9] - a * t[3] - b * t[6]
    ny = t[10] - a * t[4] - b * t[7]
    nz = t[11] - a * t[5] - b * t[8]
    scale = 1.0 / sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale, (nx * t[9] + ny * t[10] + nz * t[11]) * scale, sqrt(det)


@njit(cache=True, parallel=True)
def walk(model: Array, transforms: Array, table: Array, usable: Array, found: Array, out: Array) -> None:
    """Find the foot of each moved point: `found` its flat pixel or -1, `out` (n, 8) point, its normal, distance, area.

    `model` (n, 6) points and normals; `transforms` (7, 4) the motion's four rows and the projection's three.
    Projects where `found` knows no pixel of the last time, then walks in the tangent plane until the foot lies
    within a pixel. A foot stays on its patch as long as it can: on the edge of two it would swing for ever.
    """
    height, width = usable.shape
    T, P = transforms[:4], transforms[4:]
    for i in prange(len(model)):
        last = found[i]
        found[i] = -1
        px, py, pz, mx, my, mz = model[i, 0], model[i, 1], model[i, 2], model[i, 3], model[i, 4], model[i, 5]
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        c, r = last % width, last // width
        if last < 0:
            depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
            if depth < 1e-6:
                continue
            u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
            v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
            if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
                continue
            c, r = int(u + 0.5), int(v + 0.5)
        c, r, du, dv = _foot((x, y, z), c, r, table, usable)
        if r < 0:
            continue
        t = table[r, c]
        nx, ny, nz, cosine, area = _normal(t, du, dv)
        # the model's own normal: the patch's has the noise of the distance in it, which would bias the motion
        ax = T[0, 0] * mx + T[0, 1] * my + T[0, 2] * mz
        ay = T[1, 0] * mx + T[1, 1] * my + T[1, 2] * mz
        az = T[2, 0] * mx + T[2, 1] * my + T[2, 2] * mz
        if nx * ax + ny * ay + nz * az < FACING_COS:
            continue
        d = (x - t[0]) * t[9] + (y - t[1]) * t[10] + (z - t[2]) * t[11]
        d -= 0.5 * (du * (t[12] * du + t[13] * dv) + dv * (t[13] * du + t[14] * dv))
        found[i] = r * width + c
        out[i, 0], out[i, 1], out[i, 2] = x, y, z
        out[i, 3], out[i, 4], out[i, 5] = ax, ay, az
        out[i, 7] = area
        out[i, 6] = d / cosine  # along the foot's normal; `d` is along that of the patch's middle


@njit(cache=True)
def accumulate(found: Array, rows: Array, variance: Array, scale: float, more: float, sums: Array) -> None:
    """Add up Tukey-weighted normal equations of `rows` (n, 8); `sums` (29,) see SUMS.

    A weight is 1 / (variance + `more`); residuals beyond 4.685 x `scale` have none.
    """
    for i in range(len(found)):
        if found[i] < 0:
            continue
        e = rows[i, 6] / (4.685 * scale)
        if abs(e) >= 1.0:
            continue
        w = (1.0 - e * e) ** 2 / (variance[i] + more)
        x, y, z, a, b, c = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3], rows[i, 4], rows[i, 5]
        j0, j1, j2 = y * c - z * b, z * a - x * c, x * b - y * a
        row = (j0, j1, j2, a, b, c)
        k = 0
        for m in range(6):
            wm = w * row[m]
            for n in range(m, 6):
                sums[k] += wm * row[n]
                k += 1
            sums[21 + m] += wm * rows[i, 6]
        sums[27] += w
        sums[28] += w * rows[i, 6] * rows[i, 6]
