"""The USB3 Vision driver over an emulated camera: formats, triggers, times, counters, and what goes wrong."""

import time

import numpy as np
import pytest

from fringed.config import validate
from fringed.data import CameraSettings
from fringed.devices.building import DriverContext
from fringed.devices.camera.base import MachineClock
from fringed.devices.camera.usb3vision import USB3_VISION, Usb3VisionCamera
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.emulators.u3v import EmulatedUsb, OtherDevice
from fringed.emulators.u3v_camera import EmulatedU3vCamera
from fringed.emulators.u3v_memory import EmulatedIdentity
from fringed.errors import (
    ConfigurationError,
    DeviceAbsent,
    DeviceStalled,
    ProtocolError,
    UsageError,
)
from fringed.hookspecs import Adjustable, Watched

WIDTH, HEIGHT = 61, 40
SHORT = 4096  # bytes of a transfer: a frame has several
PACKED = ("Mono8", "Mono10p", "Mono12Packed", "RGB8", "RGB10p", "RGB12p")


class Scene:
    """Random pictures of what is in force, kept with the time of their exposure."""

    def __init__(self, channels=1):
        self.channels, self.taken, self.bits = channels, [], 8

    def __call__(self, start_s, exposure_s):
        shape = (HEIGHT, WIDTH) if self.channels == 1 else (HEIGHT, WIDTH, 3)
        image = np.random.default_rng(len(self.taken)).integers(0, 2**self.bits, shape)
        image = image.astype(np.uint8 if self.bits <= 8 else np.uint16)
        self.taken.append((start_s, exposure_s, image))
        return image


class Bench:
    """An emulated camera, the bus it hangs on, and its driver."""

    def __init__(self, channels=1, period_s=0.02, options=None, **identity):
        self.scene = Scene(channels)
        self.emulated = EmulatedU3vCamera(
            self.scene, EmulatedIdentity(**{"width": WIDTH, "height": HEIGHT, **identity}), period_s
        )
        self.bus = EmulatedUsb([OtherDevice(), self.emulated])
        self.options = Usb3VisionOptions(**{"transfer_bytes": SHORT // 4, "control_timeout_ms": 300, **(options or {})})
        self.camera = Usb3VisionCamera(self.options, backend=self.bus)

    def arm(self, **settings):
        self.scene.bits = settings.get("bits", 8)
        return self.camera.arm(CameraSettings(**{"exposure_us": 3000.0, "trigger": "software", **settings}))

    def shoot(self, timeout_s=5.0):
        self.camera.trigger()
        return self.camera.read(timeout_s)


@pytest.fixture
def bench():
    made = Bench()
    made.camera.open()
    yield made
    made.camera.close()
    assert made.bus.opened == 0


def test_it_opens_and_says_who_it_is(bench):
    assert bench.camera.open() == "fringed Emulated U3V 1.0 serial number EMU-0001, 61 x 40"
    assert bench.camera.size_px == (WIDTH, HEIGHT)
    assert bench.camera.period_s == pytest.approx(0.02)


@pytest.mark.parametrize("zipped", [True, False])
def test_its_description_is_read_plain_and_zipped(zipped):
    bench = Bench(zipped=zipped, max_transfer=100)  # in many small pieces
    assert bench.camera.open()
    bench.camera.close()


@pytest.mark.parametrize("formats", [EmulatedIdentity().formats, PACKED], ids=["unpacked", "packed"])
@pytest.mark.parametrize("bits", [8, 10, 12])
@pytest.mark.parametrize("channel", ["white", "red", "green", "blue", "rgb"])
def test_every_depth_and_channel_arrives_unchanged(formats, bits, channel):
    bench = Bench(channels=1 if channel == "white" else 3, formats=formats)
    bench.camera.open()
    settings = bench.arm(bits=bits, channel=channel)
    frames = [bench.shoot() for _ in range(2)]
    bench.camera.close()
    assert (settings.bits, settings.channel) == (bits, channel)
    for frame, (_, _, image) in zip(frames, bench.scene.taken, strict=True):
        wanted = image if channel in ("white", "rgb") else image[:, :, ("red", "green", "blue").index(channel)]
        assert frame.image.dtype == (np.uint8 if bits == 8 else np.uint16)
        assert np.array_equal(frame.image, wanted)
        assert frame.image.flags.c_contiguous


def test_a_monochrome_camera_gives_its_only_picture_for_a_colour(bench):
    mono = Bench(formats=("Mono8",))
    mono.camera.open()
    mono.arm(channel="green")
    assert np.array_equal(mono.shoot().image, mono.scene.taken[0][2])
    with pytest.raises(UsageError, match=r"8 bits of channel 'rgb'.*Mono8"):
        mono.arm(channel="rgb")
    mono.camera.close()


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"bits": 16}, "16 bits of channel 'white'"),
        ({"exposure_us": 1.0}, "ExposureTime 1 us.*10 to 1e\\+07 us"),
        ({"gain_db": 60.0}, "Gain 60 dB.*0 to 24 dB"),
    ],
)
def test_settings_that_it_has_not_are_refused_with_those_it_has(bench, asked, told):
    with pytest.raises(UsageError, match=told):
        bench.arm(**asked)
    bench.arm()
    assert bench.shoot()


def test_behind_a_bridge_the_exposure_is_set_elsewhere():
    hidden = ("ExposureTime", "Gain", "ExposureAuto", "TriggerMode", "TriggerSelector", "AcquisitionResultingFrameRate")
    bench = Bench(hidden=hidden, options={"exposure_feature": "", "readout_ms": 30.0})
    bench.camera.open()
    settings = bench.arm(trigger="free-running", exposure_us=5000.0)
    assert (settings.exposure_us, settings.gain_db) == (5000.0, 0.0)
    assert bench.camera.period_s == pytest.approx(0.035)
    assert bench.camera.read(5.0).counter == 1
    with pytest.raises(UsageError, match=r"gain of 3 dB.*ask for 0"):
        bench.arm(trigger="free-running", gain_db=3.0)
    with pytest.raises(ProtocolError, match="no TriggerMode"):
        bench.arm(trigger="software")
    bench.camera.close()
    other = Bench(hidden=hidden)
    other.camera.open()
    with pytest.raises(ProtocolError, match=r"camera\.options\.exposure_feature"):
        other.arm()
    other.camera.close()


def test_settings_reach_the_camera_and_come_back_as_it_takes_them(bench):
    settings = bench.arm(exposure_us=3000.3, gain_db=6.0, bits=10)
    assert settings.exposure_us == 3000.5  # ticks of 0.5 us
    assert bench.emulated.exposure_s == pytest.approx(0.0030005)
    assert (bench.emulated.gain_db, bench.emulated.bits) == (6.0, 10)
    assert settings.electrons_per_dn == pytest.approx(13000 / 1023 / 10**0.3)


def test_times_are_those_of_the_exposure_on_the_machines_clock(bench):
    bench.arm()
    for _ in range(3):
        frame = bench.shoot()
        start_s, exposure_s, _ = bench.scene.taken[-1]
        assert frame.exposure_start_s == pytest.approx(start_s, abs=0.05)  # its own clock began 1000 s earlier
        assert frame.exposure_end_s - frame.exposure_start_s == pytest.approx(exposure_s)


def test_a_stamp_of_the_exposures_end_can_be_said():
    bench = Bench(options={"stamp_marks": "exposure-end"})
    bench.camera.open()
    bench.arm(exposure_us=200_000.0)
    frame = bench.shoot()  # the emulated camera marks the start: all is one exposure early
    assert frame.exposure_end_s == pytest.approx(bench.scene.taken[0][0], abs=0.05)
    bench.camera.close()


def test_without_a_clock_of_its_own_the_arrival_tells_the_time():
    bench = Bench(options={"time_stamps": "arrival"})
    bench.emulated.memory.put(0x1FC, 0, 8)
    bench.camera.open()
    bench.arm()
    assert bench.shoot().exposure_end_s <= time.monotonic()
    bench.camera.close()
    other = Bench()
    other.emulated.memory.put(0x1FC, 0, 8)
    other.camera.open()
    with pytest.raises(ProtocolError, match="time_stamps to 'arrival'"):
        other.arm()
    other.camera.close()


def test_a_stamp_from_the_future_is_named(bench):
    bench.arm()
    bench.emulated._boot_s -= 100.0
    bench.camera._times._synchronised_s = float("inf")
    bench.emulated._ticks = lambda time_s: round(
        (time_s + 50.0 if time_s < time.monotonic() - 0.001 else time_s) * 1.25e8
    )
    with pytest.raises(ProtocolError, match="stamp_marks"):
        bench.shoot()


def test_counters_tell_what_was_dropped(bench):
    bench.arm(trigger="free-running")
    first = bench.camera.read(5.0)
    while bench.emulated.blocks_dropped == 0:
        time.sleep(0.05)
        with bench.emulated._changed:
            bench.emulated._expose()
    later = [bench.camera.read(5.0) for _ in range(2)]
    assert later[0].counter - first.counter > 1
    assert later[1].counter > later[0].counter
    assert later[0].counter - first.counter - 1 <= bench.emulated.blocks_dropped


def test_a_hardware_trigger_comes_by_its_line(bench):
    bench.arm(trigger="hardware")
    bench.camera.trigger()
    with pytest.raises(DeviceStalled, match="pulses on its Line0"):
        bench.camera.read(0.05)
    bench.emulated.pulse()
    assert np.array_equal(bench.camera.read(5.0).image, bench.scene.taken[0][2])


def test_a_free_running_camera_takes_no_trigger(bench):
    bench.arm(trigger="free-running")
    with pytest.raises(UsageError, match="runs freely"):
        bench.camera.trigger()


def test_the_size_can_be_set():
    bench = Bench(options={"width_px": 32, "height_px": 20})
    assert bench.camera.size_px == (32, 20)
    bench.camera.open()
    bench.emulated._picture = lambda start_s, exposure_s: np.zeros((20, 32), np.uint8)
    bench.arm()
    assert bench.shoot().image.shape == (20, 32)
    bench.camera.close()


def test_what_bends_the_numbers_is_turned_off(bench):
    assert bench.camera._control.features.number("GammaEnable") == 1
    bench.arm()
    assert bench.camera._control.features.number("GammaEnable") == 0


def test_its_own_settings_are_read_and_set(bench):
    settings = {one.name: one for one in bench.camera.settings()}
    assert isinstance(bench.camera, Adjustable)
    assert list(settings) == ["DeviceTemperature", "BlackLevel", "TriggerActivation"]
    assert (settings["DeviceTemperature"].value, settings["DeviceTemperature"].writable) == (41.5, False)
    assert (settings["BlackLevel"].least, settings["BlackLevel"].most) == (0, 64)
    assert settings["TriggerActivation"].choices == ("RisingEdge", "FallingEdge")
    bench.camera.adjust("BlackLevel", 12)
    bench.camera.adjust("TriggerActivation", "FallingEdge")
    values = {one.name: one.value for one in bench.camera.settings()}
    assert (values["BlackLevel"], values["TriggerActivation"]) == (12, "FallingEdge")


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("BlackLevel", 65, "0 to 64"),
        ("BlackLevel", "high", "0 to 64"),
        ("TriggerActivation", "Both", "RisingEdge, FallingEdge"),
        ("DeviceTemperature", 20, "BlackLevel, TriggerActivation"),
        ("OffsetX", 4, "BlackLevel, TriggerActivation"),
        ("Width", 4, "BlackLevel, TriggerActivation"),
    ],
)
def test_a_setting_that_cannot_be_is_refused(bench, name, value, told):
    with pytest.raises(UsageError, match=told):
        bench.camera.adjust(name, value)


def test_nothing_is_set_while_it_is_armed(bench):
    bench.arm()
    with pytest.raises(UsageError, match="armed"):
        bench.camera.adjust("BlackLevel", 1)


def test_a_camera_that_has_gone_while_it_rests_is_noticed(bench):
    assert isinstance(bench.camera, Watched)
    bench.camera.check()
    bench.emulated.unplug()
    with pytest.raises(DeviceAbsent, match="unplugged"):
        bench.camera.check()
    with pytest.raises(DeviceAbsent, match="open it"):
        bench.camera.check()


def make_backend():
    return EmulatedUsb([EmulatedU3vCamera(identity=EmulatedIdentity(width=16, height=16))])


def test_the_driver_is_made_from_its_options():
    options = validate({"backend": f"{__name__}:make_backend"}, USB3_VISION.Options, "camera.options")
    camera = USB3_VISION.create(options, DriverContext("lab", MachineClock()))
    assert "16 x 16" in camera.open()
    camera.close()
    with pytest.raises(ConfigurationError, match=r"camera\.options\.backend"):
        Usb3VisionCamera(Usb3VisionOptions(backend="nowhere:made")).open()
