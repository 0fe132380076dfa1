"""Corners of chessboards and ChArUco boards in pictures whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from board_truth import Camera, Scene, spec_of

from fringed.boards import Board
from fringed_plugins.calibration.detect.detect import detect_board

CAMERA = Camera(480, 360, 1100.0)
CHESS = Board(kind="chessboard", columns=7, rows=4)
CHARUCO = Board(kind="charuco", columns=7, rows=5)
# Noise of 1.5 levels in 150 makes 0.006 px of a chessboard's windows, and 0.02 px where markers leave 3.5 px of them.
RMS_PX = {"chessboard": 0.015, "charuco": 0.03}


def found(scene):
    got = detect_board(scene.picture(), spec_of(scene.board), threads=1)
    assert got.found, got.reason
    return got


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=lambda board: board.kind)
@pytest.mark.parametrize(("turn", "tilt", "polarity"), [(10, 30, "dark-on-light"), (95, 30, "light-on-dark")])
def test_corners_are_true_and_their_deviations_honest(board, turn, tilt, polarity):
    board = Board(kind=board.kind, columns=board.columns, rows=board.rows, polarity=polarity)
    scene = Scene(board, CAMERA, turn_deg=turn, tilt_deg=tilt, fill=0.85, noise=1.5, slope=(0.3, 0.2))
    got = found(scene)
    assert len(got.index) == board.columns * board.rows
    off = got.px - scene.seen(got.index)
    assert np.sqrt(np.mean(off**2)) < RMS_PX[board.kind]
    # Some 60 squared normal values: 1 within 0.18 of a deviation; the truth's own blur adds a little.
    assert 0.4 < np.mean(off**2 / got.sigma_px[:, None] ** 2) < 1.6
    assert got.quality["tilt_deg"] == pytest.approx(tilt, abs=3)
    assert got.quality["blur_px"] == pytest.approx(0.7, abs=0.05)


@pytest.mark.parametrize("turn", [0, 180, 170])
def test_chessboard_whose_turns_differ_in_colour_is_numbered_right(turn):
    scene = Scene(CHESS, CAMERA, turn_deg=turn)
    assert np.abs(found(scene).px - scene.seen(np.arange(28))).max() < 0.05


def test_part_of_a_charuco_board_is_enough_and_of_a_chessboard_it_is_not():
    scene = Scene(CHARUCO, CAMERA, fill=1.3, shift=(0.15, 0.0), tilt_deg=20, turn_deg=5)
    got = found(scene)
    assert 12 <= len(got.index) < 35
    assert np.abs(got.px - scene.seen(got.index)).max() < 0.05
    assert got.problems[0].startswith("cut by an edge of the picture")
    cut = detect_board(found_less(CHESS), spec_of(CHESS), threads=1)
    assert not cut.found
    assert "has to be seen whole" in cut.reason


def found_less(board):
    return Scene(board, CAMERA, fill=1.5).picture()
