"""A verification: the traffic light with its figures, the deviations over the artefact, and how they are distributed.

Owns how they are shown; the deviations come from `fringed_client.verification`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Ellipse

from fringed.data import Array, RangeImage, Verification
from fringed_client.pictures.figures import (
    FAINT,
    INK,
    PAPER,
    colour_bar,
    figure,
    labelled,
    limits,
    save,
    thinned,
    titled,
)
from fringed_client.verification import COLOURS, WORDS, deviations_mm, rows

_BARS = "#7f9fb5"
_SIDE_PX = 7
_COLUMNS = ("figure / mm", "measured", "std. unc.", "limit", "")


def draw_verification(path: Path, found: Verification, image: RangeImage | None = None) -> Path:
    """Draw the light and the figures, and with the range image the deviations as a map and a histogram."""
    simulated = found.provenance.simulated
    table = 0.9 + 0.27 * len(found.limits)
    if image is None:
        drawn = figure(8.4, table + 0.4)
        _head(drawn.add_subplot(), found, simulated)
        return save(drawn, path)
    away = deviations_mm(found, image)
    height, width = _window(away).shape
    map_in = float(np.clip(6.4 * height / width, 2.4, 6.0))
    drawn = figure(10.2, map_in + table + 0.8)
    head, below = drawn.subplots(2, 1, height_ratios=(table, map_in + 0.4))
    below.remove()
    _head(head, found, simulated)
    grid = below.get_subplotspec().subgridspec(1, 2, width_ratios=(2.4, 1))
    _map(drawn, drawn.add_subplot(grid[0]), away, int(found.provenance.parameters.get("smooth_px") or _SIDE_PX))
    _histogram(drawn.add_subplot(grid[1]), away[np.isfinite(away)])
    return save(drawn, path)


def _head(axes: Any, found: Verification, simulated: bool) -> None:
    """Draw the traffic light, the sentence and the table."""
    near, far = found.depth_mm
    told = f"calibration {found.calibration or 'unknown'} {WORDS[found.verdict]}: {found.artefact}"
    told += f", {near:.0f} to {far:.0f} mm"
    if found.temperature_c is not None:
        told += f", {found.temperature_c:g} °C"
    titled(axes, told, simulated)
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    box = axes.get_window_extent().transformed(axes.figure.dpi_scale_trans.inverted())
    tall = 0.11 * max(box.width / max(box.height, 0.1), 0.5) * 0.3
    for number, name in enumerate(("red", "yellow", "green")):
        lit = found.verdict == name
        colour = COLOURS[name] if lit else "#e3e2dc"
        axes.add_patch(
            Ellipse((0.03 + 0.045 * number, 0.6), 0.033, min(tall, 0.6), facecolor=colour, edgecolor=FAINT, lw=0.6)
        )
    lines = rows(found)
    made = axes.table(
        cellText=[[*row[:4], WORDS[row[4]]] for row in lines], colLabels=_COLUMNS, bbox=(0.17, 0.0, 0.83, 0.95),
        colWidths=(0.36, 0.16, 0.14, 0.14, 0.2), cellLoc="right", colLoc="right", edges="horizontal",
    )  # fmt: skip
    made.auto_set_font_size(False)
    made.set_fontsize(8.5)
    for (row, column), cell in made.get_celld().items():
        cell.set_edgecolor("#d9d9d4")
        cell.get_text().set_color(FAINT if row == 0 else INK)
        if column == 0:
            cell.set_text_props(ha="left")
        if column == 4 and row:
            cell.get_text().set_color(COLOURS[lines[row - 1][4]])
            cell.get_text().set_fontweight("bold")


def _window(away: Array) -> Array:
    """Return the part of the picture that the artefact fills, with a margin."""
    low, high = _bounds(away)
    return away[low[0] : high[0], low[1] : high[1]]


def _bounds(away: Array) -> tuple[Array, Array]:
    known = np.argwhere(np.isfinite(away))
    if not len(known):
        return np.array([0, 0]), np.array(away.shape)
    low, high = known.min(axis=0), known.max(axis=0) + 1
    margin = int(0.04 * (high - low).max()) + 1
    return np.maximum(low - margin, 0), np.minimum(high + margin, away.shape)


def _map(drawn: Any, axes: Any, away: Array, side: int) -> None:
    """Draw means over squares: single points are mostly noise, which hides the form."""
    low, high = _bounds(away)
    shown = _means(away[low[0] : high[0], low[1] : high[1]] * 1000, side)
    top = max(abs(value) for value in limits(shown, 1, 99))
    axes.set_facecolor(PAPER)
    right, bottom = low[1] + shown.shape[1] * side, low[0] + shown.shape[0] * side
    image = axes.imshow(
        thinned(shown), cmap="RdBu_r", vmin=-top, vmax=top, interpolation="nearest",
        extent=(low[1] - 0.5, right - 0.5, bottom - 0.5, low[0] - 0.5),
    )  # fmt: skip
    titled(axes, f"deviations, means of {side} x {side} px", False)
    labelled(axes, "column / px", "row / px")
    colour_bar(drawn, image, axes, "deviation, outwards positive / µm", "both")


def _means(values: Array, side: int) -> Array:
    """Return means of squares of which half or more is known."""
    height, width = (-(-length // side) for length in values.shape)
    whole = np.full((height * side, width * side), np.nan)
    whole[: values.shape[0], : values.shape[1]] = values
    squares = whole.reshape(height, side, width, side)
    known = np.isfinite(squares)
    count = known.sum(axis=(1, 3))
    total = np.where(known, squares, 0.0).sum(axis=(1, 3))
    found: Array = np.where(2 * count >= side * side, total / np.maximum(count, 1), np.nan)
    return found


def _histogram(axes: Any, away: Array) -> None:
    values = away * 1000
    top = max(abs(value) for value in limits(values, 0.1, 99.9))
    axes.hist(values, np.linspace(-top, top, 81), color=_BARS)
    axes.axvline(0, color=FAINT, linewidth=0.6)
    axes.set_yticks([])
    rms = float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
    titled(axes, f"{rms:.0f} µm RMS, {len(values):,} points", False)
    labelled(axes, "deviation / µm", "")
