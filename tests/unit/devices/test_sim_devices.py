"""The simulated camera and projector on one clock, each fault, and the building of devices."""

import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from fringed.config import StationConfig, simulated_station, validate
from fringed.data import CameraSettings, PatternFrame, PatternSequence
from fringed.devices.building import build_devices
from fringed.devices.camera.base import checked_image
from fringed.errors import (
    ConfigurationError,
    DeviceAbsent,
    DeviceStalled,
    NotFound,
    PluginError,
    ProtocolError,
    UsageError,
)
from fringed.hookspecs import Driver, Params
from fringed.loading import Catalogue

SMALL: dict[str, Any] = {
    "simulation": {
        "real_time": False,
        "noise": False,
        "projector": {"flicker": 0.0},
        "sensor": {"width_px": 116, "height_px": 87},
        "scene": {"object": "plane", "ambient": 0.0},
    },
    "camera": {"options": {"warm_up": False}},
}
LEVELS = (0, 255, 90, 200)
SETTLED_S = 2 / 60 + 0.010


def flat(levels=LEVELS):
    patterns = tuple(np.full((1, 1, 1), level, np.uint8) for level in levels)
    return PatternSequence("flat", 1024, 768, tuple(PatternFrame("flat") for _ in levels), patterns)


@pytest.fixture
def station():
    devices = build_devices(simulated_station(SMALL))
    devices.camera.open()
    devices.projector.open()
    devices.projector.load(flat(), "object")
    yield devices
    devices.camera.close()
    devices.projector.close()


def arm(station, trigger="software"):
    return station.camera.arm(CameraSettings(channel="green", trigger=trigger, exposure_us=8333.333))


def take(station, index, timeout_s=2.0):
    """Show a pattern, wait until it must be there, trigger and read."""
    station.projector.show(index)
    station.camera.clock.sleep(SETTLED_S)
    station.camera.trigger()
    return station.camera.read(timeout_s)


def middle(frame):
    return float(frame.image[40:47, 55:61].mean())


@pytest.fixture
def clean(station):
    """The brightness of each pattern when nothing goes wrong."""
    arm(station)
    values = [middle(take(station, k)) for k in range(4)]
    assert values[0] < values[2] < values[3] < values[1]
    return values


def test_a_late_pattern_is_confirmed_and_shows_the_one_before(station, clean):
    station.rig.order_fault("late", 1)
    assert middle(take(station, 1)) == pytest.approx(clean[3], abs=1)
    station.camera.clock.sleep(0.2)
    station.camera.trigger()
    assert middle(station.camera.read(1.0)) == pytest.approx(clean[1], abs=1)
    assert middle(take(station, 2)) == pytest.approx(clean[2], abs=1)


def test_a_repeated_frame_has_the_old_picture_and_a_new_counter(station, clean):
    before = take(station, 1)
    station.rig.order_fault("repeated", 1)
    frame = take(station, 2)
    assert (frame.image == before.image).all()
    assert frame.counter == before.counter + 1
    assert frame.exposure_start_s > before.exposure_start_s
    assert middle(take(station, 2)) == pytest.approx(clean[2], abs=1)


def test_a_blended_frame_is_between_two_patterns(station, clean):
    take(station, 0)
    station.rig.order_fault("blended", 1)
    share = (middle(take(station, 1)) - clean[0]) / (clean[1] - clean[0])
    assert 0.28 < share < 0.72
    assert middle(take(station, 2)) == pytest.approx(clean[2], abs=1)


def test_a_torn_frame_is_new_above_and_old_below(station, clean):
    take(station, 0)
    station.rig.order_fault("torn", 1)
    image = take(station, 1).image.astype(float)
    assert image[5, 58] > 0.7 * clean[1]
    assert image[-5, 58] < clean[0] + 3
    column = image[:, 58] > 0.4 * clean[1]
    assert np.count_nonzero(np.diff(column.astype(int))) == 1


def test_faults_strike_the_frame_of_a_pattern_that_another_one_was_shown_ahead_of(station, clean):
    take(station, 0)
    station.rig.order_fault("blended", 1)
    station.projector.show(1)
    station.camera.clock.sleep(SETTLED_S)
    station.camera.trigger()
    station.camera.clock.sleep(0.02)
    station.projector.show(2)
    share = (middle(station.camera.read(2.0)) - clean[0]) / (clean[1] - clean[0])
    assert 0.28 < share < 0.72


def test_a_dropped_frame_is_missing_in_the_counter(station, clean):
    first = take(station, 0)
    station.rig.order_fault("dropped", 1)
    second = take(station, 1)
    assert second.counter == first.counter + 2
    assert middle(second) == pytest.approx(clean[1], abs=1)
    assert take(station, 2).counter == second.counter + 1


def test_a_dropped_frame_of_a_free_running_camera_costs_a_period(station):
    arm(station, "free-running")
    station.projector.show(0)
    station.camera.clock.sleep(0.5)
    first = station.camera.read(1.0)
    station.rig.order_fault("dropped", 1)
    while (second := station.camera.read(1.0)).counter == first.counter + 1:
        first = second
    assert second.counter == first.counter + 2
    assert second.exposure_start_s - first.exposure_start_s == pytest.approx(2 * 0.1335)


def test_a_vanished_camera_is_absent_until_it_is_opened_again(station, clean):
    station.rig.order_fault("vanish", 1)
    with pytest.raises(DeviceAbsent, match="vanished"):
        take(station, 1)
    for use in (lambda: station.camera.read(1.0), station.camera.trigger, lambda: arm(station)):
        with pytest.raises(DeviceAbsent, match="open"):
            use()
    station.camera.open()
    arm(station)
    assert middle(take(station, 1)) == pytest.approx(clean[1], abs=1)


def test_a_stalled_camera_takes_the_whole_time_out(station, clean):
    station.rig.order_fault("stall", 1)
    before = station.camera.clock.now()
    with pytest.raises(DeviceStalled, match=r"1\.5 s"):
        take(station, 1, timeout_s=1.5)
    assert station.camera.clock.now() - before >= 1.5
    assert middle(take(station, 1)) == pytest.approx(clean[1], abs=1)


def test_garbage_is_a_protocol_error_whatever_it_looks_like(station, clean):
    station.rig.order_fault("garbage", 12)
    seen = set()
    for _ in range(12):
        with pytest.raises(ProtocolError) as caught:
            take(station, 1)
        seen.add(str(caught.value).split(";")[0])
    assert len(seen) == 3
    assert middle(take(station, 1)) == pytest.approx(clean[1], abs=1)


def test_faults_come_by_chance_as_often_as_configured():
    table = {**SMALL, "simulation": {**SMALL["simulation"], "faults": {"garbage": 0.3}}}
    runs = []
    for _ in range(2):
        devices = build_devices(simulated_station(table))
        devices.camera.open()
        devices.camera.arm(CameraSettings(channel="green"))
        struck = []
        for _ in range(100):
            try:
                devices.camera.read(1.0)
                struck.append(False)
            except ProtocolError:
                struck.append(True)
        runs.append(struck)
        devices.camera.close()
    assert 12 <= sum(runs[0]) <= 50
    assert runs[0] == runs[1]


def test_free_running_frames_lie_on_a_grid_and_waiting_costs_frames(station):
    arm(station, "free-running")
    frames = [station.camera.read(1.0) for _ in range(3)]
    start = frames[0].exposure_start_s
    assert [f.exposure_start_s - start for f in frames] == pytest.approx([0, 0.1335, 0.267])
    station.camera.clock.sleep(1.4)  # ten frames pass; three wait, the older seven are lost
    late = station.camera.read(1.0)
    assert (late.exposure_start_s - start) / 0.1335 == pytest.approx(late.counter - frames[0].counter)
    assert late.counter == frames[2].counter + 8


def test_a_free_running_camera_blends_patterns_when_nobody_waits(station, clean):
    arm(station, "free-running")
    seen = set()
    for k in range(40):
        station.projector.show(k % 2)
        seen.add(round(middle(station.camera.read(1.0)), 1))
    between = [v for v in seen if clean[0] + 5 < v < clean[1] - 5]
    assert between


def test_an_exposure_longer_than_the_period_stretches_it(station):
    station.camera.arm(CameraSettings(exposure_us=300000.0, channel="green"))
    assert station.camera.period_s == pytest.approx(0.3)
    a, b = station.camera.read(1.0), station.camera.read(1.0)
    assert b.exposure_start_s - a.exposure_start_s == pytest.approx(0.3)


def test_a_free_running_camera_cannot_be_triggered(station):
    arm(station, "free-running")
    with pytest.raises(UsageError, match="trigger"):
        station.camera.trigger()


def test_unquantised_frames_say_so_in_the_settings():
    table = {**SMALL, "simulation": {**SMALL["simulation"], "quantise": False}}
    camera = build_devices(simulated_station(table)).camera
    camera.open()
    assert camera.arm(CameraSettings(bits=8, channel="green")).bits == 16
    assert camera.read(1.0).image.dtype == np.uint16
    camera.close()


def test_in_real_time_frames_come_no_sooner_than_they_would():
    simulation = {**SMALL["simulation"], "real_time": True}
    simulation["sensor"] = {**simulation["sensor"], "period_s": 0.03}
    devices = build_devices(simulated_station({**SMALL, "simulation": simulation}))
    devices.camera.open()
    arm(devices, "free-running")
    before = time.monotonic()
    frames = [devices.camera.read(5.0) for _ in range(4)]
    assert time.monotonic() - before >= 3 * 0.03 + 0.008
    assert all(f.exposure_end_s <= devices.camera.clock.now() for f in frames)
    devices.camera.close()


def test_warming_up_ends_with_the_camera():
    table = {**SMALL, "camera": {"options": {"warm_up": True}}}
    camera = build_devices(simulated_station(table)).camera
    camera.open()
    camera.close()


@pytest.mark.parametrize(
    ("image", "bits", "good"),
    [
        (np.zeros((4, 6), np.uint8), 8, True),
        (np.full((4, 6), 1023, np.uint16), 10, True),
        (np.full((4, 6), 1024, np.uint16), 10, False),
        (np.zeros((6, 4), np.uint8), 8, False),
        (np.zeros((4, 6), np.uint16), 8, False),
        (None, 8, False),
    ],
)
def test_an_image_is_checked_before_it_is_passed_on(image, bits, good):
    if good:
        assert checked_image(image, (6, 4), bits) is image
    else:
        with pytest.raises(ProtocolError, match="delivered"):
            checked_image(image, (6, 4), bits)


def test_what_is_not_configured_is_absent_and_says_what_to_do():
    devices = build_devices(validate({"pipelines": {}}, StationConfig))
    assert devices.rig is None
    assert not devices.camera.simulated
    assert not devices.projector.simulated
    with pytest.raises(DeviceAbsent, match=r"camera\.driver"):
        devices.camera.open()
    with pytest.raises(DeviceAbsent, match=r"projector\.driver"):
        devices.projector.open()
    devices.camera.close()
    devices.projector.close()


class _Options(Params, frozen=True, kw_only=True):
    port: str = "a"


@dataclass
class _Told:
    options: Any
    context: Any


def _catalogue(create):
    return Catalogue(provided={"camera": {"acme": Driver("acme", _Options, create)}})


def plugged(**options):
    return validate({"name": "lab", "camera": {"driver": "acme", "options": options}}, StationConfig)


def test_a_plug_ins_driver_is_built_with_checked_options():
    camera = build_devices(plugged(port="b"), lambda: _catalogue(_Told)).camera
    assert camera.options.port == "b"
    assert camera.context.station == "lab"
    assert camera.context.clock.now() > 0
    with pytest.raises(ConfigurationError, match=r"camera\.options\.speed"):
        build_devices(plugged(speed=3), lambda: _catalogue(_Told))


def test_a_driver_that_nobody_has_or_that_breaks_is_named():
    with pytest.raises(NotFound, match="acme"):
        build_devices(plugged(), Catalogue)

    def broken(options, context):
        raise RuntimeError("no licence")

    with pytest.raises(PluginError, match=r"acme.*no licence"):
        build_devices(plugged(), lambda: _catalogue(broken))


def test_plug_ins_are_not_loaded_for_our_own_drivers():
    def never():
        raise AssertionError("plug-ins were loaded")

    assert build_devices(simulated_station(SMALL), never).rig is not None


def test_a_replay_takes_the_place_of_both_devices():
    pair = (object(), object())
    config = validate({"camera": {"driver": "replay"}, "projector": {"driver": "replay"}}, StationConfig)
    devices = build_devices(config, make_replay=lambda _: pair)
    assert (devices.camera, devices.projector, devices.rig) == (*pair, None)
    with pytest.raises(ConfigurationError, match="replay"):
        build_devices(config)


def test_options_that_no_simulated_device_has_are_refused():
    for kind in ("camera", "projector"):
        table = {**SMALL, kind: {"driver": "sim", "options": {"speed": 3}}}
        with pytest.raises(ConfigurationError, match=rf"{kind}\.options\.speed"):
            build_devices(simulated_station(table))


def test_building_a_simulated_station_waits_for_no_compiler():
    code = (
        "import sys; from fringed.config import simulated_station; from fringed.devices.building import build_devices; "
        "d = build_devices(simulated_station()); d.projector.open(); d.rig.calibration(); "
        "sys.exit(any(name in sys.modules for name in ('numba', 'scipy', 'cv2')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
