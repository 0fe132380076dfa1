"""Inner loops of decoding: one group of frames to its phase, with the integer that the coarser groups predict.

Owns what a pixel carries from level to level; `decode_kernel` owns the order of the levels. Every loop runs over a
block of pixels in float32 without branches, so that the compiler vectorises it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.closed_forms import fit_at

_ZERO = np.float32(0.0)
_NONE = np.int32(0)
# The contract's reasons, as `fringed.data.Reject` has them.
_SATURATED, _LOW_MODULATION, _FRINGE_ORDER = np.int32(1), np.int32(2), np.int32(4)
_RESIDUAL, _OTHER = np.int32(8), np.int32(128)
_HALF = np.float32(0.5)
_TINY = np.float32(1e-12)
_INFINITE = np.float32(np.inf)
PER_TURN = np.float32(0.5 / np.pi)
ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to the nearest integer
BLOCK_PX = 2048  # what one loop leaves for the next stays in the processor's cache
options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


class State(NamedTuple):
    """What a pixel carries from level to level: float32 but for the flags, one number a pixel.

    They are arrays of their own: of the rows of one array the compiler cannot prove that they do not overlap, and
    the loop that it falls back to takes ten times as long. `margin` and `inverse` are empty unless a confidence is
    asked for.
    """

    turns: Any  # phase of the last level in periods, counted from the projector's first column
    coarsest: Any  # squared modulation of the first level
    flags: Any  # uint8: reasons found so far, as `fringed.data.Reject` has them
    margin: Any  # smallest (room for error)^2 of the levels' orders, over its variance
    inverse: Any  # variance of the last level's turns


class Block(NamedTuple):
    """What one loop leaves for the next one over the same pixels: float32, scratch."""

    off: Any  # difference between this level and what the one before predicted, in turns
    square: Any  # squared modulation
    background: Any
    squares: Any  # sum of the squared residuals
    turns: Any  # the finest phase


class Level(NamedTuple):
    """Numbers of one group, float32."""

    initial_turns: np.float32
    ratio: np.float32  # period of the group before over this one's; 1 for the first
    counts: np.float32  # 1 where the prediction is one, 0 for the first group
    variance: np.float32  # of this group's turns, times squared modulation, for a frame's variance of 1
    misfit_constant: np.float32  # largest sum of squared residuals: constant + slope * background
    misfit_slope: np.float32
    misfit_part: np.float32  # ... plus this part of the squared modulation


class Limits(NamedTuple):
    """Numbers that hold for all groups, float32: noise model, thresholds and the projector's range."""

    noise_constant: np.float32  # variance of one frame: constant + slope * background, in DN^2
    noise_slope: np.float32
    phase_factor: np.float32  # sigma_phase^2 = factor * variance / modulation^2
    saturation: np.float32
    modulation2: np.float32  # smallest squared modulation in DN^2
    least_constant: np.float32  # smallest squared modulation over noise: constant + slope * background
    least_slope: np.float32
    per_residual: np.float32  # one over the number of the finest group's residual components
    misfit_turns: np.float32  # largest difference between a coarse prediction and a fine phase
    drop2: np.float32  # smallest squared ratio of the finest to the coarsest modulation
    wrap_turns: np.float32  # number of the finest periods, or 0 where the range is not circular
    cut_turns: np.float32  # where the finest phase is cut
    low_turns: np.float32  # range of the finest phase that is on the projector
    high_turns: np.float32
    initial_rad: np.float32  # added to the finest phase


@njit(**options)
def variance_of(light: Any, limits: Limits) -> Any:
    """Return the variance of a frame whose mean grey level is `light`."""
    return limits.noise_constant + limits.noise_slope * (light if light > _ZERO else _ZERO)


@njit(**options)
def reasons(light: Any, modulation2: Any, square: Any, level: Level, limits: Limits) -> Any:
    """Return the reasons to drop a pixel that one group's fit tells."""
    light = light if light > _ZERO else _ZERO
    least = limits.least_constant + limits.least_slope * light
    least = least if least > limits.modulation2 else limits.modulation2
    most = level.misfit_constant + level.misfit_slope * light + level.misfit_part * modulation2
    flag = _LOW_MODULATION if modulation2 < least else _NONE
    return np.int32(flag | (_RESIDUAL if square > most else _NONE))


@njit(**options)
def unless_finite(modulation2: Any) -> Any:
    """Return the reason to drop a pixel whose frames are not finite."""
    return _NONE if modulation2 < _INFINITE else _OTHER


@njit(**options)
def next_turns(cosine: Any, sine: Any, before: Any, level: Level) -> tuple[Any, Any]:
    """Return a level's phase in turns, with the integer that the level before predicts, and how far off that is."""
    part = fast_atan2(sine, cosine) * PER_TURN - level.initial_turns
    predicted = level.ratio * before
    turns = part + ((predicted - part + ROUND) - ROUND)
    return turns, abs(predicted - turns) * level.counts


@njit(**options)
def copy_pixels(source: Any, target: Any) -> None:
    """Copy pixels; numba's own assignment of arrays first asks whether they overlap, at ten times the cost."""
    for x in range(target.size):
        target[x] = source[x]


@njit(**options)
def begin_state(state: State, centre_turns: np.float32) -> None:
    """Set a block's state before the first level, whose phase lies within half a turn of `centre_turns`."""
    turns, flags = state.turns, state.flags
    for x in range(turns.size):
        turns[x] = centre_turns
        flags[x] = np.uint8(0)


@njit(**options)
def add_level(rows: Any, level: Level, limits: Limits, state: State, block: Block) -> None:
    """Carry the phase of a block from the level before to the one whose frames are `rows`."""
    turns, flags = state.turns, state.flags
    for x in range(turns.size):
        light, cosine, sine, square, brightest = fit_at(rows, np.uintp(x))
        fine, off = next_turns(cosine, sine, turns[x], level)
        modulation2 = cosine * cosine + sine * sine
        flag = np.int32(np.int32(flags[x]) | reasons(light, modulation2, square, level, limits))
        flag = np.int32(flag | unless_finite(modulation2))
        flag = np.int32(flag | (_SATURATED if brightest >= limits.saturation else _NONE))
        flag = np.int32(flag | (_FRINGE_ORDER if off > limits.misfit_turns else _NONE))
        turns[x] = fine
        flags[x] = np.uint8(flag)
        block.off[x] = off
        block.square[x] = modulation2
        block.background[x] = light


@njit(**options)
def begin_margin(level: Level, limits: Limits, state: State, block: Block) -> None:
    """Start a block's margin with the first level's variance."""
    margin, inverse = state.margin, state.inverse
    for x in range(margin.size):
        margin[x] = _INFINITE
        inverse[x] = level.variance * variance_of(block.background[x], limits) / (block.square[x] + _TINY)


@njit(**options)
def add_margin(level: Level, limits: Limits, state: State, block: Block) -> None:
    """Take this level's room for error into a block's margin."""
    margin, inverse = state.margin, state.inverse
    gain = level.ratio * level.ratio
    for x in range(margin.size):
        mine = level.variance * variance_of(block.background[x], limits) / (block.square[x] + _TINY)
        room = _HALF - block.off[x]
        room = room if room > _ZERO else _ZERO
        here = room * room / (gain * inverse[x] + mine + _TINY)
        margin[x] = here if here < margin[x] else margin[x]
        inverse[x] = mine
