"""A rig that an independent renderer shows, with conventions of its own, calibrated from its pictures and phases."""

from __future__ import annotations

import numpy as np
import pytest

from fringed.boards import Board
from fringed_plugins.calibrators.calibrate import Calibrate
from fringed_plugins.calibrators.detect_board import DetectBoard
from independent_board import Beamer, Bench, Glass, Stand, camera_of, phase_maps, pose_of, projector_of

BENCH = Bench(
    Glass(640, 480, 17.0, 1.004, (0.012, -0.018), (-0.0035, 0.0004), (2e-4, -3e-4), 0.15),
    Beamer(
        Glass(1024, 768, 15.5, 1.0, (0.01, 0.02), (0.004, 0.0), (-1e-4, 2e-4), 0.15),
        (0.27, 0.04, 0.01),
        (0.01, 0, -1),
        1.5,
    ),
)
STANDS = [
    Stand((x / 1000, y / 1000, -z / 1000), angles)
    for x, y, z, angles in (
        (0, 0, 1000, (4, -3, 2)), (40, 15, 930, (25, 8, -5)), (-45, 20, 960, (-28, -6, 4)),
        (30, -25, 1080, (5, 27, 88)), (-35, -20, 1060, (-6, -29, -4)), (0, 10, 900, (20, 20, 10)),
        (10, -10, 1100, (-22, 18, -12)), (55, 30, 1120, (12, -24, 5)), (-50, 35, 1100, (-14, -22, 92)),
        (-20, -35, 1090, (30, 5, 176)),
    )
]  # fmt: skip


class Quiet:
    """What a processor is told of its job."""

    threads = 2

    def progress(self, fraction, text=""):
        pass

    def log(self, level, text):
        pass


@pytest.fixture(scope="module")
def views():
    found = []
    for number, stand in enumerate(STANDS):
        maps = phase_maps(BENCH, BENCH.shoot(stand, seed=number))
        found.append(DetectBoard().run(maps, DetectBoard.Params(board=Board(), name=f"pose {number}"), Quiet()))
    return found


@pytest.fixture(scope="module")
def calibration(views):
    return Calibrate().run({"views": views}, Calibrate.Params(), Quiet())


def numbers(lens):
    return [lens.matrix[0, 0], lens.matrix[1, 1], lens.matrix[0, 2], lens.matrix[1, 2], *lens.distortion]


def rims(view, stand):
    """Return the middle (n, 2), in the house's pixels, of the area inside each circle's rim as the camera sees it."""
    turn, found = np.linspace(0, 2 * np.pi, 200, endpoint=False), []
    for index in view.index:
        row, column = divmod(int(index), 13)
        x, y = (column - 6) * BENCH.board.pitch, (4 - row) * BENCH.board.pitch
        radius = -BENCH.board.outside(np.array([x, y]))
        rim = np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn), np.zeros(200)])
        s, t = BENCH.camera.place(rim @ stand.turn().T + np.array(stand.at)).T
        cross = s * np.roll(t, -1) - np.roll(s, -1) * t
        middle = [((one + np.roll(one, -1)) * cross).sum() / (3 * cross.sum()) for one in (s, t)]
        found.append([middle[0] - 0.5, BENCH.camera.height - middle[1] - 0.5])
    return np.array(found)


def test_every_pose_is_found_and_numbered(views):
    assert all(view.found for view in views), [view.reason for view in views]
    assert min(len(view.index) for view in views) >= 105  # one or two poses reach over the picture's edge
    for view, stand in zip(views, STANDS, strict=True):
        assert np.abs(view.camera_px - rims(view, stand)).max() < 0.5


def test_centres_are_those_of_the_circles_rims(views):
    off = np.concatenate([view.camera_px - rims(view, stand) for view, stand in zip(views, STANDS, strict=True)])
    # An edge of 100 rays for a pixel is good to 0.03 of a pixel, a circle's 40 of them to 0.005.
    assert np.sqrt((off**2).mean()) < 0.01 and np.abs(off.mean(axis=0)).max() < 0.002


def test_the_projectors_place_at_each_point_is_the_renderers(views):
    normal = []
    for view, stand in zip(views, STANDS, strict=True):
        st = np.column_stack([view.camera_px[:, 0] + 0.5, BENCH.camera.height - view.camera_px[:, 1] - 0.5])
        lit = BENCH.beamer.place(BENCH._hit(BENCH.camera.rays(st), stand)[0])
        off = view.projector_px - np.column_stack([lit[:, 0] - 0.5, BENCH.beamer.glass.height - lit[:, 1] - 0.5])
        assert np.abs(off.mean(axis=0)).max() < 0.002
        normal.append(off / view.projector_sigma_px)
    assert 0.85 < np.concatenate(normal).std() < 1.2


def test_calibration_agrees_with_the_renderers_parameters(calibration):
    projector, T = projector_of(BENCH)
    sigma = dict(zip(calibration.parameters, np.sqrt(np.diag(calibration.covariance)), strict=True))
    keys = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")  # k3 is nothing here, and is not estimated
    for name, found, true in (
        ("camera", calibration.camera, camera_of(BENCH)), ("projector", calibration.projector, projector),
    ):  # fmt: skip
        off = np.subtract(numbers(found), numbers(true))
        of_sigma = {key: off[k] / sigma[f"{name}.{key}"] for k, key in enumerate(keys)}
        assert max(map(abs, of_sigma.values())) < 4, (name, of_sigma)
        assert np.abs(off[:2] / found.matrix[0, 0]).max() < 1e-4 and np.abs(off[2:4]).max() < 0.3
    moved = calibration.T_projector_camera - T
    assert np.abs(moved[:3, :3]).max() < 1e-4
    allowed = [4 * sigma[f"stereo.t{axis}"] for axis in "xyz"]
    assert (np.abs(moved[:3, 3]) < allowed).all(), (moved[:3, 3], allowed)
    baseline = [np.linalg.norm(one[:3, 3]) for one in (calibration.T_projector_camera, T)]
    assert baseline[0] == pytest.approx(baseline[1], rel=1e-4)


def test_poses_and_residuals_are_the_renderers(calibration):
    assert calibration.residuals["camera_rms_px"] < 0.01 and calibration.residuals["projector_rms_px"] < 0.02
    for fit, stand in zip(calibration.views, STANDS, strict=True):
        off = fit.T_camera_board - pose_of(stand)
        assert not fit.note and np.abs(off[:3, :3]).max() < 2e-4 and np.abs(off[:3, 3]).max() < 0.1
