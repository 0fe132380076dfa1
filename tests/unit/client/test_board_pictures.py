"""Pictures of board views: points at their pixels, the large ones ringed, and what is wrong in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_pages import example

from fringed.boards import Board, is_big
from fringed.data import BoardView
from fringed_client.pictures import boards, figures, gallery


@pytest.fixture(scope="module")
def views():
    found = example(1, 1)[1]
    return found[0], found[-1]


@pytest.fixture
def axes(monkeypatch):
    """Draw without clearing, so that what is on the axes can be looked at."""
    kept = []

    def save(drawn, path):
        kept.append(drawn.axes[0])
        return figures.save(_Keeping(drawn), path)

    monkeypatch.setattr(boards, "save", save)
    return kept


class _Keeping:
    def __init__(self, drawn):
        self.savefig = drawn.savefig

    def clear(self):
        pass


def marks(axes, marker):
    return {line.get_color(): line.get_xydata() for line in axes.lines if line.get_marker() == marker}


def test_points_stand_at_their_pixels_and_the_five_are_ringed(views, axes, tmp_path):
    view = views[0]
    lit = np.arange(len(view.index)) % 3 > 0
    projector = np.where(lit[:, None], view.projector_px, np.nan)
    boards.draw_board_view(tmp_path / "a.png", replace(view, projector_px=projector))
    crosses = marks(axes[0], "+")
    assert np.array_equal(crosses[boards._FOUND], view.camera_px[lit])
    assert np.array_equal(crosses[boards._UNLIT], view.camera_px[~lit])
    (rings,) = marks(axes[0], "o").values()
    assert np.array_equal(rings, view.camera_px[is_big(Board())]) and len(rings) == 5
    numbers = {text.get_text(): text.xy for text in axes[0].texts}
    assert 10 <= len(numbers) <= 20
    assert all(np.array_equal(view.camera_px[int(number)], place) for number, place in numbers.items())


def test_part_of_a_board_is_numbered_by_the_boards_points(views, axes, tmp_path):
    view = views[0]
    kept = np.flatnonzero(np.arange(len(view.index)) >= 60)
    part = replace(
        view, index=view.index[kept], camera_px=view.camera_px[kept], camera_sigma_px=view.camera_sigma_px[kept],
        projector_px=view.projector_px[kept], projector_sigma_px=view.projector_sigma_px[kept],
        projector_jacobian=view.projector_jacobian[kept],
    )  # fmt: skip
    boards.draw_board_view(tmp_path / "a.png", part)
    assert min(int(text.get_text()) for text in axes[0].texts) == 60
    (rings,) = marks(axes[0], "o").values()
    assert np.array_equal(rings, view.camera_px[is_big(Board()) & (view.index >= 60)])


def test_picture_lies_on_the_cameras_pixels(views, axes, tmp_path):
    """A reduced picture's pixel k covers pixels k n to k n + n - 1, centres at integers."""
    boards.draw_board_view(tmp_path / "a.png", views[0])
    (image,) = axes[0].images
    assert image.get_extent() == [-0.5, 1391.5, 1039.5, -0.5]
    assert axes[0].get_ylim() == (1039.5, -0.5)


@pytest.mark.parametrize("size", [(1392, 1040), (1393, 1041)])
def test_reduced_picture_keeps_its_scale_where_the_step_does_not_divide(views, axes, tmp_path, size):
    width, height = size
    picture = np.zeros((-(-height // 4), -(-width // 4)), np.uint8)
    view = replace(views[1], camera_size_px=size, picture=picture, picture_step=4)
    boards.draw_board_view(tmp_path / "a.png", view)
    left, right, bottom, top = axes[0].images[0].get_extent()
    assert (left, top) == (-0.5, -0.5)
    assert (right - left, bottom - top) == (4 * picture.shape[1], 4 * picture.shape[0])


def test_reason_and_problems_are_told(views, axes, tmp_path):
    missed = replace(views[1], problems=("glare over 8 % of the board",), quality={"tilt_deg": 31.4, "saturated": 0.08})
    boards.draw_board_view(tmp_path / "a.png", missed)
    assert axes[0].get_title(loc="left") == "pose-02: NOT FOUND"
    assert axes[0].get_title(loc="right") == "SIMULATED"
    told = axes[0].get_xlabel().splitlines()
    assert told == [
        "tilt 31 deg, saturated 8.0%",
        "blurred: edges of 4.2 px, at most 2.5",
        "glare over 8 % of the board",
    ]


def test_view_without_picture_or_of_an_unknown_board_is_drawn(tmp_path, views):
    empty = BoardView({"kind": "of a later release"}, (64, 48), (32, 24), False, reason="no board")
    odd = replace(views[0], board={"kind": "of a later release"}, picture=None)
    for content in (empty, odd):
        (path,) = gallery.draw_all(content, tmp_path)
        assert path.name == "boardview.png" and path.stat().st_size > 1000
