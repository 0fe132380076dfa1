"""Calibrations from views of a known rig: the numbers, and how well they say they are known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import CAMERA, POSES, PROJECTOR, chosen, pose, seen, stereo, view, views

from fringed.boards import Board
from fringed.errors import DataError
from fringed.testing import RecordingContext
from fringed_plugins.calibration.solve.falloff import falloffs
from fringed_plugins.calibration.solve.observations import Rig
from fringed_plugins.calibrators.calibrate import Calibrate, observed
from fringed_plugins.calibrators.drift import CompareCalibrations, InfieldCorrection

FREE = [*range(8), *range(9, 17), *range(18, 24)]


def run(processor, inputs, **params):
    return processor().run(inputs, processor.Params(**params), RecordingContext())


def calibrated(given, **params):
    return run(Calibrate, {"views": given}, **params)


def numbers(found):
    lenses = [np.array([m[0, 0], m[1, 1], m[0, 2], m[1, 2], *d]) for m, d in (
        (found.camera.matrix, found.camera.distortion), (found.projector.matrix, found.projector.distortion)
    )]  # fmt: skip
    R = found.T_projector_camera[:3, :3] @ stereo()[:3, :3].T
    small = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    return np.concatenate([*lenses, small, found.T_projector_camera[:3, 3]])


TRUE = np.concatenate([CAMERA, PROJECTOR, np.zeros(3), stereo()[:3, 3]])


def normalised(found):
    return ((numbers(found) - TRUE) / np.sqrt(np.maximum(np.diag(found.covariance), 1e-300)))[FREE]


def test_numbers_are_within_their_own_deviations_over_many_calibrations():
    every = np.array([normalised(calibrated(views(np.random.default_rng(seed)))) for seed in range(6)])
    assert np.abs(every).max() < 4.5  # of 132 normal numbers one beyond 3.6 is usual
    assert 0.6 < np.mean(every**2) < 1.6
    assert np.abs(every.mean(axis=0)).max() < 1.6  # a bias of half a deviation would be seen in six


def test_noise_that_was_stated_too_small_is_found_out():
    given = [
        replace(one, camera_sigma_px=one.camera_sigma_px / 5, projector_sigma_px=one.projector_sigma_px / 3)
        for one in views(np.random.default_rng(3))
    ]
    found = calibrated(given)
    assert found.residuals["camera_factor"] == pytest.approx(5, rel=0.1)
    assert found.residuals["projector_factor"] == pytest.approx(3, rel=0.1)
    assert np.abs(normalised(found)).max() < 4.5


def test_focal_lengths_and_baseline_are_right_to_a_thousandth_and_residuals_are_the_noise():
    found = calibrated(views(np.random.default_rng(1)))
    off = numbers(found) - TRUE
    assert np.abs(off[[0, 1, 9, 10]] / TRUE[[0, 1, 9, 10]]).max() < 2e-4
    assert abs(np.linalg.norm(found.T_projector_camera[:3, 3]) - 280) < 0.05
    for name in ("camera", "projector"):
        assert found.residuals[f"{name}_rms_px"] == pytest.approx(0.01 * np.sqrt(2), rel=0.06)
    assert found.residuals["points_dropped"] <= 2 and found.provenance.simulated and found.rig == "rig"
    assert [fit.name for fit in found.views] == [f"pose-{k:02d}" for k in range(1, 13)]


def test_perspective_of_circles_is_undone():
    """Without it, half a tenth of a pixel would be left: far above the noise here."""
    found = calibrated(views(np.random.default_rng(2), noise=(1e-3, 1e-3)))
    assert found.residuals["camera_rms_px"] < 0.003 and np.abs(normalised(found)).max() < 5


def test_order_of_views_does_not_matter():
    given = views(np.random.default_rng(4))
    one, other = calibrated(given), calibrated(given[::-1])
    assert np.abs((numbers(one) - numbers(other)) / np.sqrt(np.diag(one.covariance) + 1e-300))[FREE].max() < 0.02


@pytest.mark.parametrize(
    "board", [Board(kind="chessboard", columns=11, rows=8), Board(kind="circles", columns=9, rows=7)]
)
def test_other_boards_and_five_views_serve_too(board):
    found = calibrated([view(POSES[k], k, np.random.default_rng(k), board=board) for k in (0, 1, 3, 4, 6)])
    assert np.abs(normalised(found)).max() < 5


def test_third_radial_coefficient_is_estimated_only_where_there_is_one():
    plain = calibrated(views(np.random.default_rng(5)))
    assert plain.camera.distortion[4] == 0 and plain.projector.distortion[4] == 0
    wide = (1400.0, 1400.0, 695.5, 519.5, -0.2, 0.1, 0.0, 0.0, -0.08)
    near = [p.copy() for p in POSES]
    for p in near:
        p[:3, 3] *= [1.6, 1.6, 0.42]
    strong = calibrated(views(np.random.default_rng(6), near, lenses=(wide, PROJECTOR), T=stereo()))
    assert strong.camera.distortion[4] == pytest.approx(-0.08, abs=0.03)


def test_tone_of_an_older_calibration_is_kept_and_that_of_another_rig_is_not():
    given = views(np.random.default_rng(7))
    bare = calibrated(given)
    old = replace(bare, tone_curve=np.linspace(0, 1, 256), residuals={"tone_rms": 0.001, "camera_rms_px": 9.0})
    kept = run(Calibrate, {"views": given, "calibration": old})
    assert kept.tone_curve is not None and kept.residuals["tone_rms"] == 0.001 and kept.residuals["camera_rms_px"] < 1
    other = run(Calibrate, {"views": given, "calibration": replace(old, rig="another")})
    assert other.tone_curve is None


def test_calibrations_of_one_rig_are_the_same_and_a_knock_is_seen():
    one, other = (calibrated(views(np.random.default_rng(seed))) for seed in (8, 9))
    table = json.loads(run(CompareCalibrations, {"a": one, "b": other}).content.tobytes())
    assert table["verdict"] == "same" and 0.2 < table["rms_mm"] / table["expected_mm"] < 2
    assert max(abs(row["deviations"]) for row in table["parameters"] if row["deviations"] is not None) < 5
    knocked = calibrated(views(np.random.default_rng(10), T=stereo(0.05)))
    table = json.loads(run(CompareCalibrations, {"a": one, "b": knocked}).content.tobytes())
    assert table["verdict"] == "drifted" and table["rms_mm"] > 1
    with pytest.raises(DataError, match="rigs"):
        run(CompareCalibrations, {"a": one, "b": replace(other, rig="another")})


def test_one_pose_puts_a_knocked_rig_right():
    before = calibrated(views(np.random.default_rng(11)))
    after = [view(POSES[0], 1, np.random.default_rng(12), T=stereo(0.05, 0.3))]
    exact = calibrated(views(np.random.default_rng(13), T=stereo(0.05, 0.3)))
    fixed = run(InfieldCorrection, {"views": after, "calibration": before})
    assert fixed.source == "infield" and fixed.residuals["infield_turned_deg"] == pytest.approx(0.05, abs=0.005)
    far = [
        json.loads(run(CompareCalibrations, {"a": exact, "b": one}).content.tobytes())["rms_mm"]
        for one in (before, fixed)
    ]
    assert far[1] < far[0] / 10 and far[1] < 0.1  # both are good to some hundredths themselves
    odd = [view(POSES[0], 1, np.random.default_rng(14), scale=(1.03, 1.0))]
    with pytest.raises(DataError, match="contradicts the lenses"):
        run(InfieldCorrection, {"views": odd, "calibration": before})


def test_falloff_of_both_lenses_comes_back_from_the_papers_light():
    lit = []
    for one, place in zip(views(np.random.default_rng(15)), POSES, strict=True):
        points = (np.stack([one.camera_px[:, 0], one.camera_px[:, 1]], -1), place)
        lit.append(replace(one, light=_light(one, points[1])))
    found = calibrated(lit)
    rig = Rig(*(_pinhole(lens) for lens in (found.camera, found.projector)), found.T_projector_camera, np.array(
        [fit.T_camera_board for fit in found.views]
    ))  # fmt: skip
    camera, projector = falloffs([observed(one, k) for k, one in enumerate(lit)], rig)
    assert camera[0] == pytest.approx(-0.2, abs=0.02) and projector[0] == pytest.approx(-0.1, abs=0.02)


def _pinhole(lens):
    from fringed_plugins.calibration.rig import Pinhole

    return Pinhole(lens.width_px, lens.height_px, lens.matrix, lens.distortion)


def _light(one, place):
    """Return what matt paper sends back, with falloffs of 20 and 10 % at the corners and some ambient light."""
    from fringed.boards import board_of, points_mm

    points = points_mm(board_of(one.board)) @ place[:3, :3].T + place[:3, 3]
    T = stereo()
    lit = points @ T[:3, :3].T + T[:3, 3]
    cosine = np.abs(lit @ (T[:3, :3] @ place[:3, 2])) / np.linalg.norm(lit, axis=1)
    light = cosine * (1000.0 / np.linalg.norm(lit, axis=1)) ** 2
    dark = []
    for numbers_, at, size in ((CAMERA, points, (1392, 1040)), (PROJECTOR, lit, (1024, 768))):
        r2 = ((seen(numbers_, at) - (np.array(size) - 1) / 2) ** 2).sum(axis=1) / ((np.array(size) / 2) ** 2).sum()
        dark.append(1 + (-0.2 if numbers_ is CAMERA else -0.1) * r2)
    return 150.0 * dark[0] * (light * dark[1] + 0.04)


def test_views_of_a_part_of_the_board_serve_too():
    random = np.random.default_rng(16)
    given = [chosen(one, np.sort(random.choice(117, 40, replace=False))) for one in views(random)]
    found = calibrated(given)
    assert np.abs(normalised(found)).max() < 4.5 and found.residuals["points"] >= 478


def test_forty_views_are_known_better_by_the_root_of_their_number():
    places = [place @ pose(0, 0, 7.0 * k, at=(0, 0, 0)) for k, place in enumerate(POSES * 4)][:40]
    few, many = (calibrated(views(np.random.default_rng(17), some)) for some in (POSES, places))
    assert np.abs(normalised(many)).max() < 4.5
    ratio = many.residuals["trueness_rms_mm"] / few.residuals["trueness_rms_mm"]
    assert ratio == pytest.approx(np.sqrt(12 / 40), rel=0.15)


def test_points_of_single_precision_serve_as_well():
    given = views(np.random.default_rng(18))
    single = [
        replace(one, camera_px=one.camera_px.astype(np.float32), projector_px=one.projector_px.astype(np.float32))
        for one in given
    ]
    exact, rough = calibrated(given), calibrated(single)
    assert np.abs((numbers(exact) - numbers(rough)) / np.sqrt(np.diag(exact.covariance) + 1e-300))[FREE].max() < 0.1
