"""The fused kernel: frames to phase and mask in one pass over the rows, and the same in parts while frames arrive.

Owns the order in which a row's loops run, and their scratch; the loops are in `level_kernel` and `finish_kernel`.
What one loop leaves for the next is a few rows, which stay in the processor's cache.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.closed_forms import Sums
from fringed_plugins.phase.finish_kernel import (
    Limits,
    Maps,
    confidence_row,
    last_level,
    residual_row,
    sigma_row,
    wrap_row,
    wrapped_row,
)
from fringed_plugins.phase.level_kernel import (
    Level,
    Row,
    State,
    add_level,
    add_margin,
    begin_margin,
    begin_row,
    copy_row,
    options,
    state_at,
)
from fringed_plugins.phase.sums import begin_sums, fold, new_sums, sums_at


class Part(NamedTuple):
    """What of the work a call does: groups `first` to `last`, the finest of which writes the maps if it `finishes`."""

    first: int
    last: int
    finishes: bool
    absolute: bool
    kept: bool  # the state is that of all rows; otherwise a row's is scratch
    summed: bool  # the group's sums are complete already


class Job(NamedTuple):
    """What a call works with besides the frames: where the state and sums of all rows are, limits, and the maps."""

    part: Part
    state: State
    sums: Sums
    limits: Limits
    out: Any  # decoded.Decoded


class Tools(NamedTuple):
    """A thread's own: scratch rows, and the row of state in work."""

    state: State
    sums: Sums
    row: Row


@njit(**options)
def new_state(rows: int, width: int, margin: bool) -> State:
    """Return an empty state of `rows` rows; its margin is (0, 0) where none is wanted."""
    shape = (rows, width)
    other = shape if margin else (0, 0)
    return State(
        np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32),
        np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32),
        np.empty(other, np.float32), np.empty(other, np.float32),
    )  # fmt: skip


@njit(**options)
def _new_row(width: int) -> Row:
    return Row(
        np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32),
        np.empty(width, np.float32), np.empty(width, np.float32),
    )  # fmt: skip


@njit(**options)
def _three(frames: Any, i: Any, y: int) -> tuple[Any, ...]:
    return frames[i[0], y], frames[i[1], y], frames[i[2], y]


@njit(**options)
def _four(frames: Any, i: Any, y: int) -> tuple[Any, ...]:
    return frames[i[0], y], frames[i[1], y], frames[i[2], y], frames[i[3], y]


@njit(**options)
def _six(frames: Any, i: Any, y: int) -> tuple[Any, ...]:
    return frames[i[0], y], frames[i[1], y], frames[i[2], y], frames[i[3], y], frames[i[4], y], frames[i[5], y]


@njit(**options)
def _summed(frames: Any, y: int, plan: Any, g: int, job: Job, sums: Sums) -> Sums:
    """Return the sums of row `y` of group `g`: those that are there, or all frames added up in scratch."""
    if job.part.summed:
        return sums_at(job.sums, y, plan.normal[g])
    here = sums_at(sums, 0, plan.normal[g])
    begin_sums(frames[plan.place[g, 0], y], here)
    for q in range(plan.chunks[g]):
        fold(_four(frames, plan.place[g, 4 * q : 4 * q + 4], y), plan.weights[g, q], here)
    return here


@njit(**options)
def _add(frames: Any, y: int, plan: Any, g: int, job: Job, tools: Tools) -> None:
    """Take row `y` of group `g` into the state."""
    level = Level(plan.initial_turns[g], plan.ratio[g], plan.counts[g], job.limits.saturation, plan.variance[g])
    i, state, row = plan.place[g], tools.state, tools.row
    if plan.form[g] == 3:
        add_level(_three(frames, i, y), level, state, row)
    elif plan.form[g] == 4:
        add_level(_four(frames, i, y), level, state, row)
    elif plan.form[g] == 6:
        add_level(_six(frames, i, y), level, state, row)
    else:
        add_level(_summed(frames, y, plan, g, job, tools.sums), level, state, row)
    if g == 0:
        copy_row(row.square, state.coarsest)
    _margin(g, level, state, row)


@njit(**options)
def _margin(g: int, level: Level, state: State, row: Row) -> None:
    if state.margin.size == 0:
        return
    if g == 0:
        begin_margin(level, state, row)
    else:
        add_margin(level, state, row)


@njit(**options)
def _last(frames: Any, y: int, plan: Any, g: int, job: Job, tools: Tools) -> None:
    """Take row `y` of the finest group and write its maps."""
    level = Level(plan.initial_turns[g], plan.ratio[g], plan.counts[g], job.limits.saturation, plan.variance[g])
    i, state, row, limits, out = plan.place[g], tools.state, tools.row, job.limits, job.out
    maps = Maps(out.phase_rad[y], out.modulation[y], out.rejected[y])
    if plan.form[g] == 3:
        last_level(_three(frames, i, y), level, state, limits, row, maps)
    elif plan.form[g] == 4:
        last_level(_four(frames, i, y), level, state, limits, row, maps)
    elif plan.form[g] == 6:
        last_level(_six(frames, i, y), level, state, limits, row, maps)
    else:
        last_level(_summed(frames, y, plan, g, job, tools.sums), level, state, limits, row, maps)
    _margin(g, level, state, row)


@njit(**options)
def _wrapped(frames: Any, y: int, plan: Any, job: Job, tools: Tools) -> None:
    """Write the maps of row `y` of the only group."""
    i, row, limits, out = plan.place[0], tools.row, job.limits, job.out
    maps = Maps(out.phase_rad[y], out.modulation[y], out.rejected[y])
    if plan.form[0] == 3:
        wrapped_row(_three(frames, i, y), limits, row, maps)
    elif plan.form[0] == 4:
        wrapped_row(_four(frames, i, y), limits, row, maps)
    elif plan.form[0] == 6:
        wrapped_row(_six(frames, i, y), limits, row, maps)
    else:
        wrapped_row(_summed(frames, y, plan, 0, job, tools.sums), limits, row, maps)


@njit(**options)
def _further(y: int, limits: Limits, tools: Tools, out: Any) -> None:
    """Write what else is wanted of row `y`."""
    row = tools.row
    if out.wrapped_rad.shape[0] > 0:
        wrap_row(row.turns, out.wrapped_rad[y])
    if out.background.shape[0] > 0:
        copy_row(row.background, out.background[y])
    if out.sigma_rad.shape[0] > 0:
        sigma_row(limits, row.background, out.modulation[y], out.phase_rad[y], out.sigma_rad[y])
    if out.residual.shape[0] > 0:
        residual_row(limits, row.squares, out.residual[y])
    if out.confidence.shape[0] > 0:
        confidence_row(limits, tools.state.margin, row.background, out.confidence[y])


@njit(**options)
def decode_rows(start: int, stop: int, frames: Any, plan: Any, job: Job) -> None:
    """Decode rows `start` to `stop` of `frames` (n, height, width) into the maps of `job`.

    Groups before the part's first one are in the job's state already, which then has all rows.
    """
    part, width = job.part, frames.shape[2]
    row = _new_row(width)
    scratch = new_state(1, width, job.out.confidence.shape[0] > 0)
    sums = new_sums(frames[0, :1], plan.normal[0])
    for y in range(start, stop):
        tools = Tools(state_at(job.state, y) if part.kept else state_at(scratch, 0), sums, row)
        if not part.absolute:
            _wrapped(frames, y, plan, job, tools)
            _further(y, job.limits, tools, job.out)
            continue
        if part.first == 0:
            begin_row(tools.state, plan.centre_turns)
        for g in range(part.first, part.last):
            if part.finishes and g == part.last - 1:
                _last(frames, y, plan, g, job, tools)
            else:
                _add(frames, y, plan, g, job, tools)
        if part.finishes:
            _further(y, job.limits, tools, job.out)
