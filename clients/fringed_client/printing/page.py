"""A page with a board on it: where everything stands.

Owns paper sizes, the scale bar and the text beside the marks; knows no file format. Page coordinates are mm from the
upper left corner, y down.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, field

import numpy as np

from fringed.boards import Board, diameters_mm, ink, points_mm, size_mm
from fringed.data import Float64Array
from fringed.errors import UsageError

PAPERS = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9), "tabloid": (431.8, 279.4)}
FIT = "fit"
EDGE_MM = 5.0  # printers leave it white
BARS_MM = (100.0, 50.0, 20.0, 10.0)
_QUIET_PITCHES = 0.25  # nothing else is printed so near to a mark
_GAP_MM = 1.0
_TEXT_MM, _LINE_MM, _CHARACTER = 2.0, 2.6, 0.56  # of text: size, line to line, width of a character over its size
_BAR_MM = 1.5
_NOTES_MM = 140.0  # wide enough for the longest bar and its text


@dataclass(frozen=True)
class Words:
    """A line of text; `x`, `y` are the left end of its base line."""

    x: float
    y: float
    size_mm: float
    text: str


@dataclass(frozen=True)
class Fill:
    """Areas of one grey, 0 black, 1 white: `discs` (m, 3) x, y, radius; `boxes` (k, 4) x0, y0, x1, y1; and text."""

    grey: float
    discs: Float64Array = field(default_factory=lambda: np.zeros((0, 3)))
    boxes: Float64Array = field(default_factory=lambda: np.zeros((0, 4)))
    words: tuple[Words, ...] = ()


@dataclass(frozen=True)
class Page:
    """What is printed: `fills` from below to above, on white paper. `bar_mm` is the scale bar's length, 0: no room."""

    width_mm: float
    height_mm: float
    fills: tuple[Fill, ...]
    title: str
    bar_mm: float = 0.0
    warnings: tuple[str, ...] = ()


def describe(board: Board) -> str:
    """Return the board in one line of ASCII."""
    parts = [f"{board.kind} {board.columns} x {board.rows}", f"pitch {board.pitch_mm:g} mm"]
    if board.has_circles:
        widths = sorted(set(np.round(diameters_mm(board), 6)))
        parts.append(f"circles {' and '.join(f'{width:g}' for width in widths)} mm")
    if board.kind == "charuco":
        parts.append(f"{board.dictionary}, markers {board.marker_mm or 0.75 * board.pitch_mm:g} mm")
    return ", ".join([*parts, board.polarity])


def page_of(board: Board, paper: str = FIT) -> Page:
    """Return the page with the board in its middle; `fit` makes a page of the board's size and a strip for notes.

    Marks are neither cut nor scaled: where they do not fit on the paper, the page is as for `fit`, with a warning.

    Raises
    ------
    UsageError
        a paper that is not known.
    ConfigurationError
        a ChArUco dictionary that does not exist, or is too small.
    """
    marks = ink(board)
    sheet = np.array(size_mm(board))
    extent, warnings = _extent(marks.discs, marks.boxes), list[str]()
    page = _page_mm(sheet, extent, paper)
    if page is None:
        warnings.append(_too_large(extent, paper))
        paper, page = FIT, _fitting(sheet)
    middle = np.array([page[0] / 2, sheet[1] / 2]) if paper == FIT else page / 2
    low, high = middle - sheet / 2, middle + sheet / 2
    dark = board.polarity == "dark-on-light"
    discs, boxes = marks.discs + np.array([*middle, 0.0]), marks.boxes + np.array([*middle, *middle])
    ground = np.array([[*np.maximum(low, 0.0), *np.minimum(high, page)]])
    fills = [] if dark else [Fill(0.0, boxes=ground)]
    fills.append(Fill(0.0 if dark else 1.0, discs, boxes))
    if (low < -1e-6).any():
        warnings.append(
            f"{paper} paper of {page[0]:g} x {page[1]:g} mm cuts the margin of the board of {sheet[0]:g} x "
            f"{sheet[1]:g} mm; all marks are on it"
        )
    bottom = float(max([*(discs[:, 1] + discs[:, 2]), *boxes[:, 3]]))
    notes = _notes(board, page, (low, high), bottom)
    if notes is None:
        warnings.append("there is no room for the scale bar and the board's data beside the marks; measure the marks")
    else:
        fills.append(notes)
    length = 0.0 if notes is None else float(np.ptp(notes.boxes[:, [0, 2]]))
    return Page(float(page[0]), float(page[1]), tuple(fills), describe(board), length, tuple(warnings))


def _extent(discs: Float64Array, boxes: Float64Array) -> Float64Array:
    """Return width and height of all marks together."""
    low = np.concatenate([discs[:, :2] - discs[:, 2:], boxes[:, :2]]).min(axis=0)
    high = np.concatenate([discs[:, :2] + discs[:, 2:], boxes[:, 2:]]).max(axis=0)
    return np.asarray(high - low)


def _page_mm(sheet: Float64Array, marks: Float64Array, paper: str) -> Float64Array | None:
    """Return the page's size, turned the way that the board fits; None where it does not."""
    if paper == FIT:
        return _fitting(sheet)
    if paper not in PAPERS:
        raise UsageError(f"{paper!r} is no paper that is known; take one of {', '.join([*PAPERS, FIT])}")
    wide = np.array(PAPERS[paper])
    for needed in (sheet, marks + 2 * EDGE_MM):
        for page in (wide, wide[::-1]) if sheet[0] >= sheet[1] else (wide[::-1], wide):
            if (needed <= page + 1e-6).all():
                return np.asarray(page)
    return None


def _fitting(sheet: Float64Array) -> Float64Array:
    return np.array([max(sheet[0], _NOTES_MM), sheet[1] + _strip_mm() + _GAP_MM + EDGE_MM])


def _too_large(marks: Float64Array, paper: str) -> str:
    usable = np.array(PAPERS[paper]) - 2 * EDGE_MM
    ratio = max(min(np.min(usable / marks), 1.0), min(np.min(usable[::-1] / marks), 1.0))
    return (
        f"marks of {marks[0]:g} x {marks[1]:g} mm do not fit on {paper} paper, of which {usable[0]:g} x "
        f"{usable[1]:g} mm can be printed on; the page is as large as the board instead. For {paper} paper take a "
        f"board of at most {np.floor(100 * ratio):.0f} % of this size"
    )


def _strip_mm() -> float:
    return _BAR_MM + 0.5 + 2 * _LINE_MM


def _notes(
    board: Board, page: Float64Array, sheet: tuple[Float64Array, Float64Array], marks_bottom: float
) -> Fill | None:
    """Return scale bar and text, below the sheet where there is room, else in its lower margin, else None."""
    low, high = sheet
    top, grey, ends = float(high[1]) + _GAP_MM, 0.0, (EDGE_MM, float(page[0]) - EDGE_MM)
    if top + _strip_mm() + EDGE_MM > page[1] + 1e-6:
        top = min(float(high[1]) - _GAP_MM, float(page[1]) - EDGE_MM) - _strip_mm()
        grey = 0.0 if board.polarity == "dark-on-light" else 1.0
        if top < marks_bottom + _QUIET_PITCHES * board.pitch_mm:
            return None
        ends = (max(float(low[0]), 0.0) + EDGE_MM, min(float(high[0]), float(page[0])) - EDGE_MM)
    left, right = ends
    length = next((bar for bar in BARS_MM if left + bar <= right), 0.0)
    if not length:
        return None
    blocks = np.arange(10) * length / 10
    upper = top + (np.arange(10) % 2) * (_BAR_MM / 2)
    boxes = np.column_stack([left + blocks, upper, left + blocks + length / 10, upper + _BAR_MM / 2])
    words = _told(board, length, (left, top, right))
    return None if words is None else Fill(grey, boxes=boxes, words=words)


def _told(board: Board, length: float, place: tuple[float, float, float]) -> tuple[Words, ...] | None:
    left, top, right = place
    reach = np.ptp(points_mm(board)[:, :2], axis=0)
    what = "circles" if board.has_circles else "inner corners"
    measure = f"measure this: {length:g} mm"
    more = f"fringed board: {describe(board)}. Print at 100 %, do not fit to the page."
    across = f"First to last of the {what}: {reach[0]:g} x {reach[1]:g} mm."
    beside = left + length + 2 * _GAP_MM
    room = int((right - left) / (_TEXT_MM * _CHARACTER))
    lines = textwrap.wrap(f"{more} {across}", max(room, 1))
    start = top + _BAR_MM + 0.5 + _TEXT_MM
    if beside + len(measure) * _TEXT_MM * _CHARACTER > right:
        lines = textwrap.wrap(f"{measure}. {more} {across}", max(room, 1))
        first: tuple[Words, ...] = ()
    else:
        first = (Words(beside, top + _BAR_MM, _TEXT_MM, measure),)
    if len(lines) > 2:
        lines = textwrap.wrap(measure if not first else describe(board), max(room, 1))
    if len(lines) > 2:
        return first or None
    return (*first, *(Words(left, start + k * _LINE_MM, _TEXT_MM, line) for k, line in enumerate(lines)))
