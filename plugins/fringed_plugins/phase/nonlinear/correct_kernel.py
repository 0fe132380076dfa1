"""Take a fitted error off a phase, row by row.

Owns the loop; what the coefficients mean is in `regional`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_ROUNDS = 6


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def remove_rows(start: int, stop: int, maps: Any, series: Any, numbers: Any, out: Any) -> None:
    """Write the true phase whose measured one is `maps[0]` (rad) where the blur indicator is `maps[1]`.

    `series` (3, 3) float32 holds, for the multiples 1, 2, 3 of `steps`, the polynomial of the blur indicator whose
    value is q in `measured = true + angle(1 + sum q_k exp(-i k steps true))`; `numbers` is (steps, centre, spread) of
    that indicator. Newton's method; where the phase is NaN it stays so.
    """
    phase, blur = maps
    steps, centre, spread = numbers
    one = np.float32(1)
    for y in range(start, stop):
        for x in range(phase.shape[1]):
            measured = phase[y, x]
            at = (blur[y, x] - centre) / spread
            at = min(max(at, -one), one)
            q1 = series[0, 0] + at * (series[0, 1] + at * series[0, 2])
            q2 = series[1, 0] + at * (series[1, 1] + at * series[1, 2])
            q3 = series[2, 0] + at * (series[2, 1] + at * series[2, 2])
            true = measured
            for _ in range(_ROUNDS):
                # Large phases lose digits in float32: the angle is taken of what is left within one period.
                angle = np.float64(true) * np.float64(steps)
                c1, s1 = np.float32(np.cos(angle)), np.float32(np.sin(angle))
                c2, s2 = c1 * c1 - s1 * s1, np.float32(2) * s1 * c1
                c3, s3 = c1 * c2 - s1 * s2, s1 * c2 + c1 * s2
                real = one + q1 * c1 + q2 * c2 + q3 * c3
                imaginary = -(q1 * s1 + q2 * s2 + q3 * s3)
                square = real * real + imaginary * imaginary
                slope_real = -steps * (q1 * s1 + np.float32(2) * q2 * s2 + np.float32(3) * q3 * s3)
                slope_imaginary = -steps * (q1 * c1 + np.float32(2) * q2 * c2 + np.float32(3) * q3 * c3)
                turn = (real * slope_imaginary - imaginary * slope_real) / square
                off = true + np.float32(np.arctan2(imaginary, real)) - measured
                step = off / (one + turn)
                true -= step
                if abs(step) < np.float32(1e-6):
                    break
            out[y, x] = true
