"""Inner loops of the correction: the order that the best window around a pixel gives it.

Owns what counts as doubtful, and the numbers that both ways of correction share; `correction` calls them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.temporal.windows import RADIUS

LOW_MODULATION, FRINGE_ORDER, OUT_OF_RANGE = 2, 4, 16
SETTLED = np.uint16(0xFFFF - LOW_MODULATION - FRINGE_ORDER - OUT_OF_RANGE)  # dropped for other reasons
BENT_TURNS2 = np.float32(0.03**2)  # what a surface may differ from a plane within a window
options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}

_ZERO = np.float32(0)
_HALF = np.float32(0.5)
_TWO_PI = np.float32(2 * np.pi)
_PER_TURN = np.float32(0.5 / np.pi)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to the nearest integer
_HUGE = np.float32(1e30)
_PLENTY = np.float32(200.0)
_LIT_PART = np.float32(0.55)
_OWN_PART = np.float32(0.4)  # of a window's squared modulation, mean of all periods: noise alone has less
_OWN_PART_ALONE = np.float32(0.15)  # ... of one period, which noise can take away
_CLEAR = np.float32(8.0)
_MARGIN_WEIGHT = np.float32(0.1)


class Rules(NamedTuple):
    """Numbers of the correction, float32."""

    noise_constant: np.float32
    noise_slope: np.float32
    factor: np.float32  # variance of the finest phase (turns^2): factor * noise variance / modulation^2
    noise_power: np.float32  # mean square of the modulation that is noise, over the noise's variance
    least_snr2: np.float32  # smallest squared modulation of a window over the noise's variance
    least_dn: np.float32
    sure2: np.float32
    low_turns: np.float32
    high_turns: np.float32
    initial_rad: np.float32
    combine: bool  # average the phase over all periods


@njit(**options)
def doubtful_rows(start: int, stop: int, decoded: Any, rules: Any, counts: Any) -> None:
    """Count the doubtful pixels of each row: dropped for noise alone, with fringes left in them."""
    for y in range(start, stop):
        rejected, modulation = decoded.rejected[y], decoded.modulation[y]
        every, total = np.uint16(0), 0
        for x in range(rejected.size):  # the compiler vectorises it, and most rows end here
            every |= rejected[x]
        if every == 0:
            counts[y] = 0
            continue
        for x in range(rejected.size):
            flags = rejected[x]
            doubtful = flags != 0 and (flags & SETTLED) == 0 and modulation[x] >= rules.least_dn
            total += 1 if doubtful else 0
        counts[y] = total


@njit(**options)
def _measure(i: int, j: int, parts: Any, search: Any, variance: np.float32, own: Any) -> None:
    """Write the pixel's own phases (turns), their inverse variances, and squared modulations."""
    cosine, sine = parts
    for m in range(search.ratio.size):
        c, s = cosine[m, i, j], sine[m, i, j]
        own[0, m] = fast_atan2(s, c) * _PER_TURN - search.initial_turns[m]
        own[2, m] = c * c + s * s
        own[1, m] = own[2, m] / (search.factor[m] * variance + np.float32(1e-12))


@njit(**options)
def _misfit(own: Any, ratio: Any, turns: np.float32) -> Any:
    """Return how badly an order fits the pixel's own phases, in variances, and where all of them put the phase.

    The phase itself is free to move from that of the finest period, `turns`, whose noise would else count in all.
    """
    squares, lean, information = _ZERO, _ZERO, _ZERO
    for m in range(ratio.size):
        off = own[0, m] - ratio[m] * turns
        off -= (off + _ROUND) - _ROUND
        squares += off * off * own[1, m]
        lean += off * own[1, m] * ratio[m]
        information += own[1, m] * ratio[m] * ratio[m]
    return squares - lean * lean / information, lean / information, information


@njit(**options)
def _mean(values: Any) -> np.float32:
    total = _ZERO
    for m in range(values.size):
        total += values[m]
    return total / np.float32(values.size)


@njit(**options)
def _brightest(i: int, j: int, power: Any) -> np.float32:
    """Return the largest power of the nine windows that hold the pixel."""
    most = _ZERO
    for y in range(max(i - RADIUS, 0), min(i + RADIUS + 1, power.shape[0]), RADIUS):
        for x in range(max(j - RADIUS, 0), min(j + RADIUS + 1, power.shape[1]), RADIUS):
            most = max(most, power[y, x])
    return most


@njit(**options)
def _offer(place: Any, y: int, x: int, own: Any, view: Any, rules: Any) -> Any:
    """Return how well the window around (y, x) explains the pixel (huge: not at all), and the phase it gives it."""
    i, j, variance, ratio = place
    light2 = view.modulation[y, x] * view.modulation[y, x]
    sure = view.best[y, x] < rules.sure2 and view.second[y, x] > rules.sure2
    part = (_OWN_PART if ratio.size > 1 else _OWN_PART_ALONE) * (view.power[y, x] - rules.noise_power * variance)
    if not sure or _mean(own[2]) < part or light2 < rules.least_snr2 * variance:
        return _HUGE, _ZERO, _ZERO
    here = own[0, ratio.size - 1]
    predicted = view.turns[y, x] + np.float32(j - x) * view.slope_x[y, x] + np.float32(i - y) * view.slope_y[y, x]
    turns = here + ((predicted - here + _ROUND) - _ROUND)
    against, shift, information = _misfit(own, ratio, turns)
    off2 = (predicted - turns) * (predicted - turns)
    misfit = against + off2 / (rules.factor * variance / light2 + BENT_TURNS2)
    if misfit >= rules.sure2:
        return _HUGE, _ZERO, _ZERO
    score = misfit - _MARGIN_WEIGHT * min(view.second[y, x] - view.best[y, x], _PLENTY)
    if rules.combine:
        return score, turns + shift, np.float32(1) / np.sqrt(information)
    return score, turns, np.float32(1) / np.sqrt(own[1, ratio.size - 1])


@njit(**options)
def _settle(place: Any, own: Any, view: Any, rules: Any) -> Any:
    """Return, of the best window that holds the pixel, score (huge: none), absolute phase, deviation, confidence."""
    i, j, variance, _ = place
    height, width = view.turns.shape
    noise = rules.noise_power * variance
    other, least, found, sigma, sure_by = _HUGE, _HUGE, _ZERO, _ZERO, _ZERO
    if view.power[i, j] - noise < _LIT_PART * (_brightest(i, j, view.power) - noise):
        return least, found, sigma, sure_by  # outside of what is lit: the windows that reach in have more light
    for y in range(i - RADIUS, i + RADIUS + 1, RADIUS):
        for x in range(j - RADIUS, j + RADIUS + 1, RADIUS):
            if y < 0 or y >= height or x < 0 or x >= width:
                continue
            score, turns, deviation = _offer(place, y, x, own, view, rules)
            differs = abs(turns - found) > _HALF
            if score < least:
                other = least if differs else other
                least, found, sigma = score, turns, deviation
                sure_by = (np.sqrt(view.second[y, x]) - np.sqrt(view.best[y, x])) / np.float32(2)
            elif differs:
                other = min(other, score)
    # Windows that fit as well, and say another order, leave it in doubt.
    return least if other - least >= _CLEAR else _HUGE, found, sigma, sure_by


@njit(**options)
def settle_rows(rows: Any, decoded: Any, parts: Any, view: Any, search: Any, rules: Any) -> None:
    """Take the windows' word in `rows` (first, last, and the first row of `parts`)."""
    first, stop, offset = rows
    own = np.empty((3, search.ratio.size), np.float32)
    for y in range(first, stop):
        for x in range(decoded.rejected.shape[1]):
            flags = decoded.rejected[y, x]
            if flags == 0 or (flags & SETTLED) != 0 or decoded.modulation[y, x] < rules.least_dn:
                continue
            level = max(decoded.background[y, x], _ZERO)
            variance = rules.noise_constant + rules.noise_slope * level
            _measure(y - offset, x, parts, search, variance, own)
            least, turns, sigma, sure_by = _settle((y - offset, x, variance, search.ratio), own, view, rules)
            if least >= _HUGE:
                continue
            outside = turns < rules.low_turns or turns > rules.high_turns
            decoded.rejected[y, x] = np.uint16(OUT_OF_RANGE) if outside else np.uint16(0)
            if not outside:
                decoded.phase_rad[y, x] = turns * _TWO_PI + rules.initial_rad
                if decoded.sigma_rad.shape[0] > 0:
                    decoded.sigma_rad[y, x] = _TWO_PI * sigma
                if decoded.confidence.shape[0] > 0:
                    decoded.confidence[y, x] = sure_by
