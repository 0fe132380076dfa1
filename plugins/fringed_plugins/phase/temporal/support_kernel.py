"""Inner loops of the correction: the order that a pixel's kept neighbours give it.

Owns the plane through the neighbours; `correction` calls it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.temporal.settle_kernel import BENT_TURNS2, SETTLED, options

_LEAST_NEIGHBOURS = 6  # of 24
_LIT_PART = np.float32(0.5)  # of the neighbours' modulation: less is outside of what is lit
_QUIET_SNR2 = np.float32(12.0**2)
_ZERO = np.float32(0)
_PI = np.float32(np.pi)
_TWO_PI = np.float32(2 * np.pi)
_PER_TURN = np.float32(0.5 / np.pi)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to the nearest integer


@njit(**options)
def _gather(maps: Any, y: int, x: int, found: Any) -> Any:
    """Write phase and place of the kept neighbours within 2 px; return how many there are, and their modulation."""
    phase, modulation, rejected = maps
    count, light = 0, _ZERO
    for i in range(max(0, y - 2), min(phase.shape[0], y + 3)):
        for j in range(max(0, x - 2), min(phase.shape[1], x + 3)):
            if rejected[i, j] == 0 and count < found.shape[1]:
                found[0, count], found[1, count], found[2, count] = phase[i, j], i - y, j - x
                light += modulation[i, j]
                count += 1
    return count, light / np.float32(max(count, 1))


@njit(**options)
def _plane(found: Any, count: int) -> Any:
    """Fit a plane to `found`; return its value in the middle, and whether the neighbours agree.

    They agree where three of four lie within half a turn of their median: beside a step they do not.
    """
    middle = np.sort(found[0, :count])[count // 2]
    n, v, r, c = _ZERO, _ZERO, _ZERO, _ZERO
    for k in range(count):
        if abs(found[0, k] - middle) < _PI:
            n += np.float32(1)
            v += found[0, k] - middle
            r += found[1, k]
            c += found[2, k]
    if n == _ZERO or np.float32(4) * n < np.float32(3 * count):
        return _ZERO, False
    v, r, c = v / n, r / n, c / n
    rr, rc, cc, vr, vc = np.float32(1), _ZERO, np.float32(1), _ZERO, _ZERO  # as if flat, where all lie on a line
    for k in range(count):
        if abs(found[0, k] - middle) < _PI:
            value, down, across = found[0, k] - middle - v, found[1, k] - r, found[2, k] - c
            rr += down * down
            rc += down * across
            cc += across * across
            vr += value * down
            vc += value * across
    scale = np.float32(1) / (rr * cc - rc * rc)
    slope_down, slope_across = (vr * cc - vc * rc) * scale, (vc * rr - vr * rc) * scale
    return middle + v - slope_down * r - slope_across * c, True


@njit(**options)
def neighbour_rows(start: int, stop: int, fit: Any, maps: Any, rules: Any) -> None:
    """Give doubtful pixels the order that their kept neighbours' plane predicts, where it explains their phase."""
    decoded, before, counts = maps
    frames, places, weights, initial = fit
    found = np.empty((3, 24), np.float32)
    for y in range(start, stop):
        if counts[y] == 0:
            continue
        for x in range(before.shape[1]):
            flags = before[y, x]
            if flags == 0 or (flags & SETTLED) != 0 or decoded.modulation[y, x] < rules.least_dn:
                continue
            variance = rules.noise_constant + rules.noise_slope * max(decoded.background[y, x], _ZERO)
            c, s = _ZERO, _ZERO
            for i in range(places.size):
                value = np.float32(frames[places[i], y, x])
                c += weights[0, i] * value
                s += weights[1, i] * value
            own2 = rules.factor * variance / (c * c + s * s + np.float32(1e-12))
            # A pixel without noise that contradicts itself sees two surfaces; no neighbour can tell which one.
            quiet = c * c + s * s > _QUIET_SNR2 * variance
            if quiet or c * c + s * s < rules.least_snr2 * variance:
                continue
            count, light = _gather((decoded.phase_rad, decoded.modulation, before), y, x, found)
            if count < _LEAST_NEIGHBOURS or decoded.modulation[y, x] < _LIT_PART * light:
                continue
            phase, agree = _plane(found, count)
            if not agree:
                continue
            predicted = (phase - rules.initial_rad) * _PER_TURN
            own = fast_atan2(s, c) * _PER_TURN - initial
            turns = own + ((predicted - own + _ROUND) - _ROUND)
            off2 = (predicted - turns) * (predicted - turns)
            inside = turns >= rules.low_turns and turns <= rules.high_turns
            if inside and off2 < np.float32(16.0) * (own2 + BENT_TURNS2) and off2 < np.float32(0.0625):
                decoded.rejected[y, x] = 0
                decoded.phase_rad[y, x] = turns * _TWO_PI + rules.initial_rad
                if decoded.sigma_rad.shape[0] > 0:
                    decoded.sigma_rad[y, x] = _TWO_PI * np.sqrt(own2)
                if decoded.confidence.shape[0] > 0:
                    decoded.confidence[y, x] = (np.float32(0.5) - np.sqrt(off2)) / np.sqrt(own2 + BENT_TURNS2)
