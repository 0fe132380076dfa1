"""A knocked rig, put right by one pose: how well the projector's place is then known, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import POSES, stereo, view, views
from test_calibrate_views import calibrated, run

from fringed.errors import DataError
from fringed_plugins.calibrators.drift import InfieldCorrection

KNOCKED = stereo(0.05, 0.3)


def rng(seed):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def before():
    return [calibrated(views(rng(seed))) for seed in range(6)]


def place_off(found):
    """Return by how much the projector's place is off, in the numbers that a calibration names."""
    off = found.T_projector_camera @ np.linalg.inv(KNOCKED)
    turned = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
    return np.concatenate([turned, (found.T_projector_camera - KNOCKED)[:3, 3]])


@pytest.mark.parametrize("count", [1, 2])
def test_new_place_is_within_the_deviations_that_the_lenses_leave(before, count):
    """With the covariance of the pose's own points alone, it would be off by tens of deviations."""
    ratios = []
    for seed, old in enumerate(before):
        seen = [view(POSES[k], k, rng(50 + 7 * seed + k), T=KNOCKED) for k in range(count)]
        fixed = run(InfieldCorrection, {"views": seen, "calibration": old})
        assert np.linalg.eigvalsh(fixed.covariance).min() > -1e-12
        off = place_off(fixed)
        ratios.append(off @ np.linalg.solve(fixed.covariance[18:, 18:], off))
    assert max(ratios) < 22.5  # of six squared normal numbers, one sum in a thousand is larger
    assert 2.5 < np.mean(ratios) < 10.5  # six, from six samples: its deviation is 1.4


def test_lenses_stay_as_they_were_and_known_as_well(before):
    old = before[0]
    fixed = run(InfieldCorrection, {"views": [view(POSES[0], 1, rng(9), T=KNOCKED)], "calibration": old})
    assert np.array_equal(fixed.camera.matrix, old.camera.matrix)
    assert np.array_equal(fixed.projector.distortion, old.projector.distortion)
    assert np.allclose(fixed.covariance[:18, :18], old.covariance[:18, :18])


def test_calibration_without_covariance_stays_without(before):
    old = replace(before[0], covariance=None, parameters=())
    fixed = run(InfieldCorrection, {"views": [view(POSES[0], 1, rng(9), T=KNOCKED)], "calibration": old})
    assert fixed.covariance is None and np.abs(place_off(fixed)[:3]).max() < 1e-3


def test_views_of_another_rig_size_or_without_a_board_are_refused(before):
    one = view(POSES[0], 1, rng(9), T=KNOCKED)
    other = replace(one, provenance=replace(one.provenance, rig="another"))
    for wrong, told in (
        (replace(one, found=False, reason="too dark"), "pose-01 shows no board: too dark"),
        (replace(one, camera_size_px=(640, 480)), "640"),
        (other, "'another'"),
        (replace(one, projector_px=np.full_like(one.projector_px, np.nan)), "12 points and more"),
        (view(POSES[0], 1, rng(9), T=KNOCKED, scale=(1.02, 1.0)), "contradicts the lenses"),
    ):
        with pytest.raises(DataError, match=told):
            run(InfieldCorrection, {"views": [wrong], "calibration": before[0]})
