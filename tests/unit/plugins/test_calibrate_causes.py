"""Faults that no view shows by itself: a bent or stretched print, a rig that creeps; allowed for, told or refused."""

from __future__ import annotations

import re

import calibration_truth
import numpy as np
import pytest
from calibration_truth import BOARD, POSES, pose, stereo, view, views
from test_calibrate_views import calibrated, normalised, numbers

from fringed.boards import points_mm
from fringed.errors import DataError


def rng(seed=1):
    return np.random.default_rng(seed)


def creeping(degrees):
    return [view(place, k + 1, rng(k), T=stereo(degrees * k)) for k, place in enumerate(POSES)]


@pytest.fixture
def bent_views(monkeypatch):
    """Return a maker of views of a sheet that rises by so many mm to its corners, as a parabola of both directions."""

    def made(rise_mm):
        flat = points_mm(BOARD)
        bent = flat.copy()
        bent[:, 2] = rise_mm * ((flat[:, 0] / 120) ** 2 + (flat[:, 1] / 80) ** 2) / 2
        monkeypatch.setattr(calibration_truth, "points_mm", lambda board: bent)
        return [view(place, k + 1, rng(k)) for k, place in enumerate(POSES)]

    return made


@pytest.mark.parametrize("rise_mm", [0.05, -0.2])
def test_board_that_is_bent_a_little_is_measured_and_allowed_for(bent_views, rise_mm):
    """Taken for flat, 0.05 mm would put the focal length off by 14 of its deviations."""
    found = calibrated(bent_views(rise_mm))
    told = re.search(r"bent by (\d\.\d+) mm: allowed for", found.notes[0])
    assert told and float(told[1]) == pytest.approx(abs(rise_mm), rel=0.03)
    assert np.abs(normalised(found)).max() < 4.5
    assert found.residuals["camera_rms_px"] == pytest.approx(0.01 * np.sqrt(2), rel=0.06)


def test_board_that_is_bent_much_is_refused_with_how_much(bent_views):
    with pytest.raises(DataError, match=r"bent by (0\.9|1\.0)\d* mm: at most 0.48 mm"):
        calibrated(bent_views(1.0))


def test_small_stretch_of_the_print_is_allowed_for_and_told():
    found = calibrated(views(rng(2), scale=(1.0003, 1.0)))
    assert "the print is 0.030% longer along x" in " ".join(found.notes)
    assert np.abs(normalised(found)).max() < 4.5
    assert abs(numbers(found)[0] / 3480 - 1) < 1e-4


def test_right_views_are_blamed_for_nothing():
    for seed in range(3):
        found = calibrated(views(rng(seed), noise=(0.02, 0.05)))
        assert len(found.notes) == 1 and found.residuals["between_views_factor"] == 1


def test_stretch_that_no_turned_board_shows_is_refused_and_its_absence_told():
    """Tilts about one axis, boards upright: a camera of oblong pixels would see the same."""
    places = [pose(tilt, 0) for tilt in (-30, -20, -10, 0, 10, 20, 30)]
    with pytest.raises(DataError, match=r"0\.9\d% off square, or the print is stretched"):
        calibrated(views(rng(2), places, scale=(1.01, 1.0)))
    found = calibrated(views(rng(2), places))
    assert "turn the board in its plane by 90 degrees" in found.notes[0]


def test_rig_that_creeps_is_refused_with_how_far():
    with pytest.raises(DataError, match=r"little by little: .* turned by 0\.05\d degrees"):
        calibrated(creeping(0.005))


@pytest.mark.parametrize("unsteady", [creeping(0.001), creeping(0.01), None], ids=["little", "much", "shaken"])
def test_deviations_hold_where_views_contradict_each_other(unsteady):
    """Points of one view share its error: by the number of points, numbers were off by 20 of their deviations."""
    shaken = [view(place, k + 1, rng(k), T=stereo(rng(90 + k).normal(0, 0.005))) for k, place in enumerate(POSES)]
    found = calibrated(unsteady or shaken)
    assert found.residuals["between_views_factor"] > 3 and len(found.notes) > 1
    assert np.abs(normalised(found)).max() < 4.5


def test_focal_length_that_is_left_open_is_told():
    places = [pose(5 * np.cos(t), 5 * np.sin(t), 90 * k, at=(0, 0, 1000)) for k, t in enumerate(range(6))]
    assert "focal length is known to" in " ".join(calibrated(views(rng(4), places, noise=(0.15, 0.15))).notes)
