"""The driver `gige` against Debian's GigE Vision camera in software: its bytes, over real sockets."""

import contextlib
import threading
import time

import numpy as np
import pytest
from gigekit import ADDRESS, FakeCamera, missing

from fringed.config import validate
from fringed.data import CameraSettings
from fringed.devices.building import DriverContext
from fringed.devices.camera.base import MachineClock
from fringed.devices.camera.gige import GIGE
from fringed.devices.camera.gige_aravis import AravisPort
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError

WIDTH, HEIGHT = 64, 48
SMALL = {"device": ADDRESS, "width_px": WIDTH, "height_px": HEIGHT, "fps": 200.0}
WHY_NOT = missing()
pytestmark = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT or "-")


@pytest.fixture
def plug():
    plugged = []

    def plug_in(**kind):
        plugged.append(FakeCamera(**kind))
        return plugged[-1]

    yield plug_in
    for camera in plugged:
        camera.unplug()


@pytest.fixture
def make():
    made = []

    def build(**options):
        validated = validate({**SMALL, **options}, GIGE.Options, "camera.options")
        made.append(GIGE.create(validated, DriverContext("rig", MachineClock())))
        return made[-1]

    yield build
    for camera in made:
        camera.close()
    for thread in threading.enumerate():
        if thread.name == "gige-release":  # Aravis takes its time to part from a camera that is gone
            thread.join(30)


@pytest.fixture
def opened(plug, make):
    plug()
    camera = make()
    camera.open()
    return camera


def arm(camera, **settings):
    return camera.arm(CameraSettings(**{"exposure_us": 2000.0, "channel": "white", **settings}))


def read_many(camera, count, timeout_s=10.0):
    return [camera.read(timeout_s) for _ in range(count)]


def trigger_until_something_comes(camera):
    for _ in range(50):  # a frame of which not one packet came is no frame at all
        camera.trigger()
        with contextlib.suppress(DeviceStalled):
            return camera.read(0.5)
    return None


def test_it_is_found_by_address_by_name_and_alone(plug, make):
    plug()
    for device in (ADDRESS, "Aravis-Fake-T1", "T1", ""):
        camera = make(device=device)
        assert camera.open() == "Aravis Fake T1 at 127.0.0.1"
        camera.close()


def test_what_is_there_is_listed(plug):
    plug()
    found = [(one.id, one.serial, one.address, one.protocol) for one in AravisPort().found()]
    assert found == [("Aravis-Fake-T1", "T1", ADDRESS, "GigEVision")]


def test_a_camera_that_is_not_there_is_absent_and_what_is_there_is_listed(plug, make):
    with pytest.raises(DeviceAbsent, match="None is found"):
        make().open()
    plug()
    with pytest.raises(DeviceAbsent, match="Aravis-Fake-T1"):
        make(device="Maker-Model-9").open()


def test_a_camera_that_another_program_controls_is_named(opened, make):
    with pytest.raises(DeviceAbsent, match="another program controls"):
        make().open()
    arm(opened)
    assert opened.read(10.0)


def test_free_running_frames_have_counters_and_times(opened):
    settings = arm(opened)
    assert settings.exposure_us == 2000.0
    assert opened.size_px == (WIDTH, HEIGHT)
    assert opened.period_s == pytest.approx(1 / 200)
    frames = [opened.read(10.0) for _ in range(40)]
    for frame in frames:
        assert frame.image.shape == (HEIGHT, WIDTH)
        assert frame.image.dtype == np.uint8
        assert frame.exposure_end_s - frame.exposure_start_s == pytest.approx(0.003)  # and 1 ms of delay, at most
        assert frame.exposure_end_s <= opened.clock.now()
    counters = np.diff([frame.counter for frame in frames])
    assert (counters >= 1).all()
    starts = np.diff([frame.exposure_start_s for frame in frames])
    assert np.median(starts / counters) == pytest.approx(1 / 200, rel=0.1)
    moved = np.diff([int(frame.image[5, 5]) for frame in frames[10:20]])
    assert moved.any()  # the ramp moves from frame to frame


def test_counters_go_on_over_the_wrap_of_the_cameras_ids(plug, make):
    plug()
    camera = make(fps=1000.0)
    camera.open()
    arm(camera, exposure_us=100.0)
    counters = [camera.read(10.0).counter for _ in range(400)]  # its ids begin at 65400 and end at 65535
    assert (np.diff(counters) >= 1).all()
    assert counters[-1] - counters[0] < 30_000
    assert camera._ids._last < 60_000


def test_counters_go_on_when_it_is_armed_again(opened):
    arm(opened)
    first = opened.read(10.0).counter
    opened.disarm()
    arm(opened)
    assert opened.read(10.0).counter > first


def test_a_triggered_frame_begins_after_its_trigger_and_comes_alone(opened):
    arm(opened, trigger="software")
    for _ in range(5):
        asked = opened.clock.now()
        opened.trigger()
        frame = opened.read(10.0)
        assert frame.exposure_start_s >= asked
    with pytest.raises(DeviceStalled, match=r"0\.25 s: check that the trigger"):
        opened.read(0.25)
    opened.trigger()
    assert opened.read(10.0).counter == frame.counter + 1
    arm(opened)
    with pytest.raises(UsageError, match="runs freely"):
        opened.trigger()
    assert opened.read(10.0).image.shape == (HEIGHT, WIDTH)


@pytest.mark.parametrize(
    ("asked", "dtype", "channel"),
    [
        ({"bits": 16, "channel": "white"}, np.uint16, "white"),
        ({"channel": "rgb"}, np.uint8, "rgb"),
        ({"channel": "green"}, np.uint8, "green"),
    ],
)
def test_formats_and_channels(opened, asked, dtype, channel):
    settings = arm(opened, **asked)
    assert settings.channel == channel
    image = opened.read(10.0).image
    assert image.dtype == dtype
    assert image.shape == ((HEIGHT, WIDTH, 3) if channel == "rgb" else (HEIGHT, WIDTH))
    assert dtype == np.uint8 or image.max() > 255


def test_exposure_and_gain_reach_the_camera(opened):
    arm(opened, exposure_us=1000.0)
    dark = opened.read(10.0).image.astype(float).mean()
    arm(opened, exposure_us=10000.0)
    bright = opened.read(10.0).image.astype(float).mean()
    assert bright > 1.5 * dark


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"exposure_us": 1.0}, "has 10 to 1e.07"),
        ({"bits": 12}, r"no pixel format .* 12 bits; it has .*Mono8 \(8 bits\)"),
        ({"gain_db": 3.0}, "gain_step_db"),
        ({"trigger": "hardware"}, "cannot be triggered by 'Line1'; it has Line0, Software"),
    ],
)
def test_what_it_cannot_have_is_refused_with_what_it_can(opened, asked, words):
    with pytest.raises(UsageError, match=words):
        arm(opened, **asked)
    arm(opened)
    assert opened.read(10.0).image.shape == (HEIGHT, WIDTH)


def test_a_size_that_it_cannot_have_is_refused(plug, make):
    plug()
    camera = make(width_px=4096)
    camera.open()
    with pytest.raises(UsageError, match=r"Width of 4096 .* 1 to 2048"):
        arm(camera)


def test_with_lost_packets_no_broken_frame_is_delivered_and_the_loss_is_named(plug, make):
    plug(lost=50)
    camera = make(width_px=128, height_px=64)
    camera.open()
    arm(camera, exposure_us=10000.0)
    ramp = np.arange(128)[None] + np.arange(64)[:, None]
    for _ in range(100):
        image = camera.read(20.0).image.astype(int)
        assert (image == (ramp + image[0, 0]) % 255).all()  # what this camera shows: every pixel is known
    deadline = time.monotonic() + 20
    while not camera.incomplete and time.monotonic() < deadline:
        camera.read(20.0)
    assert sum(camera.incomplete.values()) > 0
    assert "packets are missing" in camera._losses()


def test_a_stream_that_loses_most_says_so(plug, make):
    plug(lost=900)
    camera = make(width_px=128, height_px=64)
    camera.open()
    arm(camera)
    with pytest.raises(DeviceStalled, match=r"came incomplete: \d+ (with missing packets|late).*rmem_max"):
        read_many(camera, 50, 1.0)


def test_a_triggered_frame_that_came_incomplete_is_named_at_once(plug, make):
    plug(lost=900)
    camera = make(width_px=256, height_px=256)
    camera.open()
    arm(camera, trigger="software")
    with pytest.raises(ProtocolError, match=r"frame \d+ came (with missing packets|late)"):
        trigger_until_something_comes(camera)


def test_unplugged_it_is_absent_and_plugged_in_again_it_comes_back(plug, make):
    fake = plug()
    camera = make()
    camera.open()
    arm(camera)
    camera.read(10.0)
    fake.unplug()
    with pytest.raises(DeviceAbsent, match="does not answer any more"):
        read_many(camera, 1000, 60.0)
    with pytest.raises(DeviceError):
        camera.read(1.0)
    with pytest.raises(DeviceAbsent):
        camera.open()
    plug()
    assert "Fake T1" in camera.open()
    arm(camera)
    assert camera.read(10.0).image.shape == (HEIGHT, WIDTH)


def test_unplugged_while_idle_open_finds_the_new_one(plug, make):
    fake = plug()
    camera = make()
    camera.open()
    fake.unplug()
    plug(serial="T2")
    assert "T2" in camera.open()
    arm(camera)
    assert camera.read(10.0)


def test_unplugged_while_armed_and_plugged_in_at_once_it_is_absent_once(plug, make):
    fake = plug()
    camera = make()
    camera.open()
    arm(camera, trigger="software")
    fake.unplug()
    plug(serial="T2")
    with pytest.raises(DeviceAbsent, match=r"T1 .* does not answer any more"):
        camera.trigger()
    assert "T2" in camera.open()
    arm(camera, trigger="software")
    camera.trigger()
    assert camera.read(10.0)


def test_disarmed_after_it_was_unplugged_it_is_absent(plug, make):
    fake = plug()
    camera = make()
    camera.open()
    arm(camera)
    fake.unplug()
    with pytest.raises(DeviceAbsent):
        camera.disarm()
    camera.disarm()
    camera.close()
