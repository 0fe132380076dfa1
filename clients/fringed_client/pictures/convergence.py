"""How registrations converged, iteration by iteration: error, pairs, limits and motion, several over each other.

Owns this chart; the figures are those of the registrations' own histories.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from fringed.data import Array, IterationRecord, Registration
from fringed_client.pictures.figures import APART, INK, figure, labelled, save, titled

_BANDS = ("#edede6", "#f8f8f5")
_GRID = "#d9d9d4"
_STYLES = ("-", "--", "-.", ":")


def draw_convergence(path: Path, registrations: Sequence[Registration], simulated: bool) -> Path:
    """Draw the iterations of each registration of a model, and how each one ended."""
    return draw_histories(
        path, {_ended(number, one): one.history for number, one in enumerate(registrations)}, simulated
    )


def _ended(number: int, found: Registration) -> str:
    end = "converged" if found.converged else "NOT converged"
    return (
        f"view {number + 2} → 1: {end}; at the end {found.overlap:.0%} overlap, "
        f"{found.rms_mm:.3g} mm RMS over all of it"
    )


def draw_histories(
    path: Path,
    histories: Mapping[str, Sequence[IterationRecord]],
    simulated: bool,
    title: str = "convergence of the registration",
) -> Path:
    """Draw histories by name over each other: RMS error, pairs, limit and alpha, rotation and translation.

    The stages of one history are shaded and named; those of several are named where they begin. On the logarithmic
    axes nothing is drawn for what is zero or without a limit.
    """
    columns = 2 if max([len(name) for name in histories] or [0]) > 40 else 4
    columns = min(columns, max(len(histories), 1))
    drawn = figure(10.4, 5.4 + 0.19 * -(-len(histories) // columns))
    grid = drawn.add_gridspec(4, 2, width_ratios=(1.35, 1))
    main = drawn.add_subplot(grid[:, 0])
    small = [drawn.add_subplot(grid[row, 1], sharex=main) for row in range(4)]
    for number, history in enumerate(histories.values()):
        _lines(main, small, history, number)
    _counted(small[0])
    for axes in (main, *small[1:]):
        _logarithmic(axes)
    together = list(histories.values())
    longest = max([len(history) for history in together] or [1])
    for axes in (main, *small):
        axes.grid(True, which="major", linewidth=0.4, color=_GRID)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlim(0.5, max(longest, 1) + 0.5)
        _bands(axes, together)
    _named(main, together)
    titled(main, title, simulated)
    labelled(main, "iteration", "RMS distance of the iteration's pairs / mm")
    alpha = any(record.alpha_mm > 0 for history in together for record in history)
    limit = "limit of the distance, alpha (dotted) / mm" if alpha else "limit of the distance / mm"
    names = ("pairs", limit, "rotation of the iteration / degrees", "translation of the iteration / mm")
    for axes, name in zip(small, names, strict=True):
        titled(axes, name, False)
        axes.set_title(name, loc="left", fontsize=9, color=INK, pad=4)
        axes.tick_params(labelbottom=axes is small[-1])
    labelled(small[-1], "iteration", "")
    _legend(drawn, list(histories), columns)
    return save(drawn, path)


def _lines(main: Any, small: Sequence[Any], history: Sequence[IterationRecord], number: int) -> None:
    at = np.arange(1, len(history) + 1)
    look: dict[str, Any] = {
        "color": _colour(number), "linewidth": 1.3, "marker": "o",
        "markersize": 3.0 if len(history) <= 40 else 1.6, "linestyle": _style(number),
    }  # fmt: skip
    main.plot(at, _positive([one.rms_mm for one in history]), **look)
    small[0].plot(at, [one.pairs for one in history], **look)
    small[1].plot(at, _positive([one.threshold_mm for one in history]), **look)
    small[1].plot(at, _positive([one.alpha_mm for one in history]), **look | {"linestyle": ":", "marker": "x"})
    small[2].plot(at, np.degrees(_positive([one.rotation_rad for one in history])), **look)
    small[3].plot(at, _positive([one.translation_mm for one in history]), **look)


def _positive(values: Sequence[float]) -> Array:
    """Return values for a logarithmic axis: NaN where there is nothing, or no end of it."""
    found = np.array(values, np.float64)
    return np.where(np.isfinite(found) & (found > 0), found, np.nan)


def _counted(axes: Any) -> None:
    most = max([float(np.max(line.get_ydata())) for line in axes.lines if len(line.get_ydata())] or [1.0])
    axes.set_ylim(0, 1.1 * max(most, 1.0))
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")


def _logarithmic(axes: Any) -> None:
    values = np.concatenate([np.asarray(line.get_ydata(), np.float64) for line in axes.lines] or [np.zeros(0)])
    values = values[np.isfinite(values)]
    if values.size:
        axes.set_yscale("log")
        subs = (1.0, 2.0, 5.0) if values.max() < 30 * values.min() else (1.0,)
        axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=6))
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())


def stages_of(history: Sequence[IterationRecord]) -> list[tuple[str, int, int]]:
    """Return the stages' names with their first and last iteration, counted from 1."""
    found, at = [], 1
    for name, group in groupby(record.stage for record in history):
        count = len(list(group))
        found.append((name, at, at + count - 1))
        at += count
    return found


def _named(axes: Any, histories: Sequence[Sequence[IterationRecord]]) -> None:
    """Name the stages: above the bands of a single history, beside the lines of several."""
    alone = len(histories) == 1
    for number, history in enumerate(histories):
        stages = stages_of(history)
        for name, first, last in stages if alone or len(stages) > 1 else []:
            rms = float(_positive([history[first - 1].rms_mm])[0])
            if alone:
                at, xycoords, offset = (0.5 * (first + last), 1.0), ("data", "axes fraction"), (0, -5)
                look = {"ha": "center", "va": "top", "fontsize": 8.5, "color": INK}
                axes.annotate(name, at, offset, xycoords=xycoords, textcoords="offset points", **look)
            elif np.isfinite(rms):
                axes.annotate(name, (first, rms), (4, 5), textcoords="offset points", fontsize=7.5,
                              color=_colour(number))  # fmt: skip


def _bands(axes: Any, histories: Sequence[Sequence[IterationRecord]]) -> None:
    if len(histories) == 1:
        for number, (_, first, last) in enumerate(stages_of(histories[0])):
            axes.axvspan(first - 0.5, last + 0.5, color=_BANDS[number % 2], linewidth=0, zorder=0)


def _legend(drawn: Any, names: Sequence[str], columns: int) -> None:
    marks = [
        Line2D([], [], color=_colour(i), linestyle=_style(i), marker="o", markersize=3, label=name)
        for i, name in enumerate(names)
    ]
    if marks:
        drawn.legend(handles=marks, loc="outside lower left", fontsize=8.5, frameon=False, labelcolor=INK,
                     ncols=columns)  # fmt: skip


def _colour(number: int) -> str:
    return APART[number % len(APART)]


def _style(number: int) -> Any:
    return _STYLES[number // len(APART) % len(_STYLES)]
