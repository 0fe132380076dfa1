"""The processor `detect-board`: phase maps to views, found or not, and inputs that cannot be meant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_truth import Camera, Scene

from fringed.boards import Board
from fringed.data import PhaseMap, Reject
from fringed.errors import DataError
from fringed_plugins.calibrators.detect_board import DetectBoard

BOARD = Board(columns=9, rows=7)
CAMERA = Camera(800, 400, 1300.0)
SCENE = Scene(BOARD, CAMERA, tilt_deg=20, axis_deg=40, fill=0.85, noise=1.0)
PERIOD, SIGMA = 16.0, 0.05
PROJECTOR = np.array([[2.9, 0.11, 510.0], [-0.2, 2.8, 380.0], [1e-4, -2e-4, 1.0]])  # board (mm) to projector (px)
NAMES = ("columns", "rows")


class Host:
    """A host that asks for nothing and hears nothing."""

    threads = 2

    def progress(self, fraction, text=""):
        assert 0 <= fraction <= 1

    def check_cancelled(self):
        pass

    def log(self, level, text):
        raise AssertionError(text)


def projected(place):
    mapped = np.concatenate([place, np.ones((*place.shape[:-1], 1))], axis=-1) @ PROJECTOR.T
    return mapped[..., :2] / mapped[..., 2:]


@pytest.fixture(scope="module")
def maps():
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    place, picture = projected(SCENE.places(np.stack([x, y], -1))), SCENE.picture()
    rng, made = np.random.default_rng(2), {}
    for axis, name in enumerate(NAMES):
        px = place[..., axis] + SIGMA * rng.normal(size=x.shape)
        made[name] = PhaseMap(
            phase_rad=(px * 2 * np.pi / PERIOD + 0.3).astype(np.float32), modulation=picture * 0.4,
            background=picture, rejected=np.zeros(x.shape, np.uint16), kind="absolute", period_px=PERIOD,
            orientation=name, initial_phase_rad=0.3, projector_px=(1024, 768)[axis],
            sigma_rad=np.full(x.shape, SIGMA * 2 * np.pi / PERIOD, np.float32),
        )  # fmt: skip
    return made


def view_of(inputs, **params):
    return DetectBoard().run(inputs, DetectBoard.Params(board=BOARD, **params), Host())


def changed(maps, **changes):
    return {name: replace(one, **changes) for name, one in maps.items()}


def test_view_has_both_places_of_every_point(maps):
    view = view_of(maps, name="first")
    assert view.found
    assert view.name == "first"
    assert np.array_equal(view.index, np.arange(63))
    assert view.camera_size_px == (800, 400)
    assert view.projector_size_px == (1024, 768)
    assert np.sqrt(np.mean((view.camera_px - SCENE.seen(view.index)) ** 2)) < 0.01
    off = view.projector_px - projected(SCENE.places(view.camera_px))
    assert np.sqrt(np.mean(off**2)) < 0.01
    # 126 squared normal values: 1 within 0.13 of a deviation.
    assert 0.6 < np.mean((off / view.projector_sigma_px) ** 2) < 1.5
    step = projected(SCENE.places(view.camera_px + np.array([1.0, 0.0]))) - projected(SCENE.places(view.camera_px))
    assert np.abs(view.projector_jacobian[:, :, 0] - step).max() < 0.02
    assert view.problems == ()


def test_light_is_that_of_the_ground(maps):
    view = view_of(maps)
    assert view.light == pytest.approx(np.full(63, 0.9 * 180 + 2), rel=0.01)


def test_small_picture_is_at_most_700_px_wide(maps):
    view = view_of(maps)
    assert view.picture_step == 2
    assert view.picture.shape == (200, 400)
    assert view.picture.dtype == np.uint8
    assert view.picture.max() == 255


def test_one_map_alone_is_enough_for_the_cameras_side(maps):
    view = view_of({"columns": maps["columns"]})
    assert view.found
    assert np.isnan(view.projector_px[:, 1]).all()
    assert view.projector_size_px == (1024, 0)


def test_no_board_is_a_view_that_says_why(maps):
    view = view_of(changed(maps, background=np.full((400, 800), 90, np.float32)))
    assert not view.found
    assert view.reason.startswith("the picture is uniform, 90 everywhere")
    assert len(view.index) == 0
    assert view.picture is not None
    assert "mirrored" in view_of(changed(maps, background=maps["rows"].background[:, ::-1])).reason


def test_saturated_pixels_are_counted(maps):
    rejected = np.zeros((400, 800), np.uint16)
    rejected[150:220, 350:450] = int(Reject.SATURATED)
    view = view_of(changed(maps, rejected=rejected))
    assert view.found
    assert view.problems[0].startswith("saturated: ")


def test_wrong_orders_at_some_points_are_left_out_and_told(maps):
    x, y = np.rint(SCENE.seen(np.array([5, 40]))).astype(int).T
    phase = maps["rows"].phase_rad.copy()
    for cx, cy in zip(x, y, strict=True):
        phase[cy - 30 : cy + 31, cx - 30 : cx + 31] += 2 * np.pi
    view = view_of({**maps, "rows": replace(maps["rows"], phase_rad=phase)})
    lost = np.flatnonzero(~np.isfinite(view.projector_px).all(axis=1))
    assert {5, 40} <= set(lost)
    assert view.problems[-1] == f"the projector's place is unknown at {len(lost)} of 63 points"
    kept = np.isfinite(view.projector_px).all(axis=1)
    off = (view.projector_px - projected(SCENE.places(view.camera_px)))[kept]
    assert np.abs(off).max() < 0.05


def test_phase_that_is_nowhere_known_leaves_the_cameras_side(maps):
    view = view_of(changed(maps, phase_rad=np.full((400, 800), np.nan, np.float32)))
    assert view.found
    assert not np.isfinite(view.projector_px).any()
    assert "unknown at 63 of 63" in view.problems[-1]


def test_limits_are_those_that_were_asked_for(maps):
    assert "at most 10 are useful" in view_of(maps, max_tilt_deg=10.0).reason
    assert view_of(maps, max_blur_px=0.2).problems[0].startswith("blurred")
    part = {name: crop(one) for name, one in maps.items()}
    assert view_of(part).found
    assert "at least 60 are needed" in view_of(part, min_points=60).reason


def crop(one):
    parts = ("phase_rad", "modulation", "background", "rejected", "sigma_rad")
    return replace(one, **{name: np.ascontiguousarray(getattr(one, name)[:, :520]) for name in parts})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda maps: {"columns": maps["rows"], "rows": maps["columns"]}, "swapped"),
        (lambda maps: {"columns": maps["columns"], "rows": maps["columns"]}, "swapped"),
        (lambda maps: changed(maps, kind="wrapped"), "needs absolute phases"),
        (lambda maps: {"columns": maps["columns"], "rows": crop(maps["rows"])}, "two poses"),
        (lambda maps: {"rows": maps["rows"]}, "takes the PhaseMaps"),
        (lambda maps: {}, "takes the PhaseMaps"),
    ],
)
def test_inputs_that_cannot_be_meant_are_errors(maps, change, message):
    with pytest.raises(DataError, match=message):
        view_of(change(maps))


def test_kernels_compile_without_a_picture():
    DetectBoard.compile_kernels()
