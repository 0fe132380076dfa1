"""A four-quadrant arctangent that the compiler can vectorise.

Owns one scalar function for kernels; the library's atan2 is a call per pixel, ten times slower.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_TINY = np.float32(1e-30)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_HALF_PI = np.float32(np.pi / 2)
_PI = np.float32(np.pi)
_A2 = np.float32(-0.3333314528)
_A4 = np.float32(0.1999355085)
_A6 = np.float32(-0.1420889944)
_A8 = np.float32(0.1065626393)
_A10 = np.float32(-0.0752896400)
_A12 = np.float32(0.0429096138)
_A14 = np.float32(-0.0161657367)
_A16 = np.float32(0.0028662257)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fast_atan2(y: np.float32, x: np.float32) -> np.float32:
    """Return atan2(y, x) of two float32 within 5e-7 rad, in [-pi, pi]; atan2(0, 0) is 0.

    References
    ----------
    Abramowitz & Stegun 1964, eq. 4.4.49 (error of the polynomial at most 2e-8).
    """
    ax = abs(x)
    ay = abs(y)
    steep = ay > ax
    larger = ay if steep else ax
    smaller = ax if steep else ay
    a = smaller / (larger + _TINY)
    s = a * a
    p = _A16 * s + _A14
    p = p * s + _A12
    p = p * s + _A10
    p = p * s + _A8
    p = p * s + _A6
    p = p * s + _A4
    p = p * s + _A2
    p = p * s + _ONE
    r = p * a
    r = _HALF_PI - r if steep else r
    r = _PI - r if x < _ZERO else r
    return -r if y < _ZERO else r
