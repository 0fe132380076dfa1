"""Circles found in pictures whose truth is known: how exactly, under what light and turn, and on which boards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_truth import Camera, Scene, spec_of

from fringed.boards import Board, is_big
from fringed_plugins.calibration.detect.bias import ellipse_centres
from fringed_plugins.calibration.detect.detect import detect_board

BOARD = Board(columns=9, rows=7)
CAMERA = Camera(480, 360, 1100.0)
# The truth's own blur is good to 0.003 px RMS, and noise of one level in 150 adds 0.004 px to circles of 16 px.
RMS_PX, BIAS_PX = 0.01, 0.003


def found(scene, **changes):
    got = detect_board(scene.picture(), spec_of(scene.board), threads=1, **changes)
    assert got.found, got.reason
    return got


def errors(scene, got):
    return got.px - scene.seen(got.index)


@pytest.mark.parametrize(
    ("tilt", "axis", "blur"), [(0, 0, 0.4), (30, 20, 0.7), (45, 90, 0.7), (45, 140, 1.2), (60, 60, 0.7)]
)
def test_centres_are_true_and_have_no_bias_along_the_perspective(tilt, axis, blur):
    scene = Scene(BOARD, CAMERA, tilt_deg=tilt, axis_deg=axis, turn_deg=12, blur_px=blur, noise=1.0, slope=(0.3, -0.2))
    got = found(scene)
    assert len(got.index) == 63
    off = errors(scene, got)
    assert np.sqrt(np.mean(off**2)) < RMS_PX
    assert np.abs(off.mean(axis=0)).max() < BIAS_PX
    if tilt:
        bias = scene.seen(got.index) - scene.camera.project(scene.points())[got.index]
        along = bias / np.linalg.norm(bias, axis=1, keepdims=True)
        assert abs(float(np.sum(off * along, axis=1).mean())) < BIAS_PX


def test_centre_of_a_large_circle_is_the_centroid_of_its_image_and_not_its_centres_image():
    # Wide lens, near board, 60 px circles: perspective moves centres by half a pixel and more.
    scene = Scene(Board(columns=5, rows=5), Camera(420, 420, 330.0), tilt_deg=40, axis_deg=30, fill=0.95)
    got = found(scene)
    R, _ = scene.pose()
    centres = ellipse_centres(
        scene.points()[got.index], R[:, 2], spec_of(scene.board).diameters_mm[got.index] / 2, scene.camera.matrix,
        np.array(scene.camera.lens),
    )  # fmt: skip
    assert np.abs(centres - scene.seen(got.index)).max() < 0.002
    image_of_centre = scene.camera.project(scene.points())[got.index]
    assert np.linalg.norm(image_of_centre - centres, axis=1).max() > 0.5
    assert np.sqrt(np.mean((got.px - centres) ** 2)) < RMS_PX


def test_deviations_are_those_of_the_scatter():
    scene = Scene(BOARD, CAMERA, tilt_deg=30, axis_deg=20, turn_deg=12)
    clean, spec, truth = scene.picture(), spec_of(BOARD), None
    ratios = []
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(scale=5.0, size=clean.shape).astype(np.float32)
        got = detect_board(clean + noise, spec, threads=1)
        truth = scene.seen(got.index)
        ratios.append(np.mean((got.px - truth) ** 2 / got.sigma_px[:, None] ** 2))
    # 504 squared normal values: 1 within 0.06 of a deviation, and 0.02 of the truth's own blur.
    assert 0.8 < np.mean(ratios) < 1.25


def test_light_that_falls_off_pulls_no_centre():
    even = Scene(BOARD, CAMERA, turn_deg=5)
    steep = replace(even, slope=(0.6, -0.3))
    a, b = found(even), found(steep)
    assert np.array_equal(a.index, b.index)
    assert np.abs(a.px - b.px).max() < 0.003


@pytest.mark.parametrize("turn", [0, 90, 137, 180, -90])
def test_board_is_numbered_right_however_it_is_turned(turn):
    scene = Scene(BOARD, CAMERA, turn_deg=turn, tilt_deg=20, axis_deg=70, fill=0.65)
    got = found(scene)
    assert len(got.index) == 63
    assert np.abs(errors(scene, got)).max() < 0.05
    apart = (got.quality["turned_deg"] - turn + 180) % 360 - 180
    assert abs(apart) < 4  # tilting shears what is seen
    assert got.problems == ()


@pytest.mark.parametrize(
    "board",
    [
        Board(columns=9, rows=7, polarity="light-on-dark"),
        Board(columns=5, rows=5),
        Board(columns=6, rows=11, pitch_mm=3.0),
        Board(columns=9, rows=7, diameter_mm=12.0, big_diameter_mm=17.0),
        Board(columns=9, rows=7, diameter_mm=7.0, big_diameter_mm=10.0),
    ],
)
def test_boards_of_any_size_and_polarity(board):
    scene = Scene(board, CAMERA, turn_deg=8, tilt_deg=25, axis_deg=50, noise=1.0)
    got = found(scene)
    assert len(got.index) == board.columns * board.rows
    assert np.sqrt(np.mean(errors(scene, got) ** 2)) < RMS_PX


def test_hundreds_of_small_circles_none_of_them_a_stray():
    scene = Scene(Board(columns=20, rows=15, pitch_mm=8.0), Camera(560, 420, 1300.0), tilt_deg=30, fill=0.9, noise=1.0)
    got = found(scene)
    assert len(got.index) == 300
    assert got.quality["strays"] == 0
    assert got.quality["residual_px"] < 0.02


def test_part_of_a_board_is_enough_and_says_which_edge_cuts_it():
    scene = Scene(BOARD, CAMERA, turn_deg=4, tilt_deg=20, fill=1.05, shift=(0.2, 0.0), noise=1.0)
    got = found(scene)
    assert 30 < len(got.index) < 63
    assert np.sqrt(np.mean(errors(scene, got) ** 2)) < RMS_PX
    (problem,) = got.problems
    assert problem.startswith("cut by an edge of the picture (")
    assert "right" in problem
    assert f"{63 - len(got.index)} of 63" in problem
    # Nothing that the edge touches was taken for a circle.
    assert got.px.min() > 4
    assert (got.px < np.array([CAMERA.width, CAMERA.height]) - 5).all()


def test_covered_circles_are_left_out_and_told():
    scene = Scene(BOARD, CAMERA, noise=1.0)
    picture, hidden = scene.picture(), scene.seen(np.array([10, 11, 19]))
    for x, y in hidden:
        picture[int(y) - 13 : int(y) + 3, int(x) - 13 : int(x) + 13] = 40.0
    got = detect_board(picture, spec_of(BOARD), threads=1)
    assert got.found
    assert not set(got.index) & {10, 11, 19}
    assert len(got.index) == 60
    assert any(text.startswith("covered or not seen: 3 of 63 points") for text in got.problems)


def test_four_of_the_five_large_circles_are_enough():
    scene = Scene(BOARD, CAMERA, noise=1.0)
    picture, big = scene.picture(), np.flatnonzero(is_big(BOARD))
    x, y = np.rint(scene.seen(big[:1])[0]).astype(int)
    picture[y - 14 : y + 15, x - 14 : x + 15] = 160.0
    got = detect_board(picture, spec_of(BOARD), threads=1)
    assert got.found
    assert big[0] not in got.index
    assert np.sqrt(np.mean(errors(scene, got) ** 2)) < RMS_PX


def test_figures_of_a_view_are_those_of_the_scene():
    scene = Scene(BOARD, CAMERA, tilt_deg=40, axis_deg=90, blur_px=1.0)
    quality = found(scene).quality
    assert quality["tilt_deg"] == pytest.approx(40, abs=2)
    assert quality["blur_px"] == pytest.approx(1.0, abs=0.05)
    assert quality["contrast"] == pytest.approx((0.9 - 0.06) / (0.9 + 0.06 + 4 / 180), abs=0.01)
    assert quality["found_share"] == 1.0


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float64])
def test_any_type_of_grey_will_do(kind):
    scene = Scene(BOARD, CAMERA, noise=1.0)
    picture = np.clip(scene.picture(), 0, 255)
    picture = np.rint(picture * (200 if kind is np.uint16 else 1)).astype(kind)
    got = detect_board(picture[:, ::-1][:, ::-1], spec_of(BOARD), threads=1)
    assert got.found
    assert np.sqrt(np.mean(errors(scene, got) ** 2)) < RMS_PX


@pytest.mark.parametrize(("kind", "columns", "rows"), [("circles", 8, 6), ("asymmetric-circles", 4, 11)])
@pytest.mark.parametrize("turn", [5, 80])
def test_boards_without_large_circles(kind, columns, rows, turn):
    scene = Scene(Board(kind=kind, columns=columns, rows=rows), CAMERA, turn_deg=turn, tilt_deg=20, fill=0.6, noise=1.0)
    got = found(scene)
    assert len(got.index) == columns * rows
    assert np.sqrt(np.mean(errors(scene, got) ** 2)) < RMS_PX


def test_asymmetric_board_is_numbered_right_upside_down():
    scene = Scene(Board(kind="asymmetric-circles", columns=4, rows=11), CAMERA, turn_deg=170, noise=1.0)
    assert np.abs(errors(scene, found(scene))).max() < 0.05
