"""One pixel's frames to background, cosine, sine and misfit: closed forms of least squares, and the general sum.

Owns `fit_at`, which kernels call inside their loops over a row; which form is compiled into a loop follows from
what the row is: a tuple of 3, 4 or 6 frames, or `Sums`. Everything here is inlined and vectorised by the compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.core import types
from numba.extending import overload

_THIRD = np.float32(1 / 3)
_ROOT_THIRD = np.float32(1 / np.sqrt(3))
_HALF_ROOT_THIRD = np.float32(0.5 / np.sqrt(3))
_HALF = np.float32(0.5)
_QUARTER = np.float32(0.25)
_SIXTH = np.float32(1 / 6)
_TWELFTH = np.float32(1 / 12)
_TWO = np.float32(2)
_ZERO = np.float32(0)
_options: Any = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


class Sums(NamedTuple):
    """Rows of what `sums.fold` has added up over any number of frames, and the fit's normal matrix.

    `light`, `cosine` and `sine` are the least-squares solution for the frames less `pivot`, their first;
    `square` is the sum of the squares of that difference, `brightest` the greatest frame. `normal` has the six
    numbers of the symmetric matrix N, with which the solution x explains x' N x of `square`.
    """

    pivot: Any
    light: Any
    cosine: Any
    sine: Any
    square: Any
    brightest: Any
    normal: Any


def fit_at(rows: Any, x: Any) -> tuple[Any, ...]:
    """Return background, cosine, sine, sum of squared residuals and greatest frame of pixel `x` (float32).

    For tuples of 3, 4 and 6 frames shifted by 2 pi k / N these are closed forms of the same least squares
    (Greivenkamp 1984); a form is chosen when a kernel is compiled.
    """
    raise NotImplementedError("fit_at is for compiled kernels")


@njit(**_options)
def _greater(a: Any, b: Any) -> Any:
    return a if a > b else b


def _three(rows: Any, x: Any) -> tuple[Any, ...]:
    first, second, third = rows[0][x], rows[1][x], rows[2][x]
    v0, v1, v2 = np.float32(first), np.float32(second), np.float32(third)
    brightest = np.float32(_greater(_greater(first, second), third))
    outer = v1 + v2
    return (v0 + outer) * _THIRD, (_TWO * v0 - outer) * _THIRD, (v2 - v1) * _ROOT_THIRD, _ZERO, brightest


def _four(rows: Any, x: Any) -> tuple[Any, ...]:
    r0, r1, r2, r3 = rows[0][x], rows[1][x], rows[2][x], rows[3][x]
    v0, v1, v2, v3 = np.float32(r0), np.float32(r1), np.float32(r2), np.float32(r3)
    brightest = np.float32(_greater(_greater(r0, r1), _greater(r2, r3)))
    even, odd = v0 + v2, v1 + v3
    off = even - odd
    return (even + odd) * _QUARTER, (v0 - v2) * _HALF, (v3 - v1) * _HALF, off * off * _QUARTER, brightest


def _six(rows: Any, x: Any) -> tuple[Any, ...]:
    r0, r1, r2, r3, r4, r5 = rows[0][x], rows[1][x], rows[2][x], rows[3][x], rows[4][x], rows[5][x]
    v0, v1, v2, v3, v4, v5 = (
        np.float32(r0),
        np.float32(r1),
        np.float32(r2),
        np.float32(r3),
        np.float32(r4),
        np.float32(r5),
    )
    brightest = np.float32(_greater(_greater(_greater(r0, r1), _greater(r2, r3)), _greater(r4, r5)))
    d0, d1, d2 = v0 - v3, v1 - v4, v2 - v5  # odd harmonics
    p0, p1, p2 = v0 + v3, v1 + v4, v2 + v5  # even harmonics
    inner, outer, pair = d1 - d2, d1 + d2, p0 + p1
    third, second, other = d0 - inner, p0 - p1, pair - _TWO * p2
    misfit = third * third * _SIXTH + second * second * _QUARTER + other * other * _TWELFTH
    return (pair + p2) * _SIXTH, (d0 + _HALF * inner) * _THIRD, -outer * _HALF_ROOT_THIRD, misfit, brightest


def _summed(rows: Any, x: Any) -> tuple[Any, ...]:
    n, light, c, s = rows.normal, rows.light[x], rows.cosine[x], rows.sine[x]
    explained = n[0] * light * light + n[1] * c * c + n[2] * s * s
    explained += _TWO * (n[3] * light * c + n[4] * light * s + n[5] * c * s)
    misfit = rows.square[x] - explained
    return rows.pivot[x] + light, c, s, misfit if misfit > _ZERO else _ZERO, rows.brightest[x]


@overload(fit_at, jit_options=_options, strict=False)
def _choose(rows: Any, x: Any) -> Callable[..., Any]:
    if isinstance(rows, types.BaseNamedTuple):
        return _summed
    return {3: _three, 4: _four, 6: _six}[len(rows)]
