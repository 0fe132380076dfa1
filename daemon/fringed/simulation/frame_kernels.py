"""Kernels that turn light into frames: exposure, and the sensor's electrons into numbers.

Owns the per-pixel arithmetic of one frame; knows nothing of where the geometry or the patterns come from.
The noise comes from a counter-based generator: a pixel's sample depends on the frame's key and the pixel alone,
so neither threads nor order change it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S12 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(12)


@njit(cache=True, nogil=True)
def _uniform(key: Any, index: int) -> float:
    """Return the number in (0, 1) of a key and an index (SplitMix64, Steele et al. 2014)."""
    x = key + np.uint64(index) * _GOLDEN
    x = (x ^ (x >> _S30)) * _MIX1
    x = (x ^ (x >> _S27)) * _MIX2
    x = x ^ (x >> _S31)
    return (np.float64(x >> _S12) + 0.5) * 2.220446049250313e-16


@njit(cache=True, nogil=True)
def _normal(p: float) -> float:
    """Return the normal quantile of p (Acklam's rational approximation, relative error 1.2e-9)."""
    q = min(p, 1.0 - p)
    if q < 0.02425:
        s = np.sqrt(-2.0 * np.log(q))
        x = ((((-7.784894002430293e-03 * s - 3.223964580411365e-01) * s - 2.400758277161838) * s - 2.549732539343734)
             * s + 4.374664141464968) * s + 2.938163982698783  # fmt: skip
        x /= (((7.784695709041462e-03 * s + 3.224671290700398e-01) * s + 2.445134137142996) * s
              + 3.754408661907416) * s + 1.0  # fmt: skip
        return float(x if p < 0.5 else -x)
    q = p - 0.5
    s = q * q
    x = (((((-3.969683028665376e+01 * s + 2.209460984245205e+02) * s - 2.759285104469687e+02) * s
           + 1.383577518672690e+02) * s - 3.066479806614716e+01) * s + 2.506628277459239) * q  # fmt: skip
    return x / (
        ((((-5.447609879822406e+01 * s + 1.615858368580409e+02) * s - 1.556989798598866e+02) * s
          + 6.680131188771972e+01) * s - 1.328068155288572e+01) * s + 1.0
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _line(table: Any, low: int, mix: float, at: float) -> float:
    """Interpolate `table` (levels, samples) between two levels and two samples."""
    i = int(at)
    f = at - i
    a = table[low, i] + f * (table[low, i + 1] - table[low, i])
    b = table[low + 1, i] + f * (table[low + 1, i + 1] - table[low + 1, i])
    return float(a + mix * (b - a))


@njit(cache=True, nogil=True)
def _picture(stack: Any, low: int, mix: float, x: float, y: float) -> float:
    """Interpolate `stack` (levels, height, width) between two levels and four samples."""
    i, j = min(max(int(x), 0), stack.shape[2] - 2), min(max(int(y), 0), stack.shape[1] - 2)
    fx, fy = x - i, y - j
    total = 0.0
    for k in range(2):
        s = stack[low + k]
        top = s[j, i] + fx * (s[j, i + 1] - s[j, i])
        below = s[j + 1, i] + fx * (s[j + 1, i + 1] - s[j + 1, i])
        total += (mix if k else 1.0 - mix) * (top + fy * (below - top))
    return total


@njit(cache=True, nogil=True)
def expose_rows(
    first: int, end: int, known: tuple[Any, ...], light: tuple[Any, Any, Any], scales: Any, out: Any
) -> None:
    """Write the mean electrons of rows `first` to `end`.

    `known`: gain, base, level, column, row. `light`: what the columns, the rows and the whole picture give, empty
    where they give nothing. `scales`: electrons of projected and of ambient light, samples per projector pixel of a
    line and of a picture.
    """
    gain, base, level, column, row = known
    columns, rows, stack = light
    levels = max(columns.shape[0], rows.shape[0], stack.shape[0])
    for r in range(first, end):
        for c in range(gain.shape[1]):
            electrons = scales[1] * base[r, c]
            if gain[r, c] > 0.0 and levels > 0:
                low = min(int(level[r, c]), levels - 2)
                mix = level[r, c] - low
                given = 0.0
                if columns.shape[0] > 0:
                    given += _line(columns, low, mix, (column[r, c] + 0.5) * scales[2])
                if rows.shape[0] > 0:
                    given += _line(rows, low, mix, (row[r, c] + 0.5) * scales[2])
                if stack.shape[0] > 0:
                    x, y = (column[r, c] + 0.5) * scales[3] - 0.5, (row[r, c] + 0.5) * scales[3] - 0.5
                    given += _picture(stack, low, mix, x, y)
                electrons += scales[0] * gain[r, c] * given
            out[r, c] = electrons


@njit(cache=True, nogil=True)
def digitise_rows(rows: tuple[int, int], electrons: Any, fixed: Any, key: Any, sensor: Any, out: Any) -> None:
    """Turn mean electrons into numbers, uint16, for `rows` first to end.

    `sensor`: dark electrons, read noise squared, full well, electrons per number, offset and highest number, and
    whether there is noise. Shot noise is Gaussian: below some 20 electrons, where that differs from Poisson, the read
    noise of 12 hides it.
    """
    dark, read2, well, per_dn, offset, top, noisy = sensor
    width = electrons.shape[1]
    scale = 1.0 / per_dn
    for r in range(rows[0], rows[1]):
        for c in range(width):
            e = electrons[r, c] + dark
            if noisy > 0.0:
                e += fixed[r, c] + np.sqrt(max(e, 0.0) + read2) * _normal(_uniform(key, r * width + c))
            number = offset + min(e, well) * scale + 0.5
            out[r, c] = np.uint16(min(max(number, 0.0), top))
