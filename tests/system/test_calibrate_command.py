"""`fringe calibrate` on a small simulated station and on folders: from poses to a calibration in force."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from daemonkit import Daemon

from fringed_client.calibration_file import calibration_of, load_calibration

CONFIG = """
name = "small"
calibration = "simulated"
[log]
level = "warning"
[camera]
driver = "sim"
[projector]
driver = "sim"
[workers]
count = 1
[acquisition]
latency_s = 0.05
[simulation]
real_time = false
[simulation.sensor]
width_px = 464
height_px = 348
[simulation.scene]
object = "plane"
"""
POSES = 6
pytestmark = pytest.mark.timeout(400)  # kernels may have to be compiled first


@pytest.fixture(scope="module")
def station_daemon(tmp_path_factory):
    daemon = Daemon(tmp_path_factory.mktemp("calibrate"), CONFIG).until_ready().until_worker()
    yield daemon
    daemon.end()


def fringe(daemon, *args, cwd, code=0, **more):
    """Run a command on the station; returns its JSON document."""
    done = subprocess.run(
        [sys.executable, "-m", "fringed_client.cli.main", *map(str, args), "--json"], cwd=cwd, env=daemon.env,
        capture_output=True, text=True, timeout=280, check=False, **more,
    )  # fmt: skip
    assert done.returncode == code, f"{done.stdout}\n{done.stderr}\n{daemon.log}"
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def calibrated(station_daemon, tmp_path_factory):
    """Return the document and the folder of one calibration, written as a capture folder as well, put in force."""
    folder = tmp_path_factory.mktemp("first")
    with station_daemon.client() as station:
        exact = calibration_of(station)
    told = fringe(
        station_daemon, "calibrate", "--simulated", "--poses", POSES, "--use", "--temperature", "21.5",
        "--write", folder / "poses", "-o", folder / "out", cwd=folder,
    )  # fmt: skip
    return told, folder, exact


def test_a_simulated_rig_calibrates_itself_and_works_with_the_result(station_daemon, calibrated):
    told, folder, exact = calibrated
    found = load_calibration(folder / "out" / "calibration.json")
    assert told["hash"] == found.hash == told["in_force"]["hash"] != exact.hash
    assert found.temperature_c == 21.5 and found.rig == exact.rig and len(told["views"]) == POSES
    assert abs(found.camera.matrix[0, 0] / exact.camera.matrix[0, 0] - 1) < 2e-3
    page = (folder / "out" / "report.html").read_text()
    assert all(view["name"] in page for view in told["views"]) and "SIMULATED" in page
    with station_daemon.client() as station:
        assert station.status().calibration == found.hash
        result = station.scan("hierarchical", truth=True)
        image, truth = result.range_image, result.truth
    assert image.calibration == found.hash
    kept = (image.rejected == 0) & (truth.is_object > 0) & (truth.lit > 0)
    assert kept.mean() > 0.5  # the plane stands there again
    # 64 periods of 4 steps leave 0.05 mm of noise at each pixel; the calibration's own error comes on top.
    off = np.linalg.norm(image.xyz_mm - truth.xyz_mm, axis=2)[kept]
    assert np.median(off) < 0.2


def test_recorded_views_give_the_same_calibration_again(station_daemon, calibrated, tmp_path):
    told, _, _ = calibrated
    views = [arg for view in reversed(told["views"]) for arg in ("--views", view["id"])]
    again = fringe(station_daemon, "calibrate", *views, "-o", tmp_path / "again", "--temperature", "21.5", cwd=tmp_path)
    assert again["residuals"]["camera_rms_px"] == pytest.approx(told["residuals"]["camera_rms_px"], rel=1e-3)
    first, second = (load_calibration(f) for f in (calibrated[1] / "out" / "calibration.json",
                                                   tmp_path / "again" / "calibration.json"))  # fmt: skip
    np.testing.assert_allclose(first.camera.matrix, second.camera.matrix, rtol=1e-5)


def test_a_folder_of_poses_gives_the_calibration_that_the_station_found(station_daemon, calibrated, tmp_path):
    _, folder, exact = calibrated
    told = fringe(station_daemon, "calibrate", folder / "poses", "-o", tmp_path / "out", cwd=tmp_path)
    found = load_calibration(tmp_path / "out" / "calibration.json")
    first = load_calibration(folder / "out" / "calibration.json")
    assert found.rig == exact.rig and len(told["views"]) == POSES
    np.testing.assert_allclose(found.camera.matrix, first.camera.matrix, rtol=1e-3)
    truth = json.loads((folder / "poses" / "truth.json").read_text())["T_camera_board"]
    for fit in found.views:
        assert np.linalg.norm(fit.T_camera_board[:3, 3] - np.array(truth[fit.name])[:3, 3]) < 2.0  # of 1000 mm
    assert load_calibration(folder / "poses" / "calibration-truth.json").hash == exact.hash


def test_calibrations_are_listed_compared_and_reverted(station_daemon, calibrated, tmp_path):
    told, _, exact = calibrated
    listed = fringe(station_daemon, "calibration", "list", cwd=tmp_path)
    row = next(one for one in listed["calibrations"] if one["id"] == told["calibration"])
    assert row["state"] == "in force" and row["views"] == str(POSES)
    shown = fringe(station_daemon, "calibration", "show", told["calibration"], cwd=tmp_path)
    assert shown["in_force"] and shown["temperature_c"] == 21.5
    assert fringe(station_daemon, "calibration", "compare", told["calibration"], "current", cwd=tmp_path)
    back = fringe(station_daemon, "calibration", "revert", cwd=tmp_path)
    assert back["in_force"]["hash"] == exact.hash
    again = fringe(station_daemon, "calibration", "use", calibrated[1] / "out" / "calibration.json", cwd=tmp_path)
    assert again["in_force"]["hash"] == told["hash"]


def test_an_interrupted_session_goes_on_where_it_was(station_daemon, tmp_path):
    with station_daemon.client() as station:
        before = len(station.list(kind="BoardView", limit=1000))
        command = ["calibrate", "--simulated", "--poses", "6", "--pipeline", "board"]
        process = subprocess.Popen(
            [sys.executable, "-m", "fringed_client.cli.main", *command], cwd=tmp_path, env=station_daemon.env,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        deadline = time.monotonic() + 120
        while len(station.list(kind="BoardView", limit=1000)) < before + 2 and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=30)[0]
        assert process.returncode == 130 and "--resume" in said
        deadline = time.monotonic() + 30
        while station.status().scan:  # what had been taken is still looked at
            assert time.monotonic() < deadline
            time.sleep(0.05)
        rows = station.list(kind="BoardView", limit=1000)
        kept = {row["id"] for row in rows[: len(rows) - before]}
        assert station.status().lease is None
    told = fringe(
        station_daemon, "calibrate", "--simulated", "--poses", 6, "--resume", "-o", tmp_path / "o", cwd=tmp_path
    )
    assert {view["name"] for view in told["views"]} == {f"pose-{n:02d}" for n in range(1, 7)}
    assert kept <= {view["id"] for view in told["views"]}


def test_what_is_no_board_is_said_and_ends_with_the_quality_code(station_daemon, tmp_path):
    error = fringe(
        station_daemon, "calibrate", "--poses", 5, "--every", 0, "-o", tmp_path / "o", cwd=tmp_path, code=5
    )["error"]  # fmt: skip
    assert "10 times" in error["message"] and "--resume" in error["message"]
    assert len(list((tmp_path / "o" / "poses").glob("*.png"))) == 1


def test_a_person_is_led_and_may_end_early(station_daemon, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "fringed_client.cli.main", "calibrate"], cwd=tmp_path, env=station_daemon.env,
        input="d\n", capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 5 and "middle of the picture, tilted by 25 degrees" in done.stderr + done.stdout
    assert "0 of 0 poses" in done.stderr


@pytest.mark.parametrize(("args", "said"), [
    (["--simulated", "--views", "x"], "give one"), (["--write", "f"], "--write goes with"),
    (["--board", "kind=squares"], "board"), (["--views", "20200101T000000.000000Z-0000"], "nothing is recorded"),
])  # fmt: skip
def test_what_cannot_be_meant_is_refused_before_anything_is_taken(station_daemon, tmp_path, args, said):
    done = subprocess.run(
        [sys.executable, "-m", "fringed_client.cli.main", "calibrate", *args], cwd=tmp_path, env=station_daemon.env,
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode in (1, 2) and said in done.stderr and not list(tmp_path.iterdir())


def test_one_pose_puts_a_nudged_projector_right(station_daemon, calibrated, tmp_path):
    """The calibration in force is made to look as if the projector had been nudged since; a pose says by how much."""
    from dataclasses import replace

    from fringed_client.calibration_file import save_calibration

    good = load_calibration(calibrated[1] / "out" / "calibration.json")
    turn, (c, s) = np.eye(4), (np.cos(1e-3), np.sin(1e-3))
    turn[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    off = replace(good, T_projector_camera=turn @ good.T_projector_camera, id="")
    nudged = save_calibration(off, tmp_path / "nudged.json")
    fringe(station_daemon, "calibration", "use", nudged, cwd=tmp_path)
    view = calibrated[0]["views"][0]["id"]
    told = fringe(station_daemon, "calibration", "correct", "--view", view, "--use", cwd=tmp_path)
    assert told["infield_turned_deg"] == pytest.approx(np.rad2deg(1e-3), rel=0.2)
    assert told["in_force"]["hash"] == told["hash"] != off.hash
    with station_daemon.client() as station:
        found = calibration_of(station)
    turned = found.T_projector_camera[:3, :3] @ good.T_projector_camera[:3, :3].T
    assert np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1)) < 1e-4
    for _ in range(2):
        fringe(station_daemon, "calibration", "revert", cwd=tmp_path)
