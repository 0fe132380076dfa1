"""The driver `gige` over a camera in memory: its states, its frames, and what it says of those that are broken."""

import time

import numpy as np
import pytest
from fake_genicam import Genicam, buffer, modern

from fringed.config import validate
from fringed.data import CameraSettings
from fringed.devices.building import DriverContext
from fringed.devices.camera.base import MachineClock
from fringed.devices.camera.gige import GIGE, GigeCamera, GigeOptions
from fringed.devices.camera.gige_library import SIGNATURES
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError

SIZE = {"width_px": 32, "height_px": 16}


def picture(value=0):
    return np.full((16, 32), value, np.uint8)


@pytest.fixture
def port():
    return Genicam()


@pytest.fixture
def camera(port):
    made = GigeCamera(validate({**SIZE, "delay_ms": 2.0}, GigeOptions, "camera.options"), port)
    made.open()
    yield made
    made.close()
    assert not port.streams


def arm(camera, **settings):
    return camera.arm(CameraSettings(**{"exposure_us": 4000.0, "channel": "green", **settings}))


def test_the_driver_is_built_without_the_library_and_opens_nothing():
    camera = GIGE.create(validate({"fps": 50.0}, GIGE.Options, "camera.options"), DriverContext("rig", MachineClock()))
    assert camera.period_s == pytest.approx(0.02)
    assert camera.size_px == (0, 0)
    assert not camera.simulated
    assert not camera.replayed
    camera.disarm()
    camera.close()
    with pytest.raises(DeviceAbsent):
        arm(camera)


def test_every_function_of_the_library_ends_as_its_signature_says():
    for name, (_, arguments) in SIGNATURES.items():
        fallible = name.startswith("arv_camera_")
        assert bool(arguments and "LP_c_void_p" in repr(arguments[-1])) == fallible, name


def test_frames_carry_what_is_in_force(port, camera):
    settings = arm(camera, gain_db=3.0)
    assert settings == CameraSettings(exposure_us=4000.0, gain_db=3.0, channel="white")
    assert port.executed == ["AcquisitionStart"]
    assert camera.size_px == (32, 16)
    assert camera.period_s == pytest.approx(1 / 40)
    port.coming.append(buffer(7, picture(9), arrived_s=100.0))
    frame = camera.read(1.0)
    assert frame.image.tolist() == picture(9).tolist()
    assert frame.exposure_start_s == pytest.approx(100.0 - 0.002 - 0.004)
    assert frame.exposure_end_s == pytest.approx(100.0)


def test_the_noise_of_a_data_sheet_is_in_force(port):
    options = validate({**SIZE, "full_well_electrons": 10_200.0, "dark_noise_electrons": 7.0}, GigeOptions, "o")
    camera = GigeCamera(options, port)
    camera.open()
    settings = arm(camera, gain_db=20.0)
    assert settings.electrons_per_dn == pytest.approx(4.0)
    assert settings.read_noise_electrons == 7.0
    assert arm(camera, bits=12).electrons_per_dn == pytest.approx(10_200 / 4095)
    camera.close()


def test_a_frame_that_arrived_late_is_timed_by_the_cameras_clock(port, camera):
    arm(camera)
    for k, late_s in enumerate((0.0, 0.003, 0.02)):
        port.coming.append(buffer(k, picture(), stamp_ns=10**15 + k * 25_000_000, arrived_s=50 + 0.025 * k + late_s))
    starts = [camera.read(1.0).exposure_start_s for _ in range(3)]
    assert np.diff(starts) == pytest.approx(0.025, abs=1e-6)
    assert starts[0] == pytest.approx(50 - 0.006)


def test_incomplete_frames_are_passed_over_and_leave_a_gap(port, camera):
    arm(camera)
    port.coming += [buffer(1, picture(1)), buffer(2, status=3), buffer(3, status=2), buffer(4, picture(4))]
    first, second = camera.read(1.0), camera.read(1.0)
    assert second.counter - first.counter == 3
    assert second.image[0, 0] == 4
    assert camera.incomplete == {"with missing packets": 1, "late: not all of its packets came in time": 1}


def test_when_none_is_complete_it_says_what_came(port, camera):
    arm(camera)
    port.lost_packets = 250
    port.coming += [buffer(1, status=3), buffer(2, status=3)]
    with pytest.raises(DeviceStalled, match=r"within 0\.1 s; .*incomplete: 2 with missing packets \(250 of 1250 .*MTU"):
        camera.read(0.1)


def test_a_triggered_frame_that_is_incomplete_is_named_at_once(port, camera):
    arm(camera, trigger="software")
    camera.trigger()
    port.coming.append(buffer(1, status=5))
    with pytest.raises(ProtocolError, match="frame 0 came larger than its buffer"):
        camera.read(60.0)


def test_a_trigger_clears_what_is_left_and_bounds_the_exposure(port, camera):
    arm(camera, trigger="software")
    port.coming += [buffer(1, picture(1)), buffer(2, status=3)]
    before = camera.clock.now()
    camera.trigger()
    assert port.executed[-1] == "TriggerSoftware"
    assert not port.coming
    port.coming.append(buffer(3, picture(3), arrived_s=before - 1.0))
    frame = camera.read(1.0)
    assert frame.image[0, 0] == 3
    assert frame.exposure_start_s >= before


def test_a_line_triggers_by_itself_and_an_incomplete_frame_is_passed_over(port, camera):
    arm(camera, trigger="hardware")
    port.coming.append(buffer(1, picture(1)))
    camera.trigger()
    assert not port.coming
    assert port.executed == ["AcquisitionStart"]
    port.coming += [buffer(2, status=3), buffer(3, picture(3), arrived_s=50.0)]
    frame = camera.read(1.0)
    assert frame.image[0, 0] == 3
    assert frame.exposure_end_s == pytest.approx(50.0)


def test_without_a_trigger_it_stalls_and_says_so(port, camera):
    arm(camera, trigger="hardware")
    with pytest.raises(DeviceStalled, match=r"within 0\.05 s: check that the trigger \(hardware\)"):
        camera.read(0.05)
    arm(camera)
    with pytest.raises(UsageError, match="runs freely; arm it with trigger 'software' or 'hardware'"):
        camera.trigger()
    with pytest.raises(DeviceStalled, match="sends nothing; look at the firewall"):
        camera.read(0.05)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"image": np.zeros((8, 32), np.uint8)}, "delivered 32 x 8 in Mono8; it was set to 32 x 16"),
        ({"image": picture(), "form": "Mono12p"}, "in Mono12p; it was set to .* in Mono8"),
        ({"image": picture()[:4], "size_px": (32, 16)}, "delivered 128 bytes; 512 numbers in Mono8 are 512"),
    ],
)
def test_a_frame_that_is_none_is_named(port, camera, wrong, words):
    arm(camera)
    port.coming.append(buffer(1, **wrong))
    with pytest.raises(ProtocolError, match=words):
        camera.read(1.0)


def test_twelve_bits_and_a_value_that_they_cannot_hold(port, camera):
    port.features["PixelFormat"].entries = ("Mono8", "Mono12")
    assert arm(camera, bits=12).bits == 12
    good = np.full((16, 32), 4095, np.uint16)
    port.coming += [buffer(1, good, form="Mono12"), buffer(2, good + 1, form="Mono12")]
    frame = camera.read(1.0)
    assert frame.image.dtype == np.uint16
    assert frame.image.max() == 4095
    with pytest.raises(ProtocolError, match="4096; 12 bits end at 4095"):
        camera.read(1.0)


def test_counters_go_on_when_it_is_armed_again_and_ids_begin_anew(port, camera):
    counters = []
    for _ in range(2):
        arm(camera)
        port.coming += [buffer(1, picture()), buffer(2, picture())]
        counters += [camera.read(1.0).counter for _ in range(2)]
        camera.disarm()
    assert counters == [0, 1, 2, 3]
    assert port.executed == ["AcquisitionStart", "AcquisitionStop"] * 2


def test_a_camera_that_is_gone_is_absent_and_comes_back(port, camera):
    arm(camera)
    port.plugged = False
    began = time.monotonic()
    with pytest.raises(DeviceAbsent, match="does not answer any more"):
        camera.read(60.0)
    assert time.monotonic() - began < 30
    for use in (lambda: camera.read(1.0), lambda: arm(camera), camera.open, camera.trigger):
        with pytest.raises(DeviceAbsent):
            use()
    camera.disarm()
    port.plugged = True
    assert camera.open()
    arm(camera)
    port.coming.append(buffer(1, picture()))
    assert camera.read(1.0)


def test_a_command_to_a_camera_that_is_gone_is_not_waited_for(port, camera):
    arm(camera, trigger="software")
    port.plugged = False
    sent = len(port.executed)
    with pytest.raises(DeviceAbsent):
        camera.trigger()
    assert len(port.executed) == sent


def test_open_twice_is_one_camera_and_not_armed_is_said(port, camera):
    assert camera.open() == camera.open() == "Maker Model only"
    with pytest.raises(DeviceError, match="not armed"):
        camera.read(1.0)


def test_a_colour_camera_gives_one_colour_or_three(port, camera):
    port.features = {**modern()}
    port.features["PixelFormat"].entries = ("Mono8", "BGR8")
    pixels = np.zeros((16, 32, 3), np.uint8)
    pixels[:, :] = (1, 2, 3)  # blue, green, red
    for channel, expected in (("red", 3), ("green", 2), ("blue", 1), ("rgb", [3, 2, 1])):
        assert arm(camera, channel=channel).channel == channel
        port.coming.append(buffer(1, pixels, form="BGR8"))
        assert camera.read(1.0).image[0, 0].tolist() == expected
    assert arm(camera, channel="white").channel == "white"
    assert port.features["PixelFormat"].value == "Mono8"
