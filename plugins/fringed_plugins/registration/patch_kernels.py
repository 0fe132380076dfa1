"""Kernels on patches: walk to feet of perpendiculars, weigh and sum up the normal equations.

Owns the arithmetic alone; arrays are checked by the callers.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit, prange

from fringed_plugins.registration.surface import LEAST_COSINE

Array = np.ndarray[Any, Any]
MOST_STEPS = 5
NEAR = 0.6  # of a pixel: half would let a foot on the edge walk to and fro
FACING_COS = 0.7
SUMS = 29  # 21 of H's upper triangle, 6 of the gradient, weights, weighted squares


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


@njit(cache=True, inline="always")
def _meet(point: Array, transforms: Array, table: Array, usable: Array, last: int, out: Array) -> int:
    """Return the pixel of one point's foot, or -1; see `walk`."""
    height, width = usable.shape
    T, P = transforms[:4], transforms[4:]
    px, py, pz, mx, my, mz = point[0], point[1], point[2], point[3], point[4], point[5]
    x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
    y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
    z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
    c, r = last % width, last // width
    if last < 0:
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        if depth < 1e-6:
            return -1
        u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
        v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
        if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
            return -1
        c, r = int(u + 0.5), int(v + 0.5)
    c, r, du, dv = _foot((x, y, z), c, r, table, usable)
    if r < 0:
        return -1
    t = table[r, c]
    nx, ny, nz, cosine, area = _normal(t, du, dv)
    # the model's own normal: the patch's has the noise of the distance in it, which would bias the motion
    ax = T[0, 0] * mx + T[0, 1] * my + T[0, 2] * mz
    ay = T[1, 0] * mx + T[1, 1] * my + T[1, 2] * mz
    az = T[2, 0] * mx + T[2, 1] * my + T[2, 2] * mz
    if nx * ax + ny * ay + nz * az < FACING_COS:
        return -1
    d = (x - t[0]) * t[9] + (y - t[1]) * t[10] + (z - t[2]) * t[11]
    d -= 0.5 * (du * (t[12] * du + t[13] * dv) + dv * (t[13] * du + t[14] * dv))
    out[0], out[1], out[2] = x, y, z
    out[3], out[4], out[5] = ax, ay, az
    out[7] = area
    out[6] = d / cosine  # along the foot's normal; `d` is along that of the patch's middle
    return int(r * width + c)


@njit(cache=True, parallel=True)
def walk(model: Array, transforms: Array, table: Array, usable: Array, found: Array, out: Array) -> None:
    """Find the foot of each moved point: `found` its flat pixel or -1, `out` (n, 8) point, its normal, distance, area.

    `model` (n, 6) points and normals; `transforms` (7, 4) the motion's four rows and the projection's three.
    Projects where `found` knows no pixel of the last time, then walks in the tangent plane until the foot lies
    within a pixel. A foot stays on its patch as long as it can: on the edge of two it would swing for ever.
    """
    for i in prange(len(model)):
        found[i] = _meet(model[i], transforms, table, usable, found[i], out[i])


@njit(cache=True)
def walk_alone(model: Array, transforms: Array, table: Array, usable: Array, found: Array, out: Array) -> None:
    """Do what `walk` does in one thread: on busy cores others are waited for longer than a short walk takes."""
    for i in range(len(model)):
        found[i] = _meet(model[i], transforms, table, usable, found[i], out[i])


@njit(cache=True)
def variances(pixels: Array, normals: Array, table: Array, errors: Array, origin: Array, out: Array) -> None:
    """Fill `out` (n,) with a single point's variance along `normals` (n, 3) at flat `pixels`; 0 where they are -1.

    `table` (pixels, 15); `errors` (pixels, 2) the deviation along the ray and a variance that is added; `origin` (3,)
    from the camera to the table's.
    """
    for i in range(len(pixels)):
        at = pixels[i]
        if at < 0:
            out[i] = 0.0
            continue
        x, y, z = table[at, 0] + origin[0], table[at, 1] + origin[1], table[at, 2] + origin[2]
        cosine = abs(x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2])
        cosine = max(cosine / max(sqrt(x * x + y * y + z * z), 1e-12), LEAST_COSINE)
        out[i] = (errors[at, 0] * cosine) ** 2 + errors[at, 1]


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
