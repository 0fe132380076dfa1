"""A calibration board: a flat sheet with its print.

Owns the sheet and the albedo of its marks; where they are is `fringed.boards`'.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from msgspec import Meta

from fringed.boards import Board, board_of, ink, size_mm
from fringed.config.validation import validate
from fringed.data import Float64Array
from fringed.simulation.shapes.shape import Print, Shape, ShapeOptions, mesh_shape

# Board points to the object's frame: a board's y runs down and its z into the sheet.
T_OBJECT_BOARD: Float64Array = np.diag([1.0, -1.0, -1.0, 1.0])
_CELL_PITCHES = 0.5  # side of a cell of the index of marks


class BoardOptions(ShapeOptions, frozen=True, kw_only=True):
    """What makes the sheet differ from the board that is meant; the board's own keys stand beside these."""

    ink_albedo: Annotated[float, Meta(ge=0, le=1, description="of the dark, over the paper's")] = 0.08
    scale_x: Annotated[float, Meta(ge=0.5, le=2, description="the print is stretched along x by this")] = 1.0


def board_options(table: dict[str, object]) -> tuple[Board, BoardOptions]:
    """Return the board and the sheet that a scene's options describe; raises ConfigurationError."""
    own = set(BoardOptions.__struct_fields__)
    sheet = validate({k: v for k, v in table.items() if k in own}, BoardOptions, "simulation.scene.options")
    return board_of({k: v for k, v in table.items() if k not in own}), sheet


def board(options: tuple[Board, BoardOptions]) -> Shape:
    """Return the sheet, upright and facing the camera when it is not turned.

    Its pose in a board's own axes is `Truth.T_camera_object @ T_OBJECT_BOARD`.
    """
    printed, sheet = options
    width, height = size_mm(printed)
    x, y = width * sheet.scale_x / 2, height / 2
    plane = mesh_shape([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], [[0, 1, 2], [0, 2, 3]])
    return replace(plane, printed=_print(printed, sheet))


def _print(board: Board, sheet: BoardOptions) -> Print:
    marks = ink(board)
    ground, mark = (1.0, sheet.ink_albedo) if board.polarity == "dark-on-light" else (sheet.ink_albedo, 1.0)
    low = np.array([-size_mm(board)[0], -size_mm(board)[1]]) / 2
    cell = max(_CELL_PITCHES * board.pitch_mm, 1e-6)
    shape = (int(np.ceil(-2 * low[1] / cell)) + 1, int(np.ceil(-2 * low[0] / cell)) + 1)
    discs = np.column_stack([marks.discs[:, :2] - marks.discs[:, 2:], marks.discs[:, :2] + marks.discs[:, 2:]])
    index = [_filed(boxes, low, cell, shape) for boxes in (discs, marks.boxes)]
    return Print(
        marks.discs, marks.boxes, (ground, mark), sheet.scale_x, np.array([*low, cell]), shape,
        (index[0][0], index[1][0]), (index[0][1], index[1][1]),
    )  # fmt: skip


def _filed(
    boxes: Float64Array, low: Float64Array, cell: float, shape: tuple[int, int]
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Return starts and items: which marks may reach into each cell, and into a neighbour's edge."""
    margin = 0.25 * cell
    filed: list[list[int]] = [[] for _ in range(shape[0] * shape[1])]
    first = np.floor((boxes[:, :2] - low - margin) / cell).astype(int)
    last = np.floor((boxes[:, 2:] - low + margin) / cell).astype(int)
    for number, ((x0, y0), (x1, y1)) in enumerate(zip(first, last, strict=True)):
        for row in range(max(y0, 0), min(y1, shape[0] - 1) + 1):
            for column in range(max(x0, 0), min(x1, shape[1] - 1) + 1):
                filed[row * shape[1] + column].append(number)
    starts = np.concatenate([[0], np.cumsum([len(items) for items in filed])]).astype(np.int64)
    return starts, np.array([item for items in filed for item in items], np.int64)
