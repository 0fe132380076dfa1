"""Printed boards: the files, read back by the formats' definitions, hold every mark at its millimetre."""

from __future__ import annotations

import json
import tomllib
from typing import get_args

import msgspec
import numpy as np
import pytest
from board_files import bezier, picture, read_pdf, read_svg

from fringed.boards import Board, BoardKind, diameters_mm, ink, is_big, points_mm, size_mm
from fringed.errors import UsageError
from fringed_client.cli.board import KINDS, PAPERS, POLARITIES
from fringed_client.cli.main import run
from fringed_client.printing import page as pages
from fringed_client.printing.page import page_of
from fringed_client.printing.pdf import pdf_of
from fringed_client.printing.svg import svg_of

WRITERS = {"pdf": (pdf_of, read_pdf), "svg": (svg_of, read_svg)}
BOARDS = {
    "circles-five": Board(),
    "circles": Board(kind="circles", columns=7, rows=11, pitch_mm=12.345),
    "asymmetric-circles": Board(kind="asymmetric-circles", columns=5, rows=11, pitch_mm=30.0),
    "chessboard": Board(kind="chessboard", columns=8, rows=6, pitch_mm=20.0),
    "charuco": Board(kind="charuco", columns=9, rows=6, pitch_mm=20.0),
}


def circle_of(area):
    """Return x, y and radius of an outline; fails where it is no circle."""
    if area.kind == "circle":
        return area.points[0]
    on = bezier(area.points)
    centre = on.mean(axis=0)
    radius = np.linalg.norm(on - centre, axis=1)
    assert np.ptp(radius) < 3e-4  # four decimals of a millimetre
    return np.array([*centre, radius.mean()])


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("kind", ["circles-five", "circles", "asymmetric-circles"])
def test_circles_are_circles_of_their_size_at_their_place(kind, suffix):
    write, read = WRITERS[suffix]
    board = BOARDS[kind]
    drawing = read(write(page_of(board, "fit")))
    found = np.array([circle_of(area) for area in drawing.areas if area.kind != "box"])
    wanted = ink(board).discs + np.array([drawing.size[0] / 2, size_mm(board)[1] / 2, 0.0])
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < 3e-4
    assert all(area.grey == 0 for area in drawing.areas)


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("kind", ["chessboard", "charuco"])
def test_boxes_are_where_the_board_has_ink(kind, suffix):
    write, read = WRITERS[suffix]
    board = BOARDS[kind]
    drawing = read(write(page_of(board, "a4")))
    wanted = ink(board).boxes + np.tile(np.array(drawing.size) / 2, 2)
    areas = [area.points for area in drawing.areas[: len(wanted)]]
    found = np.array([[*corners.min(axis=0), *corners.max(axis=0)] for corners in areas])
    assert np.abs(found - wanted).max() < 3e-4


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("paper", ["a4", "letter", "fit"])
def test_page_has_the_papers_size_and_a_bar_of_exactly_100_mm(paper, suffix):
    write, read = WRITERS[suffix]
    drawing = read(write(page_of(Board(), paper)))
    wanted = pages.PAPERS.get(paper, (280.0, drawing.size[1]))
    assert drawing.size == pytest.approx(wanted, abs=1e-4)
    bar = np.concatenate([area.points for area in drawing.areas if area.kind == "box"])
    assert np.ptp(bar[:, 0]) == pytest.approx(100.0, abs=2e-4)
    assert any("measure this: 100 mm" in text for text, *_ in drawing.texts)
    told = " ".join(text for text, *_ in drawing.texts)
    assert "13 x 9" in told and "pitch 20 mm" in told and "240 x 160 mm" in told
    marks = [circle_of(area) for area in drawing.areas if area.kind != "box"]
    lowest = max(y + radius for _, y, radius in marks)
    assert min(y - size for _, _, y, size, _ in drawing.texts) > lowest + 4
    assert bar[:, 1].min() > lowest + 4 and bar[:, 1].max() < drawing.size[1] - 4


def test_pdf_asks_viewers_not_to_scale_it():
    assert b"/PrintScaling /None" in pdf_of(page_of(Board()))


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("board", [
    BOARDS["circles-five"], msgspec.structs.replace(BOARDS["circles-five"], polarity="light-on-dark"),
])  # fmt: skip
def test_printed_circles_are_found_upright_beside_the_text(board, suffix):
    from fringed_plugins.calibration.detect.board_spec import BoardSpec
    from fringed_plugins.calibration.detect.detect import detect_board

    write, read = WRITERS[suffix]
    scale = 4.0
    drawing = read(write(page_of(board, "a4")))
    spec = BoardSpec(
        board.kind, board.columns, board.rows, board.pitch_mm, points_mm(board), diameters_mm(board), is_big(board),
        board.polarity == "dark-on-light",
    )  # fmt: skip
    found = detect_board(picture(drawing, scale), spec)
    assert found.found and len(found.index) == 117, found.reason
    # Text stands in the lower margin; what was drawn by another renderer is found at its millimetre.
    wanted = (points_mm(board)[found.index, :2] + np.array(drawing.size) / 2) * scale - 0.5
    assert np.abs(found.px - wanted).max() < 0.08


@pytest.mark.parametrize("polarity", POLARITIES)
def test_printed_charuco_is_found_by_opencv(polarity):
    import cv2

    from fringed.boards import charuco

    board = msgspec.structs.replace(BOARDS["charuco"], polarity=polarity)
    drawing = read_pdf(pdf_of(page_of(board, "a4")))
    shown = picture(drawing, 4.0)
    shown = shown if polarity == "dark-on-light" else 255 - shown
    corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco(board)).detectBoard(shown)
    wanted = (points_mm(board)[ids.ravel(), :2] + np.array(drawing.size) / 2) * 4.0 - 0.5
    assert len(ids) == 54 and np.abs(corners.reshape(-1, 2) - wanted).max() < 0.3


@pytest.mark.parametrize("kind", ["circles", "asymmetric-circles", "chessboard"])
def test_printed_grids_are_found_by_opencv(kind):
    import cv2

    board = BOARDS[kind]
    drawing = read_pdf(pdf_of(page_of(board, "fit")))
    shown, size = picture(drawing, 4.0), (board.columns, board.rows)
    if kind == "chessboard":
        done, found = cv2.findChessboardCornersSB(shown, size)
    else:
        flag = cv2.CALIB_CB_ASYMMETRIC_GRID if kind == "asymmetric-circles" else cv2.CALIB_CB_SYMMETRIC_GRID
        settings = cv2.SimpleBlobDetector_Params()
        settings.maxArea = 1e5
        done, found = cv2.findCirclesGrid(shown, size, flags=flag, blobDetector=cv2.SimpleBlobDetector_create(settings))
    assert done
    wanted = (points_mm(board)[:, :2] + [drawing.size[0] / 2, size_mm(board)[1] / 2]) * 4.0 - 0.5
    # A board of this symmetry may be counted from another corner: each point is somebody's, and each has one.
    apart = np.linalg.norm(found.reshape(-1, 1, 2) - wanted, axis=-1)
    assert apart.min(axis=1).max() < 0.3 and len(set(apart.argmin(axis=1))) == len(wanted)


def test_boards_turn_the_paper_and_say_what_does_not_fit():
    tall = page_of(BOARDS["circles"], "a4")
    assert (tall.width_mm, tall.height_mm) == (210.0, 297.0)
    cut = page_of(Board(kind="chessboard", columns=8, rows=5, pitch_mm=30.0), "a4")
    assert len(cut.warnings) == 2 and "cuts the margin" in cut.warnings[0] and cut.bar_mm == 0
    with pytest.raises(UsageError, match=r"'b5' is no paper .* a4, a3, letter, tabloid, fit"):
        page_of(Board(), "b5")
    with pytest.raises(UsageError, match=r"larger than PDF's 5080 mm; write \.svg"):
        pdf_of(page_of(Board(pitch_mm=500.0)))
    assert read_svg(svg_of(page_of(Board(pitch_mm=500.0)))).size[0] == 7000


def test_board_that_is_larger_than_the_paper_is_whole_and_warned_of(tmp_path, capsys):
    path, board = tmp_path / "board.svg", Board(pitch_mm=30.0)
    assert run(["board", "--pitch", "30", "--output", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    (warning,) = told["warnings"]
    assert "do not fit on a4 paper" in warning and "at most 76 % of this size" in warning
    drawing = read_svg(path.read_bytes())
    assert drawing.size == pytest.approx(told["page_mm"], abs=1e-4) and drawing.size[0] == size_mm(board)[0]
    found = np.array([circle_of(area) for area in drawing.areas if area.kind != "box"])
    wanted = ink(board).discs + np.array([drawing.size[0] / 2, size_mm(board)[1] / 2, 0.0])
    assert np.abs(found - wanted).max() < 3e-4


def test_small_boards_have_a_whole_scale_bar_too():
    page = page_of(Board(kind="circles", columns=3, rows=3, pitch_mm=5.0))
    assert page.bar_mm == 100 and not page.warnings
    assert max(one.x + len(one.text) for fill in page.fills for one in fill.words) < page.width_mm


def test_command_writes_and_tells(tmp_path, capsys):
    path = tmp_path / "board.pdf"
    assert run(["board", "--pitch", "10", "--output", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["board"]["pitch_mm"] == 10 and told["files"] == [str(path)] and told["bar_mm"] == 100
    assert read_pdf(path.read_bytes()).size == pytest.approx((297, 210), abs=1e-4)


def test_command_prints_a_table_for_a_configuration(capsys):
    from fringed.boards import board_of

    assert run(["board", "--toml", "--kind", "charuco", "--rows", "6", "--marker", "14.5", "--pitch", "19.97"]) == 0
    table = tomllib.loads(capsys.readouterr().out)["board"]
    assert board_of(table) == Board(kind="charuco", rows=6, marker_mm=14.5, pitch_mm=19.97)
    assert {"kind", "columns", "rows", "pitch_mm"} <= set(table)


@pytest.mark.parametrize(("args", "told"), [
    (["--columns", "4"], "no room for the five"), (["--output", "board.png"], ".pdf or .svg"),
    (["--toml", "--json"], "take one of them"),
    (["--kind", "charuco", "--dictionary", "DICT_9X9"], "DICT_4X4_50"),
])  # fmt: skip
def test_command_refuses_what_cannot_be(args, told, capsys):
    assert run(["board", *args]) == 2
    shown = capsys.readouterr()
    assert told in shown.err + shown.out


def test_choices_are_the_contracts():
    assert get_args(BoardKind) == KINDS and (*pages.PAPERS, pages.FIT) == PAPERS
    assert all(Board(polarity=polarity) for polarity in POLARITIES)
