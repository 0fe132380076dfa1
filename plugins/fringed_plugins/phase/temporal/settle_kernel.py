"""Inner loops of the correction: the order that the best window around a pixel gives it.

Owns what counts as doubtful, and the numbers that both ways of correction share; `correction` calls them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.temporal.windows import BEST, MODULATION, POWER, RADIUS, SECOND, SLOPE_X, SLOPE_Y, TURNS

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
def _measure(place: Any, cosine: Any, sine: Any, factor: Any, initial: Any, own: Any) -> None:
    """Write the pixel's own phases (turns), their inverse variances, and squared modulations."""
    i, j, variance = place
    for m in range(factor.size):
        c, s = cosine[m, i, j], sine[m, i, j]
        own[0, m] = fast_atan2(s, c) * _PER_TURN - initial[m]
        own[2, m] = c * c + s * s
        own[1, m] = own[2, m] / (factor[m] * variance + np.float32(1e-12))


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
def _brightest(i: int, j: int, view: Any) -> np.float32:
    """Return the largest power of the nine windows that hold the pixel."""
    most = _ZERO
    for y in range(max(i - RADIUS, 0), min(i + RADIUS + 1, view.shape[0]), RADIUS):
        for x in range(max(j - RADIUS, 0), min(j + RADIUS + 1, view.shape[1]), RADIUS):
            most = max(most, view[y, x, POWER])
    return most


@njit(**options)
def _usable(place: Any, y: int, x: int, view: Any, rules: Any) -> bool:
    """Tell whether the window around (y, x) is sure of its order, and has the light of this pixel."""
    _, _, variance, mean2, part = place
    lit = mean2 >= part * (view[y, x, POWER] - rules.noise_power * variance)
    sure = view[y, x, BEST] < rules.sure2 and view[y, x, SECOND] > rules.sure2
    light2 = view[y, x, MODULATION] * view[y, x, MODULATION]
    return bool(sure and lit and light2 >= rules.least_snr2 * variance)


@njit(**options)
def _placed(place: Any, y: int, x: int, here: np.float32, view: Any) -> Any:
    """Return what the window's plane predicts for the pixel, and the pixel's own phase with that order."""
    i, j = place[0], place[1]
    predicted = view[y, x, TURNS] + np.float32(j - x) * view[y, x, SLOPE_X] + np.float32(i - y) * view[y, x, SLOPE_Y]
    return predicted, here + ((predicted - here + _ROUND) - _ROUND)


@njit(**options)
def _offer(place: Any, window: Any, own: Any, ratio: Any, view: Any, rules: Any) -> Any:
    """Return how well the window around (y, x) explains the pixel (huge: not at all), and the phase it gives it."""
    y, x = window
    variance, light2 = place[2], view[y, x, MODULATION] * view[y, x, MODULATION]
    if not _usable(place, y, x, view, rules):
        return _HUGE, _ZERO, _ZERO
    predicted, turns = _placed(place, y, x, own[0, ratio.size - 1], view)
    against, shift, information = _misfit(own, ratio, turns)
    off2 = (predicted - turns) * (predicted - turns)
    misfit = against + off2 / (rules.factor * variance / light2 + BENT_TURNS2)
    if misfit >= rules.sure2:
        return _HUGE, _ZERO, _ZERO
    score = misfit - _MARGIN_WEIGHT * min(view[y, x, SECOND] - view[y, x, BEST], _PLENTY)
    if rules.combine:
        return score, turns + shift, np.float32(1) / np.sqrt(information)
    return score, turns, np.float32(1) / np.sqrt(own[1, ratio.size - 1])


@njit(**options)
def _agreed(place: Any, here: np.float32, view: Any, rules: Any) -> Any:
    """Return the surest usable window around a pixel, and whether all usable ones give it one order; or (-1, -1)."""
    i, j = place[0], place[1]
    height, width = view.shape[:2]
    low, high, most, row, column = _HUGE, -_HUGE, -_HUGE, -1, -1
    for y in range(max(i - RADIUS, i % RADIUS), min(i + RADIUS + 1, height), RADIUS):
        for x in range(max(j - RADIUS, j % RADIUS), min(j + RADIUS + 1, width), RADIUS):
            if _usable(place, y, x, view, rules):
                turns = _placed(place, y, x, here, view)[1]
                low, high = min(low, turns), max(high, turns)
                margin = view[y, x, SECOND] - view[y, x, BEST]
                if margin > most:
                    most, row, column = margin, y, x
    return row, column, high - low < _HALF


@njit(**options)
def _disputed(place: Any, own: Any, ratio: Any, view: Any, rules: Any) -> Any:
    """Return the window that fits best, unless one with another order fits as well; (-1, -1) then."""
    i, j = place[0], place[1]
    height, width = view.shape[:2]
    other, least, found, row, column = _HUGE, _HUGE, _ZERO, -1, -1
    for y in range(max(i - RADIUS, i % RADIUS), min(i + RADIUS + 1, height), RADIUS):
        for x in range(max(j - RADIUS, j % RADIUS), min(j + RADIUS + 1, width), RADIUS):
            score, turns, _ = _offer(place, (y, x), own, ratio, view, rules)
            differs = abs(turns - found) > _HALF
            if score < least:
                other = least if differs else other
                least, found, row, column = score, turns, y, x
            elif differs:
                other = min(other, score)
    clear = other - least >= _CLEAR
    return (row, column) if clear else (-1, -1)


@njit(**options)
def _settle(place: Any, own: Any, ratio: Any, view: Any, rules: Any) -> Any:
    """Return score (huge: none), absolute phase, deviation and confidence by the best window that holds the pixel."""
    row, column, agreed = _agreed(place, own[0, ratio.size - 1], view, rules)
    if row >= 0 and not agreed:
        row, column = _disputed(place, own, ratio, view, rules)
    if row < 0:
        return _HUGE, _ZERO, _ZERO, _ZERO
    score, turns, sigma = _offer(place, (row, column), own, ratio, view, rules)
    sure_by = (np.sqrt(view[row, column, SECOND]) - np.sqrt(view[row, column, BEST])) / np.float32(2)
    return score, turns, sigma, sure_by


@njit(**options)
def settle_rows(rows: Any, decoded: Any, parts: Any, view: Any, search: Any, rules: Any) -> None:
    """Take the windows' word in `rows` (first, last, and the first row of `parts`)."""
    first, stop, offset = rows
    # Arrays are taken out of their tuples once: each time is counted, and costs more than what is done with them.
    cosine, sine = parts
    ratio, factor, initial = search.ratio, search.factor, search.initial_turns
    all_rejected, all_modulation, all_background = decoded.rejected, decoded.modulation, decoded.background
    own, part = np.empty((3, ratio.size), np.float32), _OWN_PART if ratio.size > 1 else _OWN_PART_ALONE
    for y in range(first, stop):
        i = y - offset
        for x in range(all_rejected.shape[1]):
            flags = all_rejected[y, x]
            if flags == 0 or (flags & SETTLED) != 0 or all_modulation[y, x] < rules.least_dn:
                continue
            variance = rules.noise_constant + rules.noise_slope * max(all_background[y, x], _ZERO)
            noise = rules.noise_power * variance
            if view[i, x, POWER] - noise < _LIT_PART * (_brightest(i, x, view) - noise):
                continue  # outside of what is lit: the windows that reach in have more light
            _measure((i, x, variance), cosine, sine, factor, initial, own)
            place = (i, x, variance, _mean(own[2]), part)
            score, turns, sigma, sure_by = _settle(place, own, ratio, view, rules)
            if score < _HUGE:
                _take((y, x), (turns, sigma, sure_by), decoded, rules)


@njit(**options)
def _take(place: Any, values: Any, decoded: Any, rules: Any) -> None:
    y, x = place
    turns, sigma, sure_by = values
    if turns < rules.low_turns or turns > rules.high_turns:
        decoded.rejected[y, x] = np.uint16(OUT_OF_RANGE)
        return
    decoded.rejected[y, x] = np.uint16(0)
    decoded.phase_rad[y, x] = turns * _TWO_PI + rules.initial_rad
    if decoded.sigma_rad.shape[0] > 0:
        decoded.sigma_rad[y, x] = _TWO_PI * sigma
    if decoded.confidence.shape[0] > 0:
        decoded.confidence[y, x] = sure_by
