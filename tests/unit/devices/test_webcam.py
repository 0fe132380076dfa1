"""The webcam's driver over a capture that behaves like OpenCV's."""

import threading
import time

import cv2
import numpy as np
import pytest
from fake_webcam import HEIGHT, PERIOD_S, VALUES, WIDTH, Webcam, driver

from fringed.config import validate
from fringed.data import CameraSettings
from fringed.devices.building import DriverContext
from fringed.devices.camera.base import MachineClock
from fringed.devices.camera.webcam import WEBCAM
from fringed.errors import ConfigurationError, DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError


@pytest.fixture
def webcam(tmp_path):
    path = tmp_path / "video0"
    path.touch()
    return Webcam(str(path))


@pytest.fixture
def camera(webcam):
    made = driver(webcam)
    yield made
    made.close()


def arm(camera, **settings):
    return camera.arm(CameraSettings(**{"exposure_us": 2000.0, "channel": "white", **settings}))


def read_many(camera, count, timeout_s=5.0):
    return [camera.read(timeout_s) for _ in range(count)]


def wait_for(condition):
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def test_the_driver_is_built_from_options_and_opens_nothing():
    camera = WEBCAM.create(validate({}, WEBCAM.Options, "camera.options"), DriverContext("rig", MachineClock()))
    assert camera.size_px == (1280, 720)
    assert not camera.simulated
    assert not camera.replayed
    with pytest.raises(ConfigurationError, match="stamp_marks"):
        validate({"stamp_marks": "sometime"}, WEBCAM.Options, "camera.options")


def test_it_opens_with_its_mode_and_everything_automatic_off(webcam, camera):
    assert f"{webcam.path}, 32 x 24 at 200 frames/s in YUYV" in camera.open()
    assert camera.open() == camera.open()
    assert len(webcam.opened) == 1
    assert webcam.controls[cv2.CAP_PROP_AUTO_EXPOSURE] == 1.0
    assert webcam.controls[cv2.CAP_PROP_AUTO_WB] == webcam.controls[cv2.CAP_PROP_AUTOFOCUS] == 0.0
    assert camera.period_s == pytest.approx(PERIOD_S)


def test_arming_fixes_exposure_and_gain_and_tells_what_is_in_force(webcam):
    camera = driver(webcam, gain=5, gain_step_db=0.5)
    camera.open()
    settings = arm(camera, exposure_us=2040.0, gain_db=6.0)
    assert settings.exposure_us == pytest.approx(2000.0)
    assert settings.gain_db == 6.0
    assert webcam.controls[cv2.CAP_PROP_EXPOSURE] == 20.0
    assert webcam.controls[cv2.CAP_PROP_GAIN] == 17.0
    camera.close()


def test_a_control_that_it_has_not_is_said(webcam, camera):
    del webcam.controls[cv2.CAP_PROP_AUTOFOCUS], webcam.controls[cv2.CAP_PROP_GAIN]
    identity = camera.open()
    assert "no control of its automatic focus" in identity
    assert "no control of its gain" in identity
    arm(camera)
    assert {control.name for control in camera.controls if control.outcome == "absent"} == {
        "automatic focus",
        "gain (in its own steps)",
    }


def test_a_control_that_stays_automatic_is_refused_unless_asked_otherwise(webcam, camera):
    webcam.frozen = frozenset({cv2.CAP_PROP_AUTO_EXPOSURE})
    camera.open()
    with pytest.raises(DeviceError, match=r"automatic exposure stays at 3 where 1 was asked for.*strict"):
        arm(camera)
    lenient = driver(webcam, strict=False)
    lenient.open()
    arm(lenient)
    assert lenient.read(5.0).image.shape == (HEIGHT, WIDTH)
    lenient.close()


def test_an_exposure_that_it_cannot_have_is_refused(webcam, camera):
    webcam.frozen = frozenset({cv2.CAP_PROP_EXPOSURE})
    camera.open()
    with pytest.raises(DeviceError, match=r"exposure .* stays at 157 where 20"):
        arm(camera)


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"trigger": "software"}, "free-running"), ({"bits": 12}, "8 bits"), ({"gain_db": 3.0}, "gain_step_db")],
)
def test_settings_that_a_webcam_cannot_have_are_refused(camera, settings, words):
    camera.open()
    with pytest.raises(UsageError, match=words):
        arm(camera, **settings)
    with pytest.raises(UsageError, match="free-running"):
        camera.trigger()


def test_frames_come_in_order_with_times_that_are_safe(camera):
    camera.open()
    armed_s = camera.clock.now()
    settings = arm(camera)
    frames = [camera.read(5.0) for _ in range(5)]
    now = camera.clock.now()
    for frame in frames:
        assert frame.image.shape == (HEIGHT, WIDTH)
        assert frame.image.dtype == np.uint8
        assert armed_s - PERIOD_S - 0.002 <= frame.exposure_start_s < frame.exposure_end_s <= now
        assert frame.exposure_end_s - frame.exposure_start_s >= settings.exposure_us * 1e-6 + PERIOD_S - 1e-9
    counters = [frame.counter for frame in frames]
    assert counters == sorted(set(counters))
    starts = [frame.exposure_start_s for frame in frames]
    assert starts == sorted(starts)


def test_each_frame_has_the_stamp_of_its_own_grab(webcam):
    camera = driver(webcam, stamp_marks="frame-end")
    camera.open()
    arm(camera)
    capture = webcam.opened[0]
    for _ in range(5):
        frame = camera.read(5.0)
        number = int(frame.image[0, 0])
        expected_end_s = capture.due_s - (capture.frame - number) * PERIOD_S
        assert frame.exposure_end_s == pytest.approx(expected_end_s, abs=3 * PERIOD_S)
        assert frame.exposure_end_s - frame.exposure_start_s == pytest.approx(0.002 + PERIOD_S)
    camera.close()


def test_without_stamps_the_arrival_counts(webcam, camera):
    webcam.stamps = False
    camera.open()
    arm(camera)
    before = camera.clock.now()
    frame = camera.read(5.0)
    assert frame.exposure_end_s <= camera.clock.now()
    assert frame.exposure_end_s >= before - 20 * PERIOD_S


def test_a_slow_reader_gets_the_newest_frames_and_sees_what_it_missed(webcam, camera):
    camera.open()
    arm(camera)
    first = camera.read(5.0)
    wait_for(lambda: webcam.opened[0].frame > int(first.image[0, 0]) + 20)
    second = camera.read(5.0)
    assert second.counter > first.counter + 10
    assert second.exposure_start_s > first.exposure_start_s + 10 * PERIOD_S


def test_frames_that_were_lost_show_in_the_counters(webcam, camera):
    camera.open()
    arm(camera)
    read_many(camera, 15)
    webcam.lose = 3
    frames = read_many(camera, 15)
    steps = np.diff([int(frame.image[0, 0]) for frame in frames]) % VALUES
    assert np.diff([frame.counter for frame in frames]).tolist() == steps.tolist()


def test_counters_go_on_when_it_is_armed_again(camera):
    camera.open()
    arm(camera)
    first = camera.read(5.0).counter
    camera.disarm()
    arm(camera)
    assert camera.read(5.0).counter > first


@pytest.mark.parametrize(
    ("channel", "expected"), [("red", None), ("green", 20), ("blue", 10), ("rgb", (None, 20, 10)), ("white", None)]
)
def test_channels(camera, channel, expected):
    camera.open()
    arm(camera, channel=channel)
    image = camera.read(5.0).image
    if channel == "rgb":
        assert image.shape == (HEIGHT, WIDTH, 3)
        assert image[0, 0, 1:].tolist() == list(expected[1:])
    else:
        assert image.shape == (HEIGHT, WIDTH)
        assert expected is None or image[0, 0] == expected


def test_another_size_than_asked_is_refused_with_what_it_saw(webcam):
    camera = driver(webcam, width_px=50, height_px=40)
    with pytest.raises(DeviceError, match=r"asked for 50 x 40 .* gives 64 x 48 .*list-formats-ext"):
        camera.open()
    assert webcam.opened[0].released


def test_another_format_than_asked_is_refused_with_what_it_saw(webcam):
    webcam.formats = ("MJPG",)
    camera = driver(webcam, fourcc="GREY")
    with pytest.raises(DeviceError, match=r"GREY, the webcam gives .* in YUYV"):
        camera.open()


def test_frames_of_another_size_on_the_way_are_named(webcam, camera):
    camera.open()
    arm(camera)
    camera.read(5.0)
    webcam.wrong_size = (16, 12)
    with pytest.raises(ProtocolError, match=r"uint8 of \(12, 16, 2\).*\(24, 32, 3\)"):
        read_many(camera, 10)
    webcam.wrong_size = None
    arm(camera)
    assert camera.read(5.0).image.shape == (HEIGHT, WIDTH)


def test_frames_that_cannot_be_decoded_are_dropped_and_then_named(webcam, camera):
    camera.open()
    arm(camera)
    camera.read(5.0)
    webcam.undecodable = True
    with pytest.raises(ProtocolError, match="10 frames in a row could not be decoded"):
        read_many(camera, 10)


def test_a_silent_webcam_stalls_for_as_long_as_it_was_told(webcam, camera):
    webcam.silent = True
    camera.open()
    arm(camera)
    with pytest.raises(DeviceStalled, match=r"within 0\.2 s"):
        camera.read(0.2)
    webcam.silent = False
    assert camera.read(5.0).image.shape == (HEIGHT, WIDTH)


def test_unplugged_it_is_absent_and_plugged_in_again_it_comes_back_on_open(webcam, camera):
    camera.open()
    arm(camera)
    camera.read(5.0)
    threading.Timer(0.05, lambda: setattr(webcam, "plugging", 0)).start()
    unplugged = time.monotonic()
    with pytest.raises(DeviceAbsent, match="was unplugged"):
        read_many(camera, 100_000, 60.0)
    assert time.monotonic() - unplugged < 30  # and not the 60 s that it may wait for a frame
    assert webcam.opened[0].released
    with pytest.raises(DeviceAbsent):
        camera.read(1.0)
    with pytest.raises(DeviceAbsent, match="cannot be opened"):
        camera.open()
    webcam.plugging = 2
    camera.open()
    arm(camera)
    assert camera.read(5.0).image.shape == (HEIGHT, WIDTH)


def test_unplugged_and_plugged_in_between_two_reads_it_is_absent_once(webcam, camera):
    camera.open()
    arm(camera)
    webcam.plugging = 2
    with pytest.raises(DeviceAbsent):
        camera.read(60.0)
    camera.open()
    arm(camera)
    assert camera.read(5.0)


def test_plugged_in_again_while_idle_open_takes_the_new_one(webcam, camera):
    camera.open()
    webcam.plugging = 2
    camera.open()
    assert len(webcam.opened) == 2
    assert webcam.opened[0].released


def test_a_webcam_that_another_program_has_is_named(webcam, camera):
    webcam.taken = True
    with pytest.raises(DeviceAbsent, match="another program has it"):
        camera.open()
    webcam.taken = False
    assert camera.open()


def test_nothing_is_read_from_a_camera_that_is_closed_or_not_armed(camera):
    camera.close()
    camera.disarm()
    with pytest.raises(DeviceError):
        arm(camera)
    camera.open()
    with pytest.raises(DeviceError, match="not armed"):
        camera.read(0.1)
