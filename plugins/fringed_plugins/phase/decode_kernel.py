"""The fused kernel: frames to phase and mask in one pass over the pixels, and the same in parts while frames arrive.

Owns the order in which a block's loops run, and their scratch; the loops are in `level_kernel`, `finish_kernel` and
`sums`. What is taken out of a tuple of arrays costs time (each is counted), so that this is done once for many pixels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.compiled import kept
from fringed_plugins.phase import arctangent, closed_forms, finish_kernel, level_kernel, shifts
from fringed_plugins.phase import sums as sums_module
from fringed_plugins.phase.closed_forms import Sums
from fringed_plugins.phase.finish_kernel import (
    Maps,
    last_level,
    three_levels,
    write_confidence,
    write_residual,
    write_sigma,
    write_wrap,
    write_wrapped,
)
from fringed_plugins.phase.level_kernel import (
    BLOCK_PX,
    Block,
    Level,
    Limits,
    State,
    add_level,
    add_margin,
    begin_margin,
    begin_state,
    copy_pixels,
    options,
)
from fringed_plugins.phase.shifts import CHUNKS, COUNTS, FORM, INITIAL, MISFIT, PLACES, RATIO, VARIANCE
from fringed_plugins.phase.sums import begin_sums, fold, new_sums, sums_between

_CALLED = (arctangent, closed_forms, finish_kernel, level_kernel, shifts, sums_module)


class Part(NamedTuple):
    """What of the work a call does: groups `first` to `last`, the finest of which writes the maps if it `finishes`."""

    first: int
    last: int
    finishes: bool
    kept: bool  # the state is that of all pixels; otherwise a block's is scratch
    summed: bool  # the group's sums are complete already


class Job(NamedTuple):
    """What a call works with besides the frames: state and sums of all pixels, where kept, limits, and the maps."""

    part: Part
    state: State
    sums: Sums
    limits: Limits
    out: Any  # decoded.Decoded


@njit(**options)
def new_state(count: int, margin: bool) -> State:
    """Return an empty state of `count` pixels; its margin is empty where none is wanted."""
    other = count if margin else 0
    return State(
        np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.uint8),
        np.empty(other, np.float32), np.empty(other, np.float32),
    )  # fmt: skip


@njit(**options)
def _state_between(state: State, a: int, b: int) -> State:
    return State(state.turns[a:b], state.coarsest[a:b], state.flags[a:b], state.margin[a:b], state.inverse[a:b])


@njit(**options)
def _new_block() -> Block:
    return Block(
        np.empty(BLOCK_PX, np.float32), np.empty(BLOCK_PX, np.float32), np.empty(BLOCK_PX, np.float32),
        np.empty(BLOCK_PX, np.float32), np.empty(BLOCK_PX, np.float32),
    )  # fmt: skip


@njit(**options)
def _add_up(frames: Any, places: Any, weights: Any, sums: Sums) -> None:
    """Add up all frames (n, count) of a group."""
    begin_sums(frames[places[0]], sums)
    for q in range(weights.shape[0]):
        i = places[4 * q : 4 * q + 4]
        fold((frames[i[0]], frames[i[1]], frames[i[2]], frames[i[3]]), weights[q], sums)


@njit(**options)
def _write_further(a: int, b: int, limits: Limits, block: Block, margin: Any, out: Any) -> None:
    """Write what else is wanted of pixels `a` to `b`."""
    if out.wrapped_rad.size > 0:
        write_wrap(block.turns, out.wrapped_rad[a:b])
    if out.background.size > 0:
        copy_pixels(block.background, out.background[a:b])
    if out.sigma_rad.size > 0:
        write_sigma(limits, block.background, out.modulation[a:b], out.phase_rad[a:b], out.sigma_rad[a:b])
    if out.residual.size > 0:
        write_residual(limits, block.squares, out.residual[a:b])
    if out.confidence.size > 0:
        write_confidence(margin, out.confidence[a:b])


@njit(**options)
def _level(n: Any) -> Level:
    """Return a row of a plan's numbers as a level."""
    return Level(
        n[INITIAL], n[RATIO], n[COUNTS], n[VARIANCE], n[MISFIT], n[MISFIT + 1], n[MISFIT + 2]
    )  # fmt: skip


@njit(**options)
def _wrapped(form: int, v: Any, i: Any, sums: Sums, tools: Any) -> None:
    """Write the maps of a block of the only group; what else a block leaves goes into `block`, unless that is None."""
    level, limits, block, maps = tools
    if form == 3:
        write_wrapped((v[i[0]], v[i[1]], v[i[2]]), level, limits, block, maps)
    elif form == 4:
        write_wrapped((v[i[0]], v[i[1]], v[i[2]], v[i[3]]), level, limits, block, maps)
    elif form == 6:
        write_wrapped((v[i[0]], v[i[1]], v[i[2]], v[i[3]], v[i[4]], v[i[5]]), level, limits, block, maps)
    else:
        write_wrapped(sums, level, limits, block, maps)


@kept(*_CALLED, **options)
def wrapped_blocks(start: int, stop: int, frames: Any, plan: Any, job: Job) -> None:
    """Decode the only group of blocks `start` to `stop` of `frames` (n, pixels) into the maps of `job`."""
    part, _, kept_sums, limits, out = job
    form, i, level, block = plan.frames[0, FORM], plan.frames[0, PLACES:], _level(plan.numbers[0]), _new_block()
    sums = new_sums(frames, 1 if part.summed or form > 0 else BLOCK_PX, plan.normal[0])
    lean = out.background.size + out.sigma_rad.size + out.wrapped_rad.size + out.residual.size == 0
    for number in range(start, stop):
        a, b = number * BLOCK_PX, min((number + 1) * BLOCK_PX, frames.shape[1])
        v = frames[:, a:b]
        maps = Maps(out.phase_rad[a:b], out.modulation[a:b], out.rejected[a:b])
        if part.summed:
            sums = sums_between(kept_sums, a, b, plan.normal[0])
        elif form == 0:
            _add_up(v, i, plan.weights[0, : plan.frames[0, CHUNKS]], sums)
        if lean:
            _wrapped(form, v, i, sums, (level, limits, None, maps))
        else:
            _wrapped(form, v, i, sums, (level, limits, block, maps))
            _write_further(a, b, limits, block, block.off, out)


@njit(**options)
def _margin(g: int, level: Level, limits: Limits, state: State, block: Block) -> None:
    if state.margin.size == 0:
        return
    if g == 0:
        begin_margin(level, limits, state, block)
    else:
        add_margin(level, limits, state, block)


@njit(**options)
def _add(form: int, v: Any, i: Any, sums: Sums, level: Level, tools: Any) -> None:
    """Take a level that is not the finest into the state; `v` are the block's frames, `i` the group's of them."""
    limits, state, block = tools
    if form == 3:
        add_level((v[i[0]], v[i[1]], v[i[2]]), level, limits, state, block)
    elif form == 4:
        add_level((v[i[0]], v[i[1]], v[i[2]], v[i[3]]), level, limits, state, block)
    else:
        add_level(sums, level, limits, state, block)


@njit(**options)
def _finish(form: int, v: Any, i: Any, sums: Sums, level: Level, tools: Any) -> None:
    """Take the finest level and write the maps."""
    state, block, limits, maps = tools
    if form == 3:
        last_level((v[i[0]], v[i[1]], v[i[2]]), level, state, limits, block, maps)
    elif form == 4:
        last_level((v[i[0]], v[i[1]], v[i[2]], v[i[3]]), level, state, limits, block, maps)
    else:
        last_level(sums, level, state, limits, block, maps)


@njit(**options)
def _three_fours(v: Any, plan: Any, limits: Limits, block: Block, maps: Maps, sigma: Any) -> None:
    """Decode three groups of four frames in one loop: the set that is the most used by far."""
    i = plan.frames[:, PLACES:]
    rows = (
        (v[i[0, 0]], v[i[0, 1]], v[i[0, 2]], v[i[0, 3]]),
        (v[i[1, 0]], v[i[1, 1]], v[i[1, 2]], v[i[1, 3]]),
        (v[i[2, 0]], v[i[2, 1]], v[i[2, 2]], v[i[2, 3]]),
    )
    levels = (_level(plan.numbers[0]), _level(plan.numbers[1]), _level(plan.numbers[2]), plan.centre_turns)
    three_levels(rows, levels, limits, block, maps, sigma)


@njit(**options)
def _all_of(v: Any, plan: Any, limits: Limits, block: Block, maps: Maps, span: Any) -> None:
    """Decode three groups of four frames with all that is wanted of pixels `a` to `b`."""
    a, b, margin, out = span
    if out.sigma_rad.size > 0 and out.wrapped_rad.size + out.residual.size == 0:
        _three_fours(v, plan, limits, block, maps, out.sigma_rad[a:b])
        if out.background.size > 0:
            copy_pixels(block.background, out.background[a:b])
    else:
        _three_fours(v, plan, limits, block, maps, None)
        _write_further(a, b, limits, block, margin, out)


@njit(**options)
def _in_turn(v: Any, plan: Any, part: Part, state: State, sums: Sums, tools: Any) -> None:
    """Take the part's groups one after the other; `sums` are those of the block, or room for them."""
    limits, block, maps = tools
    if part.first == 0:
        begin_state(state, plan.centre_turns)
    for g in range(part.first, part.last):
        level, form, i = _level(plan.numbers[g]), plan.frames[g, FORM], plan.frames[g, PLACES:]
        here = sums_between(sums, 0, v.shape[1], plan.normal[g])
        if form == 0 and not part.summed:
            _add_up(v, i, plan.weights[g, : plan.frames[g, CHUNKS]], here)
        if part.finishes and g == part.last - 1:
            _finish(form, v, i, here, level, (state, block, limits, maps))
        else:
            _add(form, v, i, here, level, (limits, state, block))
            if g == 0:
                copy_pixels(block.square, state.coarsest)
        _margin(g, level, limits, state, block)


@kept(*_CALLED, **options)
def absolute_blocks(start: int, stop: int, frames: Any, plan: Any, job: Job) -> None:
    """Decode groups of blocks `start` to `stop` of `frames` (n, pixels) into the state, or the maps, of `job`.

    Groups before the part's first one are in the job's state already, which then is that of all pixels.
    """
    part, kept_state, kept_sums, limits, out = job
    block, forms = _new_block(), plan.frames[:, FORM]
    whole = new_state(1 if part.kept else BLOCK_PX, out.confidence.size > 0)
    scratch = new_sums(frames, 1 if part.summed else BLOCK_PX, plan.normal[0])
    three_fours = part.finishes and part.last - part.first == 3 and out.confidence.size == 0
    three_fours = three_fours and forms[0] == 4 and forms[1] == 4 and forms[2] == 4
    for number in range(start, stop):
        a, b = number * BLOCK_PX, min((number + 1) * BLOCK_PX, frames.shape[1])
        v = frames[:, a:b]
        m = b if part.finishes else a  # a part that is not the last has no maps
        maps = Maps(out.phase_rad[a:m], out.modulation[a:m], out.rejected[a:m])
        if three_fours:
            _all_of(v, plan, limits, block, maps, (a, b, block.off, out))
            continue
        state = _state_between(kept_state, a, b) if part.kept else _state_between(whole, 0, b - a)
        sums = sums_between(kept_sums, a, b, plan.normal[0]) if part.summed else scratch
        _in_turn(v, plan, part, state, sums, (limits, block, maps))
        if part.finishes:
            _write_further(a, b, limits, block, state.margin, out)
