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
_THIRD = np.float32(1 / 3)
_THREE_HALVES = np.float32(1.5)
_KEPT = np.uint16(0)
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
def _fit(u: Any, gain: Any, fit: Any, work: Any) -> None:
    """Write cosine, sine, mean and squared modulation of the balanced channels, rows of `work`."""
    c, s, a, b2 = work[0], work[1], work[2], work[3]
    u0, u1, u2, g0, g1, g2 = u[0], u[1], u[2], gain[0], gain[1], gain[2]
    c0, c1, c2, s0, s1, s2 = fit[0, 0], fit[0, 1], fit[0, 2], fit[1, 0], fit[1, 1], fit[1, 2]
    for x in range(c.size):
        v0, v1, v2 = u0[x] / g0[x], u1[x] / g1[x], u2[x] / g2[x]
        c[x] = c0 * v0 + c1 * v1 + c2 * v2
        s[x] = s0 * v0 + s1 * v1 + s2 * v2
        a[x] = (v0 + v1 + v2) * _THIRD
        b2[x] = c[x] * c[x] + s[x] * s[x]


@njit(**_options)
def _slopes(gain: Any, fit: Any, work: Any) -> None:
    """Write how the phase changes with each unmixed channel: (c ds - s dc) / modulation^2, over the gain."""
    c, s, b2, t0, t1, t2 = work[0], work[1], work[3], work[4], work[5], work[6]
    g0, g1, g2 = gain[0], gain[1], gain[2]
    c0, c1, c2, s0, s1, s2 = fit[0, 0], fit[0, 1], fit[0, 2], fit[1, 0], fit[1, 1], fit[1, 2]
    for x in range(c.size):
        part = _ONE / (b2[x] + _TINY)
        t0[x] = (c[x] * s0 - s[x] * c0) * part / g0[x]
        t1[x] = (c[x] * s1 - s[x] * c1) * part / g1[x]
        t2[x] = (c[x] * s2 - s[x] * c2) * part / g2[x]


@njit(**_options)
def _add_variance(raw: Any, mixing: Any, work: Any) -> None:
    """Add the variance of sum_c k_c I_c, with k_c = sum_j slope_j inverse_jc, for the raw channels' noise."""
    t0, t1, t2, variance, m = work[4], work[5], work[6], work[7], mixing.inverse
    constant, slope = mixing.noise_constant, mixing.noise_slope
    for channel in range(3):
        m0, m1, m2, row = m[0, channel], m[1, channel], m[2, channel], raw[channel]
        for x in range(variance.size):
            k = t0[x] * m0 + t1[x] * m1 + t2[x] * m2
            level = np.float32(row[x])
            variance[x] += k * k * (constant + slope * (level if level > _ZERO else _ZERO))


@njit(**_options)
def _times_light(u: Any, gain: Any, level: Any, work: Any) -> None:
    """Turn the slopes into those of the white frame's channels, that the gains were taken from."""
    t0, t1, t2 = work[4], work[5], work[6]
    u0, u1, u2, g0, g1, g2 = u[0], u[1], u[2], gain[0], gain[1], gain[2]
    for x in range(level.size):
        part = _ONE / (level[x] + _TINY)
        t0[x] *= u0[x] / g0[x] * part
        t1[x] *= u1[x] / g1[x] * part
        t2[x] *= u2[x] / g2[x] * part


@njit(**_options)
def _write(raw: Any, mixing: Any, work: Any, out: Any) -> None:
    c, s, b2, variance = work[0], work[1], work[3], work[7]
    phase, sigma, modulation, rejected = out
    r, g, b = raw[0], raw[1], raw[2]
    least2, snr2, top = mixing.modulation * mixing.modulation, mixing.modulation_snr2, mixing.saturation
    for x in range(c.size):
        high = r[x] if r[x] > g[x] else g[x]
        high = high if high > b[x] else b[x]
        # sigma_phase^2 modulation^2 is 2/3 of a frame's variance for three steps of equal noise.
        weak = b2[x] < least2 or b2[x] < snr2 * _THREE_HALVES * variance[x] * b2[x] or not b2[x] > _ZERO
        flag = _SATURATED if np.float32(high) >= top else _KEPT
        flag |= _LOW_MODULATION if weak else _KEPT
        rejected[x] = flag
        angle = fast_atan2(s[x], c[x])
        phase[x] = angle if flag == _KEPT else _NAN
        sigma[x] = np.sqrt(variance[x]) if flag == _KEPT else _NAN
        modulation[x] = np.sqrt(b2[x])


@njit(**_options)
def phase_rows(start: int, stop: int, fields: Any, mixing: Any, out: Any) -> None:
    """Write phase, noise, modulation, background and mask of three steps in three channels.

    `fields` are the raw channels, the unmixed ones, and the gains (3, height, width) that divide them; then the raw
    channels of a white frame that the gains were taken from and its light (height, width), whose noise counts too, or
    arrays without rows.
    """
    frames, unmixed, gains, white, level = fields
    phase, sigma, modulation, background, rejected = out
    work = np.empty((8, phase.shape[1]), np.float32)
    for y in range(start, stop):
        raw = (frames[0, y], frames[1, y], frames[2, y])  # single rows are contiguous, and loops over them vectorise
        u, gain = (unmixed[0, y], unmixed[1, y], unmixed[2, y]), (gains[0, y], gains[1, y], gains[2, y])
        _fit(u, gain, mixing.fit, work)
        _slopes(gain, mixing.fit, work)
        work[7] = _ZERO
        _add_variance(raw, mixing, work)
        if white.shape[1] > 0:
            _times_light(u, gain, level[y], work)
            _add_variance((white[0, y], white[1, y], white[2, y]), mixing, work)
        background[y] = work[2]
        _write(raw, mixing, work, (phase[y], sigma[y], modulation[y], rejected[y]))
