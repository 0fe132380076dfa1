"""The fused kernel: frames to phase, modulation, background, noise and mask in one pass over the rows.

Owns the loops; `decode` prepares what they need. Every inner loop runs over a row in float32 without
branches, so that the compiler vectorises it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2

_HALF = np.float32(0.5)
_ZERO = np.float32(0.0)
_TWO_PI = np.float32(2 * np.pi)
_PER_TURN = np.float32(0.5 / np.pi)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to the nearest integer
_NAN = np.float32(np.nan)
_TINY = np.float32(1e-12)

# The rows of the scratch buffer.
_A, _C, _S, _R, _TOP, _SS, _WEAK, _MISFIT, _TURNS, _WRAPPED, _COARSE, _B2 = range(12)
SCRATCH_ROWS = 12


class Limits(NamedTuple):
    """Numbers of the last step, all float32: noise model, thresholds and the projector's range."""

    noise_constant: np.float32  # variance of one frame: constant + slope * background, in DN^2
    noise_slope: np.float32
    phase_factor: np.float32  # sigma_phase^2 = factor * variance / modulation^2
    saturation: np.float32
    modulation: np.float32  # smallest modulation in DN
    modulation_snr2: np.float32  # smallest squared modulation over the noise's variance
    residual_sigma2: np.float32  # largest sum of squared residuals, in variances of one frame
    residual_part2: np.float32  # ... plus this part of the squared modulation
    misfit_turns: np.float32  # largest difference between a coarse prediction and a fine phase
    drop2: np.float32  # smallest squared ratio of the finest to the coarsest modulation
    first_turns: np.float32  # where the coarsest phase is cut
    wrap_turns: np.float32  # number of the finest periods, or 0 where the range is not circular
    cut_turns: np.float32  # where the finest phase is cut
    low_turns: np.float32  # range of the finest phase that is on the projector
    high_turns: np.float32
    initial_rad: np.float32  # added to the finest phase
    absolute: bool


_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


@njit(**_options)
def _fit(f0: Any, f1: Any, f2: Any, f3: Any, k: Any, work: Any) -> None:
    """Add four frames' part of A, C, S and of the first residual component; track the brightest."""
    a, c, s, r, top = work[0], work[1], work[2], work[3], work[4]
    a0, a1, a2, a3 = k[0, 0], k[0, 1], k[0, 2], k[0, 3]
    c0, c1, c2, c3 = k[1, 0], k[1, 1], k[1, 2], k[1, 3]
    s0, s1, s2, s3 = k[2, 0], k[2, 1], k[2, 2], k[2, 3]
    r0, r1, r2, r3 = k[3, 0], k[3, 1], k[3, 2], k[3, 3]
    for x in range(a.size):
        v0, v1, v2, v3 = np.float32(f0[x]), np.float32(f1[x]), np.float32(f2[x]), np.float32(f3[x])
        a[x] += a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
        c[x] += c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3
        s[x] += s0 * v0 + s1 * v1 + s2 * v2 + s3 * v3
        r[x] += r0 * v0 + r1 * v1 + r2 * v2 + r3 * v3
        high = v0 if v0 > v1 else v1
        other = v2 if v2 > v3 else v3
        high = high if high > other else other
        top[x] = high if high > top[x] else top[x]


@njit(**_options)
def _component(f0: Any, f1: Any, f2: Any, f3: Any, k: Any, out: Any) -> None:
    """Add four frames' part of one further residual component."""
    k0, k1, k2, k3 = k[0], k[1], k[2], k[3]
    for x in range(out.size):
        out[x] += k0 * np.float32(f0[x]) + k1 * np.float32(f1[x]) + k2 * np.float32(f2[x]) + k3 * np.float32(f3[x])


@njit(**_options)
def _add_square(part: Any, total: Any) -> None:
    for x in range(total.size):
        total[x] += part[x] * part[x]
        part[x] = _ZERO


@njit(**_options)
def _first_level(work: Any, initial: np.float32, cut: np.float32) -> None:
    """Phase of the coarsest group in turns, cut where the projector ends."""
    c, s, turns, wrapped, b2 = work[1], work[2], work[8], work[9], work[11]
    coarse, weak, misfit = work[10], work[6], work[7]
    for x in range(c.size):
        phase = fast_atan2(s[x], c[x])
        wrapped[x] = phase
        t = phase * _PER_TURN - initial
        below = t - cut
        turns[x] = t - ((below - _HALF + _ROUND) - _ROUND)
        b2[x] = c[x] * c[x] + s[x] * s[x]
        coarse[x] = b2[x]
        weak[x] = b2[x]
        misfit[x] = _ZERO


@njit(**_options)
def _next_level(work: Any, initial: np.float32, ratio: np.float32) -> None:
    """Phase of a finer group: its fraction, with the integer that the coarser one predicts."""
    c, s, turns, wrapped, b2 = work[1], work[2], work[8], work[9], work[11]
    weak, misfit = work[6], work[7]
    for x in range(c.size):
        phase = fast_atan2(s[x], c[x])
        wrapped[x] = phase
        t = phase * _PER_TURN - initial
        predicted = ratio * turns[x]
        fine = t + ((predicted - t + _ROUND) - _ROUND)
        off = abs(predicted - fine)
        misfit[x] = off if off > misfit[x] else misfit[x]
        turns[x] = fine
        square = c[x] * c[x] + s[x] * s[x]
        b2[x] = square
        weak[x] = square if square < weak[x] else weak[x]


@njit(**_options)
def _flags(work: Any, limits: Any, flags: Any) -> None:
    """Say why a pixel is dropped, with the bits of the contract's mask."""
    a, top, ss, weak, misfit, coarse, b2 = work[0], work[4], work[5], work[6], work[7], work[10], work[11]
    slope, constant, snr2 = limits.noise_slope, limits.noise_constant, limits.modulation_snr2
    for x in range(a.size):
        variance = constant + slope * (a[x] if a[x] > _ZERO else _ZERO)
        flag = np.int32(1) if top[x] >= limits.saturation else np.int32(0)
        least = snr2 * variance
        weakest = limits.modulation * limits.modulation
        least = least if least > weakest else weakest
        flag |= np.int32(2) if weak[x] < least else np.int32(0)
        flag |= np.int32(4) if misfit[x] > limits.misfit_turns else np.int32(0)
        worst = limits.residual_sigma2 * variance + limits.residual_part2 * b2[x]
        flag |= np.int32(8) if ss[x] > worst else np.int32(0)
        flag |= np.int32(64) if b2[x] < limits.drop2 * coarse[x] else np.int32(0)
        flags[x] = flag


@njit(**_options)
def _values(work: Any, limits: Any, flags: Any, phase: Any, sigma: Any) -> None:
    """Write the phase and its standard deviation; NaN where dropped."""
    a, turns, wrapped, b2 = work[0], work[8], work[9], work[11]
    absolute, wrap = limits.absolute, limits.wrap_turns
    for x in range(a.size):
        t = turns[x]
        if absolute:
            round_trips = (t - limits.cut_turns) / wrap if wrap > _ZERO else _HALF
            t -= wrap * ((round_trips - _HALF + _ROUND) - _ROUND)
            outside = t < limits.low_turns or t > limits.high_turns
            flags[x] |= np.int32(16) if outside else np.int32(0)
        value = t * _TWO_PI + limits.initial_rad if absolute else wrapped[x]
        variance = limits.noise_constant + limits.noise_slope * (a[x] if a[x] > _ZERO else _ZERO)
        deviation = np.sqrt(limits.phase_factor * variance / (b2[x] + _TINY))
        phase[x] = value if flags[x] == 0 else _NAN
        sigma[x] = deviation if flags[x] == 0 else _NAN


@njit(**_options)
def _pictures(work: Any, flags: Any, modulation: Any, background: Any, rejected: Any) -> None:
    a, b2 = work[0], work[11]
    for x in range(a.size):
        modulation[x] = np.sqrt(b2[x])
        background[x] = a[x]
        rejected[x] = np.uint16(flags[x])


@njit(**_options)
def decode_rows(start: int, stop: int, frames: Any, plan: Any, limits: Any, out: Any) -> None:
    """Decode rows `start` to `stop` of `frames` (n, height, width) into the arrays of `out`."""
    width = frames.shape[2]
    work = np.zeros((SCRATCH_ROWS, width), np.float32)
    flags = np.zeros(width, np.int32)
    for y in range(start, stop):
        work[_TOP] = _ZERO
        work[_SS] = _ZERO
        for g in range(plan.chunks.size):
            work[_A : _R + 1] = _ZERO
            for q in range(plan.chunks[g]):
                i = plan.place[g, 4 * q : 4 * q + 4]
                _fit(frames[i[0], y], frames[i[1], y], frames[i[2], y], frames[i[3], y], plan.fit[g, q], work)
            _add_square(work[_R], work[_SS])
            for j in range(plan.extras[g]):
                for q in range(plan.chunks[g]):
                    i = plan.place[g, 4 * q : 4 * q + 4]
                    k = plan.extra[g, j, 4 * q : 4 * q + 4]
                    _component(frames[i[0], y], frames[i[1], y], frames[i[2], y], frames[i[3], y], k, work[_R])
                _add_square(work[_R], work[_SS])
            if g == 0:
                _first_level(work, plan.initial_turns[0], limits.first_turns)
            else:
                _next_level(work, plan.initial_turns[g], plan.ratio[g])
        _flags(work, limits, flags)
        _values(work, limits, flags, out.phase_rad[y], out.sigma_rad[y])
        if out.wrapped_rad.shape[0] > 0:
            out.wrapped_rad[y] = work[_WRAPPED]
        _pictures(work, flags, out.modulation[y], out.background[y], out.rejected[y])
