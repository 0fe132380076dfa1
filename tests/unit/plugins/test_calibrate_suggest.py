"""Where to hold the board next: suggestions are poses that can be held, and better than any other that was tried."""

from __future__ import annotations

import json

import numpy as np
import pytest
from calibration_truth import BOARD, CAMERA, POSES, PROJECTOR, seen, stereo, view, views
from test_calibrate_views import calibrated, normalised, run

from fringed.boards import Board, points_mm
from fringed.errors import DataError
from fringed_plugins.calibration.solve.estimate import estimate
from fringed_plugins.calibration.solve.suggest import candidates, next_pose, words
from fringed_plugins.calibrators.calibrate import observed
from fringed_plugins.calibrators.suggest import SuggestPose


def rng(seed):
    return np.random.default_rng(seed)


def suggested(given, **params):
    return json.loads(run(SuggestPose, {"views": given}, **params).content.tobytes())


def test_first_poses_are_named_before_anything_is_known():
    told = [suggested(views(rng(1), POSES[:count])) for count in range(4)]
    assert len({one["text"] for one in told}) == 4
    assert all(one["T_camera_board"] is None and not one["enough"] for one in told)


def test_suggested_pose_shows_the_board_to_both_lenses():
    pose = np.array(suggested(views(rng(2), POSES[:5]))["T_camera_board"])
    points = points_mm(BOARD) @ pose[:3, :3].T + pose[:3, 3]
    camera, projector = seen(CAMERA, points), seen(PROJECTOR, points @ stereo()[:3, :3].T + stereo()[:3, 3])
    assert ((camera > 0) & (camera < [1391, 1039])).all()
    assert ((projector > 0) & (projector < [1023, 767])).all(axis=1).mean() >= 0.8


def test_what_is_promised_of_a_pose_is_what_it_gives():
    given = views(rng(3), POSES[:5])
    told = suggested(given)
    given.append(view(np.array(told["T_camera_board"]), 6, rng(4)))
    assert suggested(given)["before_mm"] == pytest.approx(told["after_mm"], rel=0.12)  # the volume moves a little too


def test_poses_that_were_suggested_leave_less_than_a_plan_does():
    given = views(rng(5), POSES[:4])
    for number in range(5, 13):
        given.append(view(np.array(suggested(given)["T_camera_board"]), number, rng(number)))
    mine, plan = calibrated(given), calibrated(views(rng(5)))
    assert mine.residuals["trueness_rms_mm"] < 0.8 * plan.residuals["trueness_rms_mm"]
    assert np.abs(normalised(mine)).max() < 4.5 and mine.residuals["coverage"] == 1


def test_enough_is_said_where_points_are_known_well_enough():
    given = views(rng(6), POSES[:6])
    assert suggested(given, enough_mm=1.0)["enough"] and "enough" in suggested(given, enough_mm=1.0)["text"]
    assert not suggested(given, enough_mm=1e-3)["enough"]


def test_words_differ_wherever_poses_do():
    held = candidates()
    assert len({words(one) for one in held}) == len(held) == 9 * 3 * 17 * 2


def test_board_that_fits_into_no_picture_and_mixed_views_are_refused():
    given = views(rng(7), POSES[:5])
    one = [observed(each, number) for number, each in enumerate(given)]
    found = estimate(one, (1392, 1040), (1024, 768))
    with pytest.raises(ValueError, match="smaller board"):
        next_pose(one, found, points_mm(BOARD) * 4)
    with pytest.raises(DataError, match="several boards"):
        suggested([*given, view(POSES[5], 6, rng(8), board=Board(kind="circles", columns=9, rows=7))])
    with pytest.raises(DataError, match="NoneType"):
        run(SuggestPose, {})
