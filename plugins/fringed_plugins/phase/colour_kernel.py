"""Kernels of colour-coded fringes: channels unmixed, and three of them as three phase steps.

Owns the loops; `colour` prepares what they need.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2

_ZERO = np.float32(0)
_ONE = np.float32(1)
_TINY = np.float32(1e-12)
_NAN = np.float32(np.nan)
_SATURATED = np.uint16(1)
_LOW_MODULATION = np.uint16(2)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


class Mixing(NamedTuple):
    """Numbers of the unmixing and of the phase, float32."""

    inverse: Any  # (3, 3): camera channels to projector channels
    black: Any  # (3,)
    fit: Any  # (2, 3): unmixed channels to cosine and sine
    noise_constant: np.float32  # variance of a camera channel: constant + slope * value
    noise_slope: np.float32
    saturation: np.float32
    modulation: np.float32
    modulation_snr2: np.float32


@njit(**_options)
def unmix_rows(start: int, stop: int, frames: Any, mixing: Any, out: Any) -> None:
    """Write the projector channels (3, height, width) of camera channels `frames`, rows `start` to `stop`."""
    k, black = mixing.inverse, mixing.black
    for y in range(start, stop):
        r, g, b = frames[0, y], frames[1, y], frames[2, y]
        for j in range(3):
            kr, kg, kb = k[j, 0], k[j, 1], k[j, 2]
            offset = kr * black[0] + kg * black[1] + kb * black[2]
            row = out[j, y]
            for x in range(row.size):
                row[x] = kr * np.float32(r[x]) + kg * np.float32(g[x]) + kb * np.float32(b[x]) - offset


@njit(**_options)
def _variance(raw: Any, k: Any, mixing: Any, x: int) -> np.float32:
    """Return the variance of sum_c k_c I_c at column `x` of the raw rows."""
    total = _ZERO
    for c in range(3):
        level = np.float32(raw[c][x])
        level = level if level > _ZERO else _ZERO
        total += k[c] * k[c] * (mixing.noise_constant + mixing.noise_slope * level)
    return total


@njit(**_options)
def _weights(t: Any, inverse: Any, k: Any) -> None:
    """Write k_c = sum_j t_j inverse_jc."""
    for c in range(3):
        k[c] = t[0] * inverse[0, c] + t[1] * inverse[1, c] + t[2] * inverse[2, c]


@njit(**_options)
def phase_rows(start: int, stop: int, fields: Any, mixing: Any, out: Any) -> None:
    """Write phase, noise, modulation, background and mask of three steps in three channels.

    `fields` are the raw channels, the unmixed ones, and the gains (3, height, width) that divide them; then the raw
    channels of a white frame that the gains were taken from and its light (height, width), whose noise counts too, or
    arrays without rows.
    """
    frames, unmixed, gains, white, level = fields
    phase, sigma, modulation, background, rejected = out
    fit = mixing.fit
    v, t, k = np.empty(3, np.float32), np.empty(3, np.float32), np.empty(3, np.float32)
    for y in range(start, stop):
        raw = (frames[0, y], frames[1, y], frames[2, y])
        for x in range(phase.shape[1]):
            c, s, a, brightest = _ZERO, _ZERO, _ZERO, _ZERO
            for j in range(3):
                v[j] = unmixed[j, y, x] / gains[j, y, x]
                c += fit[0, j] * v[j]
                s += fit[1, j] * v[j]
                a += v[j]
                value = np.float32(raw[j][x])
                brightest = value if value > brightest else brightest
            square = c * c + s * s
            for j in range(3):
                t[j] = (c * fit[1, j] - s * fit[0, j]) / (gains[j, y, x] * (square + _TINY))
            _weights(t, mixing.inverse, k)
            variance = _variance(raw, k, mixing, x)
            if white.shape[1] > 0:
                lights = (white[0, y], white[1, y], white[2, y])
                for j in range(3):
                    t[j] *= v[j] / (level[y, x] + _TINY)
                _weights(t, mixing.inverse, k)
                variance += _variance(lights, k, mixing, x)
            # sigma_phase^2 modulation^2 is 2/3 of one frame's variance for three steps of equal noise.
            least = mixing.modulation_snr2 * np.float32(1.5) * variance * square
            weak = square < mixing.modulation * mixing.modulation or square < least or not square > _ZERO
            flag = _SATURATED if brightest >= mixing.saturation else np.uint16(0)
            flag |= _LOW_MODULATION if weak else np.uint16(0)
            rejected[y, x] = flag
            phase[y, x] = fast_atan2(s, c) if flag == 0 else _NAN
            sigma[y, x] = np.sqrt(variance) if flag == 0 else _NAN
            modulation[y, x] = np.sqrt(square)
            background[y, x] = a / np.float32(3)
