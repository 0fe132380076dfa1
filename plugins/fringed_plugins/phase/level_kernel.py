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
_NONE, _SATURATED, _FRINGE_ORDER, _OTHER = (
    np.int32(0),
    np.int32(1),
    np.int32(4),
    np.int32(128),
)  # as `fringed.data.Reject` has them
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
    squares: Any  # sum of the squared residuals of all levels
    weakest: Any  # smallest squared modulation of all levels
    coarsest: Any  # squared modulation of the first level
    flags: Any  # uint8: reasons found so far, as `fringed.data.Reject` has them
    margin: Any  # smallest (room for error)^2 of the levels' orders, over its variance for a frame's variance of 1
    inverse: Any  # variance of the last level's turns, for a frame's variance of 1


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
    misfit_turns: np.float32  # largest difference between prediction and measurement
    saturation: np.float32
    variance: np.float32  # of this group's turns, times squared modulation, for a frame's variance of 1


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
    turns, squares, weakest, flags = state.turns, state.squares, state.weakest, state.flags
    for x in range(turns.size):
        turns[x] = centre_turns
        squares[x] = _ZERO
        weakest[x] = _INFINITE
        flags[x] = np.uint8(0)


@njit(**options)
def add_level(rows: Any, count: int, level: Level, state: State, block: Block) -> None:
    """Carry the phase of a block's first `count` pixels from the level before to the one whose frames are `rows`."""
    turns, squares, weakest, flags = state.turns, state.squares, state.weakest, state.flags
    for x in range(count):
        _, cosine, sine, square, brightest = fit_at(rows, np.uintp(x))
        fine, off = next_turns(cosine, sine, turns[x], level)
        modulation2 = cosine * cosine + sine * sine
        turns[x] = fine
        block.off[x] = off
        block.square[x] = modulation2
        squares[x] += square
        weakest[x] = modulation2 if modulation2 < weakest[x] else weakest[x]
        flag = np.int32(flags[x]) | (_SATURATED if brightest >= level.saturation else _NONE)
        flag |= _FRINGE_ORDER if off > level.misfit_turns else _NONE
        flags[x] = np.uint8(flag | (_NONE if modulation2 < _INFINITE else _OTHER))


@njit(**options)
def begin_margin(level: Level, state: State, block: Block) -> None:
    """Start a block's margin with the first level's variance."""
    margin, inverse = state.margin, state.inverse
    for x in range(margin.size):
        margin[x] = _INFINITE
        inverse[x] = level.variance / (block.square[x] + _TINY)


@njit(**options)
def add_margin(level: Level, state: State, block: Block) -> None:
    """Take this level's room for error into a block's margin."""
    margin, inverse = state.margin, state.inverse
    gain = level.ratio * level.ratio
    for x in range(margin.size):
        mine = level.variance / (block.square[x] + _TINY)
        room = _HALF - block.off[x]
        room = room if room > _ZERO else _ZERO
        here = room * room / (gain * inverse[x] + mine)
        margin[x] = here if here < margin[x] else margin[x]
        inverse[x] = mine
