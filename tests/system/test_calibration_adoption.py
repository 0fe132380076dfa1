"""A calibration put in force stays so: over a restart, over SIGKILL; one that does not fit is refused."""

from __future__ import annotations

import signal
from dataclasses import replace

import numpy as np
import pytest
from daemonkit import SMALL, Daemon

from fringed.data import Lens
from fringed.errors import DataError, LeaseError, NotFound, UsageError
from fringed_client.calibration_file import calibration_of, save_calibration


def moved(calibration, mm):
    """Return a calibration with another baseline."""
    transform = calibration.T_projector_camera.copy()
    transform[0, 3] += mm
    return replace(calibration, T_projector_camera=transform, source="calibrated", id="", residuals={})


def in_force(station):
    return station.request("calibration")["in_force"]


@pytest.fixture
def daemon(tmp_path):
    running = Daemon(tmp_path).until_ready()
    yield running
    running.end()


def test_an_adopted_calibration_survives_a_kill_and_reverting_goes_back(tmp_path):
    first = Daemon(tmp_path).until_ready()
    with first.client() as station:
        exact = calibration_of(station)
        a, b = (station.add(moved(exact, mm)) for mm in (1.0, 2.0))
        station.request("calibration.use", id=a)
        told = station.request("calibration.use", id=b)["in_force"]
        assert told["hash"] == moved(exact, 2.0).hash == station.status().calibration
        assert b in station.status().calibration_origin
    first.end(signal.SIGKILL)
    second = Daemon(tmp_path).until_ready()
    try:
        with second.client() as station:
            assert in_force(station)["hash"] == moved(exact, 2.0).hash
            assert station.request("calibration")["adopted"] == [b, a]
            assert station.request("calibration.revert")["in_force"]["hash"] == moved(exact, 1.0).hash
            assert station.request("calibration.revert")["in_force"]["hash"] == exact.hash
            with pytest.raises(UsageError, match="none to go back from"):
                station.request("calibration.revert")
            assert [act["action"] for act in station.request("calibration")["history"]] == [
                "revert", "revert", "use", "use",
            ]  # fmt: skip
    finally:
        second.end()


def test_use_is_announced_and_names_the_next_frames(daemon):
    daemon.until_worker()
    with daemon.client() as station:
        other = moved(calibration_of(station), 0.5)
        item = station.add(other)
        with station.subscribe("event") as events:
            station.request("status")
            station.request("calibration.use", id=item)
            event = next(m.content for m in events if m.content.name == "calibration.adopted")
        assert event.detail["hash"] == other.hash and event.detail["by"]
        frames = station.scan("hierarchical", process=False).frame_sets["object"]
        assert frames.provenance.calibration == other.hash


def test_a_calibration_of_another_rig_or_size_is_refused_with_both_values(daemon):
    with daemon.client() as station:
        exact = calibration_of(station)
        foreign = station.add(replace(exact, rig="bench-7", id=""))
        lens = Lens(640, 480, exact.camera.matrix, exact.camera.distortion)
        wide = station.add(replace(exact, camera=lens, id=""))
        small = station.add(replace(exact, projector=lens, id=""))
        for item, values in ((foreign, ("bench-7", exact.rig)), (wide, ("640 x 480", "160 x 120")),
                             (small, ("640 x 480", "1024 x 768"))):  # fmt: skip
            with pytest.raises(DataError) as refused:
                station.request("calibration.use", id=item)
            assert all(value in str(refused.value) for value in values)
        with pytest.raises(NotFound):
            station.request("calibration.use", id="20200101T000000.000000Z-0000")
        assert in_force(station)["hash"] == exact.hash and not station.request("calibration")["history"]


def test_who_does_not_hold_the_rig_cannot_change_its_calibration(daemon):
    with daemon.client() as holder, daemon.client() as other, holder.lease("calibration"):
        item = other.add(moved(calibration_of(other), 1.0))
        with pytest.raises(LeaseError, match="calibration"):
            other.request("calibration.use", id=item)
        holder.request("calibration.use", id=item)
        assert in_force(other)["id"] == item


def test_a_configured_file_wins_and_says_so(tmp_path, daemon):
    with daemon.client() as station:
        exact = calibration_of(station)
        item = station.add(moved(exact, 3.0))
        station.request("calibration.use", id=item)
        named = station.add(moved(exact, 4.0))
        source = next((tmp_path / "data").rglob(f"{named}.*.h5"))
        daemon.config.write_text(SMALL.replace('"simulated"', f'"{source}"', 1))
        station.request("reload")
        assert in_force(station)["hash"] == moved(exact, 4.0).hash
        with pytest.raises(UsageError, match="names the file"):
            station.request("calibration.use", id=item)
        daemon.config.write_text(SMALL.replace('"simulated"', '""', 1))
        station.request("reload")
        assert in_force(station)["hash"] == ""
        with pytest.raises(UsageError, match="none for good"):
            station.request("calibration.use", id=item)
        daemon.config.write_text(SMALL.replace('"simulated"', '"adopted"', 1))
        station.request("reload")
        assert in_force(station)["id"] == item


def test_an_adopted_recording_that_is_gone_is_said_and_the_configured_one_holds(tmp_path):
    first = Daemon(tmp_path).until_ready()
    with first.client() as station:
        exact = calibration_of(station)
        item = station.add(moved(exact, 1.0))
        station.request("calibration.use", id=item)
    first.end()
    next((tmp_path / "data").rglob(f"{item}.*.h5")).unlink()
    second = Daemon(tmp_path).until_ready()
    try:
        with second.client() as station:
            told = in_force(station)
            assert told["hash"] == exact.hash and item in told["problem"]
            assert item in station.status().calibration_origin and "is not in force" in second.log
    finally:
        second.end()


def test_a_calibration_file_holds_every_number(tmp_path, daemon):
    from fringed.data import PixelModel, ViewFit
    from fringed_client.calibration_file import load_calibration

    with daemon.client() as station:
        exact = calibration_of(station)
    points = np.arange(8.0).reshape(4, 2)
    residual = points.copy()
    residual[1] = np.nan
    view = ViewFit("v", np.eye(4), points, residual, points, points, np.ones(4, np.uint8), "pose-01", "left out")
    model = PixelModel("polynomial", np.ones((3, 2, 2), np.float32), "columns", 16.0, 0.0, (900.0, 1100.0))
    whole = replace(
        exact, covariance=np.eye(2), parameters=("camera.fx", "camera.fy"), views=(view,), pixel_model=model,
        camera_falloff=np.array([-0.15]), projector_falloff=np.array([-0.1, 0.02]), temperature_c=21.5, notes=("n",),
    )  # fmt: skip
    loaded = load_calibration(save_calibration(whole, tmp_path / "c.json"))
    assert loaded.hash == whole.hash and loaded.temperature_c == 21.5 and loaded.notes == ("n",)
    np.testing.assert_array_equal(loaded.covariance, whole.covariance)
    np.testing.assert_array_equal(loaded.views[0].camera_residual_px, residual)
    assert loaded.views[0].used.dtype == np.uint8 and loaded.pixel_model.coefficients.dtype == np.float32
    np.testing.assert_array_equal(loaded.projector_falloff, whole.projector_falloff)
