"""What cannot give a right calibration is refused, what does not fit is left out: each with its name and its figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import POSES, chosen, pose, stereo, view, views
from test_calibrate_views import calibrated, normalised

from fringed.boards import Board
from fringed.errors import DataError


def rng(seed=1):
    return np.random.default_rng(seed)


def notes_of(found):
    return "\n".join(found.notes)


def assert_right(found):
    assert np.abs(normalised(found)).max() < 5


def refused(given, match, **params):
    with pytest.raises(DataError, match=match) as told:
        calibrated(given, **params)
    return str(told.value)


def test_too_few_views_are_refused_and_those_without_a_board_are_named():
    given = views(rng(), POSES[:4])
    refused(given, "4 of 4 views can be used, at least 5")
    lost = replace(view(POSES[4], 5, rng()), found=False, reason="no board: too dark")
    text = refused([*given, lost], "4 of 5 views")
    assert "pose-05" in text and "too dark" in text


def test_parallel_boards_are_refused_with_their_spread():
    places = [pose(2 * k, 0, at=(20.0 * k - 50, 10.0 * k, 950 + 20.0 * k)) for k in range(4)]
    places += [pose(1, 1, 90, at=(0, 30, 1000)), pose(0, 3, at=(30, -20, 1040))]
    refused(views(rng(), places), r"face the same way within [1-7]\.\d degrees, at least 8")


def test_view_of_another_pitch_is_left_out_and_named():
    given = views(rng())
    given[4] = view(POSES[4], 5, rng(9), scale=(1.02, 1.02))
    found = calibrated(given)
    assert_right(found)
    assert "pose-05 was left out: its board is 2.0" in notes_of(found) and "larger" in notes_of(found)
    assert [fit.name for fit in found.views if fit.note] == ["pose-05"]


def test_print_that_is_stretched_is_refused_with_how_much():
    text = refused(views(rng(), scale=(1.01, 1.0)), "longer along x")
    assert "0.9" in text or "1.0" in text


@pytest.mark.parametrize(("axes", "told"), [
    ([1, 0], "columns and rows are swapped"), ([-1, 1], "columns run backwards"), ([1, -1], "rows run backwards"),
])  # fmt: skip
def test_projector_that_is_swapped_or_mirrored_is_refused(axes, told):
    given = []
    for one in views(rng()):
        px = one.projector_px[:, ::-1] if axes == [1, 0] else one.projector_px * axes + [1023 * (axes[0] < 0), 0]
        given.append(replace(one, projector_px=px))
    refused(given, told)


def test_board_that_is_upside_down_is_fine():
    places = [p @ pose(0, 0, 180, at=(0, 0, 0)) if k % 2 else p for k, p in enumerate(POSES)]
    assert_right(calibrated(views(rng(), places)))


@pytest.mark.parametrize("after", [3, 6, 9])
def test_rig_that_moved_is_refused_with_the_views_between_which_it_did(after):
    given = [view(place, k + 1, rng(k), T=stereo(0.3 if k >= after else 0.0)) for k, place in enumerate(POSES)]
    text = refused(given, f"moved between pose-{after:02d} and pose-{after + 1:02d}")
    assert "0.3" in text


def test_single_view_in_which_the_projector_stood_elsewhere_is_left_out():
    given = views(rng())
    given[7] = view(POSES[7], 8, rng(9), T=stereo(0.2))
    found = calibrated(given)
    assert_right(found)
    assert "pose-08 was left out: in it the projector stands elsewhere: turned by 0.2" in notes_of(found)


def test_wrong_fringe_orders_at_some_centres_are_dropped():
    given, random = [], rng(5)
    for one in views(rng()):
        wrong = random.random(len(one.index)) < 0.1
        given.append(replace(one, projector_px=one.projector_px + np.where(wrong[:, None], [16.0, 0.0], 0.0)))
    found = calibrated(given)
    assert_right(found)
    assert 90 < found.residuals["points_dropped"] < 200


@pytest.mark.parametrize("word", ["blurred: edges are 4.0 px wide", "saturated: 30 % of the board"])
def test_poor_views_are_left_out_with_notice_and_used_when_asked(word):
    given = views(rng())
    given[2] = replace(given[2], problems=(word,))
    found = calibrated(given)
    assert f"pose-03 was left out: {word}" in notes_of(found) and found.residuals["views"] == 11
    assert calibrated(given, use_poor_views=True).residuals["views"] == 12


def test_views_of_other_sizes_and_boards_are_left_out_with_both_values():
    given = views(rng())
    given[1] = replace(given[1], camera_size_px=(640, 480))
    given[3] = replace(given[3], projector_size_px=(1920, 1080))
    given[5] = view(POSES[5], 6, rng(), board=Board(kind="circles", columns=9, rows=7))
    found = calibrated(given)
    told = notes_of(found)
    assert "640 x 480 px, that of the others 1392 x 1040" in told and "1920 x 1080" in told and "another board" in told
    assert found.residuals["views"] == 9
    assert_right(found)


def test_view_without_projector_points_is_left_out_and_nothing_but_them_is_refused():
    given = views(rng())
    given[0] = replace(given[0], projector_px=np.full_like(given[0].projector_px, np.nan))
    found = calibrated(given)
    assert "pose-01 was left out: 0 of its points" in notes_of(found)
    assert_right(found)
    refused([replace(one, projector_px=np.full_like(one.projector_px, np.nan)) for one in given], "0 views can be used")


def test_duplicates_and_corners_without_points_are_noted():
    places = [p.copy() for p in POSES[:6]]
    for p in places:
        p[:2, 3] = [-45, -35]
    given = views(rng(), [*places, places[0]])
    keep = np.flatnonzero(np.arange(117) % 13 < 7)
    told = notes_of(calibrated([chosen(one, keep) for one in given]))
    assert "pose-07: the board stands where it stood in pose-01" in told
    assert "of the picture was covered" in told and "right" in told


def test_board_that_bends_leaves_residuals_that_are_refused_or_told():
    given = []
    for one, place in zip(views(rng()), POSES, strict=True):
        x = np.linspace(-1, 1, 13)[np.arange(117) % 13]
        off = 3.0 * (x**2)[:, None] * place[:3, 2][None, :2] / 1000.0 * 3480.0
        given.append(replace(one, camera_px=one.camera_px + off))
    with pytest.raises(DataError):
        calibrated(given)


def test_every_note_says_that_a_wrong_pitch_shows_in_nothing():
    found = calibrated(views(rng(), scale=(1.01, 1.01)))
    assert "a pitch that is wrong everywhere" in notes_of(found)
    assert np.linalg.norm(found.T_projector_camera[:3, 3]) == pytest.approx(280 / 1.01, rel=1e-3)
