"""Pictures in which no board can be used: each says why, with figures, and quickly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_truth import Camera, Scene, spec_of
from scipy.ndimage import gaussian_filter

from fringed.boards import Board
from fringed_plugins.calibration.detect.detect import detect_board

BOARD = Board(columns=9, rows=7)
SPEC = spec_of(BOARD)
CAMERA = Camera(480, 360, 1100.0)
RNG = np.random.default_rng(5)


def refused(picture, spec=SPEC, **changes):
    got = detect_board(picture, spec, threads=1, **changes)
    assert not got.found
    assert got.reason
    return got.reason


@pytest.fixture(scope="module")
def upright():
    return Scene(BOARD, CAMERA, turn_deg=10, noise=1.0).picture()


@pytest.mark.parametrize(
    "board",
    [BOARD, Board(kind="asymmetric-circles", columns=4, rows=10), Board(kind="charuco", columns=7, rows=5)],
    ids=lambda board: board.kind,
)
@pytest.mark.parametrize("axis", [0, 1])
def test_mirrored_board_is_refused_as_such(board, axis):
    picture = Scene(board, CAMERA, turn_deg=15, noise=1.0).picture()
    assert "mirrored" in refused(np.flip(picture, axis), spec_of(board))


def test_other_polarity_is_named():
    picture = Scene(Board(columns=9, rows=7, polarity="light-on-dark"), CAMERA, noise=1.0).picture()
    assert "63 light circles" in refused(picture)
    assert "polarity" in refused(picture)


def test_small_circles_alone_are_not_the_configured_board(upright):
    symmetric = Scene(Board(kind="circles", columns=9, rows=7), CAMERA, noise=1.0).picture()
    assert "0 large circles among 63" in refused(symmetric)
    assert "of 63 circles" in refused(symmetric[:, :330], spec_of(Board(kind="circles", columns=9, rows=7)))


def test_board_with_other_counts_is_refused(upright):
    # The five fit, and the circles around them do not: the board is larger than the one that is meant.
    assert "the board has to be the one that is configured" in refused(upright, spec_of(Board(columns=7, rows=5)))


def test_view_without_enough_of_the_five_says_how_many():
    scene = Scene(BOARD, CAMERA, fill=1.6, shift=(0.55, 0.1), noise=1.0)
    reason = refused(scene.picture())
    assert "large circles among" in reason
    assert "at least 4" in reason


def test_dark_and_noisy_pictures_say_their_levels():
    reason = refused(Scene(BOARD, CAMERA, light=3.0, noise=1.0).picture())
    assert reason.startswith("too dark")
    assert "noise of 1" in reason


def test_low_contrast_is_told(upright):
    got = detect_board(150 + 0.2 * upright, SPEC, threads=1)
    assert got.found
    assert got.problems == ("low contrast: 9% of marks and ground, at least 15%",)
    assert refused(150 + 0.2 * gaussian_filter(upright, 25)).startswith("low contrast: grey levels from 1")


def test_blur_that_hides_the_circles_is_told_in_pixels(upright):
    reason = refused(gaussian_filter(upright, 25))
    assert reason.startswith("blurred")
    assert "at most 3.0" in reason


def test_blur_that_leaves_the_circles_is_a_problem_of_the_view(upright):
    got = detect_board(gaussian_filter(upright, 3.5), SPEC, threads=1)
    assert got.found
    assert got.problems[0].startswith("blurred: edges are 3.")


def test_saturated_pictures_and_views_are_told(upright):
    bright = np.minimum(upright * 40, 255)
    assert "100% of it saturated" in refused(bright, saturated=bright >= 255)
    bright[:20] = 10
    assert refused(bright, saturated=bright >= 255).startswith("saturated: 94% of the picture's pixels")
    spot = np.zeros(upright.shape, bool)
    spot[150:200, 200:260] = True
    got = detect_board(np.where(spot, 255, upright), SPEC, saturated=spot, threads=1)
    assert got.found
    assert got.problems[0].startswith("saturated: ")
    assert any(text.startswith("lost in glare") for text in got.problems)


def test_oblique_view_is_refused_with_its_tilt():
    scene = Scene(BOARD, Camera(640, 480, 1500.0), tilt_deg=72, axis_deg=90, noise=1.0)
    reason = refused(scene.picture())
    assert reason.startswith("too oblique: tilted by 7")


def test_small_board_is_told_in_pixels():
    scene = Scene(BOARD, CAMERA, fill=0.3, noise=1.0)
    got = detect_board(scene.picture(), SPEC, threads=1)
    assert "too small: circles are" in "; ".join((got.reason, *got.problems))
    tiny = replace(scene, fill=0.08).picture()
    assert "0 dark circles of 5 px or more" in refused(tiny)


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((360, 480)), np.full((360, 480), 255, np.uint8), np.full((360, 480), np.nan),
        np.full((360, 480), np.inf), np.zeros((0, 0)), np.ones((1, 1)), np.ones((31, 500)),
        RNG.normal(size=(360, 480)), RNG.integers(0, 255, (360, 480)).astype(np.uint8),
        np.linspace(0, 1, 360 * 480).reshape(360, 480), np.where(np.arange(480) > 240, 1.0, 0.0) * np.ones((360, 1)),
        np.where(RNG.random((360, 480)) > 0.995, np.nan, 3.0), np.eye(400) * 1e30,
        np.where(np.arange(360 * 480).reshape(360, 480) == 77, 1e9, RNG.normal(size=(360, 480))),
    ],
)  # fmt: skip
@pytest.mark.parametrize("board", [BOARD, Board(kind="chessboard", columns=7, rows=5)], ids=lambda board: board.kind)
def test_what_is_no_board_is_refused(picture, board):
    refused(picture, spec_of(board))


def test_clutter_of_circles_is_no_board():
    y, x = np.mgrid[:360, :480]
    picture = np.full((360, 480), 200.0)
    for cx, cy, radius in np.column_stack(
        [RNG.uniform(20, 460, 150), RNG.uniform(20, 340, 150), RNG.uniform(4, 9, 150)]
    ):
        picture[np.hypot(x - cx, y - cy) < radius] = 30.0
    refused(gaussian_filter(picture, 0.7))


def test_holes_of_nan_cost_their_own_circles_alone(upright):
    picture = upright.copy()
    scene = Scene(BOARD, CAMERA, turn_deg=10, noise=1.0)
    x, y = np.rint(scene.seen(np.array([30]))[0]).astype(int)
    picture[y - 12 : y + 12, x - 12 : x + 12] = np.nan
    picture[RNG.random(picture.shape) < 0.003] = np.nan
    got = detect_board(picture, SPEC, threads=1)
    assert got.found
    assert len(got.index) >= 50
    assert np.abs(got.px - scene.seen(got.index)).max() < 0.05


@pytest.mark.parametrize("picture", [np.zeros((2, 3, 4)), np.zeros(5), np.zeros((40, 40), complex)])
def test_what_is_no_picture_is_an_error(picture):
    with pytest.raises(ValueError, match="expected \\(height, width\\) grey"):
        detect_board(picture, SPEC)
