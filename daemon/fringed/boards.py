"""Calibration boards: what is printed on them, and where their points are.

Owns the boards' geometry, for whoever prints, simulates or detects one. A board's frame: millimetres, the origin in
the middle of the sheet, x to the right, y down, z into the board; a board that faces the camera upright has the
camera's axes. Points are numbered row by row from the upper left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from fringed.data import Float64Array
from fringed.errors import ConfigurationError, Problem

BoardKind = Literal["circles-five", "circles", "asymmetric-circles", "chessboard", "charuco"]
CIRCLES: tuple[BoardKind, ...] = ("circles-five", "circles", "asymmetric-circles")
# Columns and rows from the middle circle: no turn of it is itself, and its mirror image is no turn of it.
FIVE = ((0, 0), (-2, 0), (2, 0), (0, 2), (2, -2))
_MM = {"units": "mm"}
Count = Annotated[int, Meta(ge=3, le=200, description="points along one side")]


class Board(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A flat board with a grid of points: centres of circles, or inner corners of a chessboard.

    `asymmetric-circles` has every second row shifted by half of `pitch_mm`, the distance of two circles of one row;
    rows are half of it apart.
    """

    kind: Annotated[BoardKind, Meta(description="what is printed")] = "circles-five"
    columns: Count = 13
    rows: Count = 9
    pitch_mm: Annotated[
        float, Meta(gt=0.01, le=1e4, description="between two points of a row", extra_json_schema=_MM)
    ] = 20.0
    diameter_mm: Annotated[
        float, Meta(ge=0, le=1e4, description="of a circle; 0: 0.45 pitches", extra_json_schema=_MM)
    ] = 0.0
    big_diameter_mm: Annotated[
        float, Meta(ge=0, le=1e4, description="of the five large circles; 0: 0.7 pitches", extra_json_schema=_MM)
    ] = 0.0
    marker_mm: Annotated[
        float, Meta(ge=0, le=1e4, description="side of a ChArUco marker; 0: 0.75 pitches", extra_json_schema=_MM)
    ] = 0.0
    margin_mm: Annotated[
        float,
        Meta(
            ge=0,
            le=1e4,
            description="from the outer points to the edge; 0: a pitch, 1.5 with squares",
            extra_json_schema=_MM,
        ),
    ] = 0.0
    polarity: Annotated[Literal["dark-on-light", "light-on-dark"], Meta(description="the marks on the ground")] = (
        "dark-on-light"
    )
    dictionary: Annotated[str, Meta(description="OpenCV's name of the ChArUco markers")] = "DICT_5X5_250"

    def __post_init__(self) -> None:
        problem = _contradiction(self)
        if problem:
            raise ValueError(problem)

    @property
    def has_circles(self) -> bool:
        """Whether its points are centres of circles."""
        return self.kind in CIRCLES


@dataclass(frozen=True)
class Ink:
    """What is printed, in the board's frame (mm): `discs` (m, 3) x, y, radius, and `boxes` (k, 4) x0, y0, x1, y1."""

    discs: Float64Array
    boxes: Float64Array


def board_of(table: Mapping[str, Any]) -> Board:
    """Return the board that a table describes; raises ConfigurationError with every key that is wrong."""
    try:
        return msgspec.convert(dict(table), Board)
    except msgspec.ValidationError as error:
        problem = Problem("board", str(dict(table))[:120], str(error))
        raise ConfigurationError("1 problem:", (problem,)) from error


def _contradiction(board: Board) -> str:
    if board.kind == "circles-five" and min(board.columns, board.rows) < 5:
        return f"a board of {board.columns} x {board.rows} circles has no room for the five large ones; it needs 5 x 5"
    if board.has_circles:
        small, big = _diameters(board)
        near = board.pitch_mm / (2**0.5 if board.kind == "asymmetric-circles" else 1)
        largest = big if board.kind == "circles-five" else small
        if largest >= 0.95 * near:
            return (
                f"circles of {largest:g} mm touch at distances of {near:g} mm; they have to be below {0.95 * near:g} mm"
            )
        if board.kind == "circles-five" and big < 1.25 * small:
            return (
                f"the large circles ({big:g} mm) are hardly larger than the others ({small:g} mm); at least 1.25 times"
            )
    elif board.kind == "charuco" and _marker(board) >= board.pitch_mm:
        return f"markers of {_marker(board):g} mm do not fit into squares of {board.pitch_mm:g} mm"
    return ""


def _diameters(board: Board) -> tuple[float, float]:
    return board.diameter_mm or 0.45 * board.pitch_mm, board.big_diameter_mm or 0.7 * board.pitch_mm


def _marker(board: Board) -> float:
    return board.marker_mm or 0.75 * board.pitch_mm


def grid(board: Board) -> np.ndarray[Any, np.dtype[np.int32]]:
    """Return column and row of each point, (n, 2) int32."""
    rows, columns = np.divmod(np.arange(board.columns * board.rows, dtype=np.int32), np.int32(board.columns))
    return np.stack([columns, rows], axis=-1).astype(np.int32)


def points_mm(board: Board) -> Float64Array:
    """Return the points (n, 3) in the board's frame, z = 0."""
    place = grid(board).astype(np.float64)
    if board.kind == "asymmetric-circles":
        place = np.stack([place[:, 0] + 0.5 * (place[:, 1] % 2), 0.5 * place[:, 1]], axis=-1)
    place -= (place.min(axis=0) + place.max(axis=0)) / 2
    return np.concatenate([place * board.pitch_mm, np.zeros((len(place), 1))], axis=1)


def is_big(board: Board) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which points (n,) are the five large circles."""
    found = np.zeros(board.columns * board.rows, bool)
    if board.kind == "circles-five":
        for column, row in FIVE:
            found[(board.rows // 2 + row) * board.columns + board.columns // 2 + column] = True
    return found


def diameters_mm(board: Board) -> Float64Array:
    """Return each circle's diameter (n,); 0 for corners."""
    if not board.has_circles:
        return np.zeros(board.columns * board.rows)
    small, big = _diameters(board)
    return np.where(is_big(board), big, small)


def size_mm(board: Board) -> tuple[float, float]:
    """Return width and height of the sheet."""
    margin = board.margin_mm or board.pitch_mm * (1.0 if board.has_circles else 1.5)
    low, high = points_mm(board).min(axis=0), points_mm(board).max(axis=0)
    return float(high[0] - low[0] + 2 * margin), float(high[1] - low[1] + 2 * margin)


def ink(board: Board) -> Ink:
    """Return the marks; they are dark or light by the board's polarity."""
    points = points_mm(board)
    if board.has_circles:
        discs = np.column_stack([points[:, :2], diameters_mm(board) / 2])
        return Ink(discs, np.zeros((0, 4)))
    return Ink(np.zeros((0, 3)), _squares(board) if board.kind == "chessboard" else _charuco(board))


def _corner_mm(board: Board) -> Float64Array:
    """Return the upper left corner of the chessboard's squares."""
    return points_mm(board)[0, :2] - board.pitch_mm


def _squares(board: Board) -> Float64Array:
    origin, side = _corner_mm(board), board.pitch_mm
    low = [
        (column, row) for row in range(board.rows + 1) for column in range(board.columns + 1) if (row + column) % 2 == 0
    ]
    corners = origin + side * np.array(low, np.float64)
    return np.concatenate([corners, corners + side], axis=1)


def charuco(board: Board) -> Any:
    """Return OpenCV's own description of a ChArUco board; its frame begins at the upper left corner of the squares.

    Raises
    ------
    ConfigurationError
        a dictionary that OpenCV does not know, or has too few markers.
    """
    import cv2

    number = getattr(cv2.aruco, board.dictionary, None)
    squares = (board.columns + 1, board.rows + 1)
    wanted = squares[0] * squares[1] // 2
    if not board.dictionary.startswith("DICT_") or not isinstance(number, int):
        names = ", ".join(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        raise ConfigurationError("1 problem:", (Problem("board.dictionary", repr(board.dictionary), names),))
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    if len(dictionary.bytesList) < wanted:
        allowed = f"a dictionary of {wanted} markers or more; this one has {len(dictionary.bytesList)}"
        raise ConfigurationError("1 problem:", (Problem("board.dictionary", repr(board.dictionary), allowed),))
    return cv2.aruco.CharucoBoard(squares, float(board.pitch_mm), float(_marker(board)), dictionary)


def _charuco(board: Board) -> Float64Array:
    import cv2

    made, boxes = charuco(board), list(_squares(board))
    dictionary = made.getDictionary()
    cells = dictionary.markerSize + 2
    for number, corners in zip(made.getIds().ravel(), made.getObjPoints(), strict=True):
        bits = cv2.aruco.generateImageMarker(dictionary, int(number), cells)
        low = _corner_mm(board) + np.asarray(corners, np.float64)[:, :2].min(axis=0)
        step = _marker(board) / cells
        for row, column in np.argwhere(bits == 0):
            at = low + step * np.array([column, row])
            boxes.append(np.concatenate([at, at + step]))
    return np.array(boxes)
