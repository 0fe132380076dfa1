"""Last loops of decoding: what a block's levels found becomes phase, mask and the maps that were asked for.

Owns the reasons for which a pixel is dropped by itself; those that need its neighbours are in `cleaning`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.closed_forms import fit_at
from fringed_plugins.phase.level_kernel import (
    PER_TURN,
    ROUND,
    Block,
    Level,
    Limits,
    State,
    next_turns,
    options,
    reasons,
    unless_finite,
    variance_of,
)

_HALF = np.float32(0.5)
_ZERO = np.float32(0.0)
_TWO_PI = np.float32(2 * np.pi)
_NAN = np.float32(np.nan)
_TINY = np.float32(1e-12)
_NONE = np.int32(0)
# The contract's reasons, as `fringed.data.Reject` has them.
_SATURATED, _FRINGE_ORDER = np.int32(1), np.int32(4)
_OUT_OF_RANGE, _DISCONTINUITY = np.int32(16), np.int32(64)


class Maps(NamedTuple):
    """What is always written, of one block."""

    phase: Any
    modulation: Any
    rejected: Any


@njit(**options)
def write_wrapped(rows: Any, level: Level, limits: Limits, block: Block | None, maps: Maps) -> None:
    """Write wrapped phase, modulation and mask of a block of one group; leave the unmasked phase in `block.turns`."""
    phase, modulation, rejected = maps
    for x in range(phase.size):
        light, cosine, sine, square, brightest = fit_at(rows, np.uintp(x))
        angle = fast_atan2(sine, cosine)
        modulation2 = cosine * cosine + sine * sine
        flag = np.int32(reasons(light, modulation2, square, level, limits) | unless_finite(modulation2))
        flag = np.int32(flag | (_SATURATED if brightest >= limits.saturation else _NONE))
        if block is not None:  # decided when the loop is compiled
            block.turns[x] = angle * PER_TURN
            block.background[x] = light
            block.squares[x] = square
        modulation[x] = np.sqrt(modulation2)
        phase[x] = angle if flag == _NONE else _NAN
        rejected[x] = np.uint16(flag)


@njit(**options)
def _around(t: Any, limits: Limits) -> Any:
    """Return turns within the projector's circle, where there is one."""
    per_wrap = np.float32(1) / limits.wrap_turns if limits.wrap_turns > _ZERO else _ZERO
    return t - limits.wrap_turns * ((((t - limits.cut_turns) * per_wrap - _HALF) + ROUND) - ROUND)


@njit(**options)
def _outside(t: Any, limits: Limits) -> Any:
    flag = _OUT_OF_RANGE if t < limits.low_turns else _NONE
    return np.int32(flag | (_OUT_OF_RANGE if t > limits.high_turns else _NONE))


@njit(**options)
def last_level(rows: Any, level: Level, state: State, limits: Limits, block: Block, maps: Maps) -> None:
    """Take the finest level and write absolute phase, modulation and mask; the state stays as it was."""
    phase, modulation, rejected = maps
    for x in range(phase.size):
        light, cosine, sine, square, brightest = fit_at(rows, np.uintp(x))
        t, off = next_turns(cosine, sine, state.turns[x], level)
        t = _around(t, limits)
        modulation2 = cosine * cosine + sine * sine
        flag = np.int32(np.int32(state.flags[x]) | reasons(light, modulation2, square, level, limits))
        flag = np.int32(flag | unless_finite(modulation2))
        flag = np.int32(flag | _outside(t, limits))
        flag = np.int32(flag | (_SATURATED if brightest >= limits.saturation else _NONE))
        flag = np.int32(flag | (_FRINGE_ORDER if off > limits.misfit_turns else _NONE))
        flag = np.int32(flag | (_DISCONTINUITY if modulation2 < limits.drop2 * state.coarsest[x] else _NONE))
        block.turns[x] = t + limits.initial_rad * PER_TURN
        block.off[x] = off
        block.square[x] = modulation2
        block.background[x] = light
        block.squares[x] = square
        modulation[x] = np.sqrt(modulation2)
        phase[x] = t * _TWO_PI + limits.initial_rad if flag == _NONE else _NAN
        rejected[x] = np.uint16(flag)


@njit(**options)
def three_levels(rows: Any, levels: Any, limits: Limits, block: Block, maps: Maps, sigma: Any) -> None:
    """Take three groups at once and write absolute phase, modulation and mask: `last_level` without a state.

    What a pixel carries stays in the processor's registers, which takes a quarter of the time off. With `sigma` the
    deviation is written too; without it, None, what `block` takes for further maps.
    """
    coarse, middle, fine = rows
    first, second, third, centre_turns = levels
    phase, modulation, rejected = maps
    for x in range(phase.size):
        light, cosine, sine, square, brightest = fit_at(coarse, np.uintp(x))
        t, _ = next_turns(cosine, sine, centre_turns, first)
        coarsest = cosine * cosine + sine * sine
        flag = reasons(light, coarsest, square, first, limits)
        light, cosine, sine, square, high = fit_at(middle, np.uintp(x))
        t, misfit = next_turns(cosine, sine, t, second)
        brightest = high if high > brightest else brightest
        modulation2 = cosine * cosine + sine * sine
        total = coarsest + modulation2
        flag = np.int32(flag | reasons(light, modulation2, square, second, limits))
        light, cosine, sine, square, high = fit_at(fine, np.uintp(x))
        t, off = next_turns(cosine, sine, t, third)
        t = _around(t, limits)
        brightest = high if high > brightest else brightest
        misfit = off if off > misfit else misfit
        modulation2 = cosine * cosine + sine * sine
        flag = np.int32(flag | reasons(light, modulation2, square, third, limits))
        flag = np.int32(flag | _outside(t, limits) | unless_finite(total + modulation2))
        flag = np.int32(flag | (_SATURATED if brightest >= limits.saturation else _NONE))
        flag = np.int32(flag | (_FRINGE_ORDER if misfit > limits.misfit_turns else _NONE))
        flag = np.int32(flag | (_DISCONTINUITY if modulation2 < limits.drop2 * coarsest else _NONE))
        block.background[x] = light
        if sigma is None:  # decided when the loop is compiled
            block.turns[x] = t + limits.initial_rad * PER_TURN
            block.squares[x] = square
        else:
            variance = limits.phase_factor * variance_of(light, limits)
            sigma[x] = np.sqrt(variance / (modulation2 + _TINY)) if flag == _NONE else _NAN
        modulation[x] = np.sqrt(modulation2)
        phase[x] = t * _TWO_PI + limits.initial_rad if flag == _NONE else _NAN
        rejected[x] = np.uint16(flag)


@njit(**options)
def write_sigma(limits: Limits, background: Any, modulation: Any, phase: Any, sigma: Any) -> None:
    """Write the standard deviation of the phase; NaN where there is no phase."""
    for x in range(sigma.size):
        square = modulation[x] * modulation[x] + _TINY
        deviation = np.sqrt(limits.phase_factor * variance_of(background[x], limits) / square)
        sigma[x] = _NAN if np.isnan(phase[x]) else deviation


@njit(**options)
def write_residual(limits: Limits, squares: Any, residual: Any) -> None:
    """Write the root mean square of the fit's residual components, in grey levels."""
    for x in range(residual.size):
        residual[x] = np.sqrt(squares[x] * limits.per_residual)


@njit(**options)
def write_confidence(margin: Any, confidence: Any) -> None:
    """Write by how many standard deviations of noise the least certain order is not the next one."""
    for x in range(confidence.size):
        confidence[x] = np.sqrt(margin[x])


@njit(**options)
def write_wrap(turns: Any, wrapped: Any) -> None:
    """Write turns as an angle, -pi to pi."""
    for x in range(wrapped.size):
        t = turns[x]
        wrapped[x] = (t - ((t + ROUND) - ROUND)) * _TWO_PI
