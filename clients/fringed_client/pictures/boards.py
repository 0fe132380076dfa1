"""A view of a calibration board, drawn: the points that were found, and why there are none.

Owns the picture of a `BoardView`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fringed.boards import board_of, is_big
from fringed.data import Array, BoardView
from fringed.errors import FringedError
from fringed_client.pictures.figures import ACCENT, INK, figure, save, titled

_FOUND, _UNLIT = "#3fa7d6", "#e3b23c"
_NUMBERED = 14


def draw_board_view(path: Path, view: BoardView) -> Path:
    """Draw the board as the camera saw it: points blue, the five large ones ringed, without light yellow."""
    drawn = figure(8.0, 6.4)
    axes = drawn.subplots()
    width, height = view.camera_size_px
    if view.picture is not None:
        rows, columns = (view.picture_step * length for length in view.picture.shape)
        axes.imshow(view.picture, cmap="gray", extent=(-0.5, columns - 0.5, rows - 0.5, -0.5), vmin=0, vmax=255)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    if len(view.index):
        _points(axes, view)
    name = view.name or "board"
    state = f"{len(view.index)} points" if view.found else "NOT FOUND"
    titled(axes, f"{name}: {state}", view.provenance.simulated)
    axes.set_xlabel("\n".join(_words(view)), fontsize=8.5, color=INK if view.found and not view.problems else ACCENT)
    return save(drawn, path)


def _points(axes: Any, view: BoardView) -> None:
    lit = np.isfinite(view.projector_px).all(axis=1)
    for chosen, colour in ((lit, _FOUND), (~lit, _UNLIT)):
        axes.plot(*view.camera_px[chosen].T, "+", color=colour, markersize=7, markeredgewidth=1.1)
    big = _big(view)
    axes.plot(*view.camera_px[big].T, "o", color=ACCENT, markersize=13, markerfacecolor="none", markeredgewidth=1.4)
    for k in range(0, len(view.index), max(1, len(view.index) // _NUMBERED)):
        axes.annotate(str(int(view.index[k])), view.camera_px[k], xytext=(4, 4), textcoords="offset points",
                      fontsize=7, color=_FOUND)  # fmt: skip


def _big(view: BoardView) -> Array:
    try:
        return np.asarray(is_big(board_of(view.board))[view.index])
    except (FringedError, IndexError):  # a board of a later release
        return np.zeros(len(view.index), bool)


def _words(view: BoardView) -> list[str]:
    """Return the lines below the picture: figures, then what is wrong."""
    units = {"tilt_deg": "tilt {:.0f} deg", "blur_px": "edges {:.2f} px", "diameter_px": "circles {:.0f} px wide",
             "coverage": "covers {:.0%}", "saturated": "saturated {:.1%}"}  # fmt: skip
    figures = [text.format(view.quality[key]) for key, text in units.items() if key in view.quality]
    lines = [", ".join(figures)] if figures else []
    return [*lines, *([view.reason] if view.reason else []), *view.problems]
