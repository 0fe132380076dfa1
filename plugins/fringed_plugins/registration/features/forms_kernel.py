"""Principal curvatures from derivatives of a surface, and how noise of the points moves them.

Owns the arithmetic of one point alone, for kernels to inline.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, Any]


@njit(cache=True, inline="always")
def dot(a: Array, b: Array) -> float:
    """Return a . b of (3,)."""
    total: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def principal(d: Array, ray: Array, along_normal: bool, n: Array, change: Array) -> tuple[float, float, bool]:
    """Return k1 >= k2 of derivatives `d` (5, 3) x_u, x_v, x_uu, x_uv, x_vv, and whether there is a tangent plane.

    `n` (3,) becomes the unit normal x_v cross x_u, and a curvature is positive where the surface bends away from it.
    `change` (2, 5) becomes d k / d (noise of each derivative) for noise along `ray` (3,), or along the normal.

    The curvatures are the eigenvalues of II in an orthonormal tangent basis, which is k^2 - 2 H k + K = 0 without its
    cancellation where k1 and k2 are near each other. Noise moves a derivative by its share eta times the ray r, hence
    II(t, t) by r.n (eta_tt - Christoffel's eta_u, eta_v) and I(t, t) by 2 r.t eta_t: dk = dII(t, t) - k dI(t, t).
    """
    a, b = d[0], d[1]
    E, F, G = dot(a, a), dot(a, b), dot(b, b)
    area = E * G - F * F
    if not area > 1e-14 * E * G:
        return 0.0, 0.0, False
    size = 1.0 / sqrt(area)
    n[0] = (b[1] * a[2] - b[2] * a[1]) * size
    n[1] = (b[2] * a[0] - b[0] * a[2]) * size
    n[2] = (b[0] * a[1] - b[1] * a[0]) * size
    e, f, g = -dot(d[2], n), -dot(d[3], n), -dot(d[4], n)
    # orthonormal basis: x_u / p, and al x_u + be x_v
    p = sqrt(E)
    be = p * size
    al = -F / E * be
    s11 = e / E
    s12 = (e * al + f * be) / p
    s22 = e * al * al + 2 * f * al * be + g * be * be
    H, half = 0.5 * (s11 + s22), 0.5 * (s11 - s22)
    root = sqrt(half * half + s12 * s12)
    c, s = 1.0, 0.0
    if root > 0 and half >= 0:
        c = sqrt(0.5 * (1 + half / root))
        s = s12 / (2 * root * c)
    elif root > 0:
        s = sqrt(0.5 * (1 - half / root))
        c = s12 / (2 * root * s)
    r = n if along_normal else ray
    rn, ra, rb = -dot(r, n), dot(r, a), dot(r, b)
    share = -rn * size * size
    uua, uva, vva = dot(d[2], a), dot(d[3], a), dot(d[4], a)
    uub, uvb, vvb = dot(d[2], b), dot(d[3], b), dot(d[4], b)
    for i in range(2):
        k = H + root if i == 0 else H - root
        u, v = (c / p + s * al, s * be) if i == 0 else (-s / p + c * al, c * be)
        uu, uv, vv = u * u, 2 * u * v, v * v
        ya = uu * uua + uv * uva + vv * vva
        yb = uu * uub + uv * uvb + vv * vvb
        stretch = 2 * k * (u * ra + v * rb)
        change[i, 0] = share * (G * ya - F * yb) - stretch * u
        change[i, 1] = share * (E * yb - F * ya) - stretch * v
        change[i, 2], change[i, 3], change[i, 4] = rn * uu, rn * uv, rn * vv
    return H + root, H - root, True
