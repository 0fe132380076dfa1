"""The USB3 Vision driver over an emulated camera: formats, triggers, times, counters, and what goes wrong."""

import errno
import threading
import time
from contextlib import suppress

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
    DeviceError,
    DeviceStalled,
    FringedError,
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


# What goes wrong with frames.


@pytest.mark.parametrize("part", ["payload", "trailer"])
def test_a_lost_transfer_is_named_and_the_next_frame_comes(bench, part):
    bench.arm()
    bench.emulated.faults.lose_next.append(part)
    bench.camera.trigger()
    with pytest.raises((ProtocolError, DeviceStalled)) as caught:
        bench.camera.read(0.3)
    if part == "payload":
        assert "block 0 is incomplete" in caught.value.message
        assert np.array_equal(bench.shoot().image, bench.scene.taken[1][2])
    else:  # what is missing is missed when the next block begins
        bench.camera.trigger()
        with pytest.raises(ProtocolError, match=r"block 0 is incomplete.*the next block began"):
            bench.camera.read(5.0)
        assert np.array_equal(bench.camera.read(5.0).image, bench.scene.taken[1][2])


def test_a_lost_leader_is_a_missing_frame(bench):
    bench.arm()
    bench.emulated.faults.lose_next.append("leader")
    bench.camera.trigger()
    with pytest.raises(DeviceStalled):
        bench.camera.read(0.3)
    frame = bench.shoot()
    assert np.array_equal(frame.image, bench.scene.taken[1][2])
    assert frame.counter == 2


def test_a_short_payload_and_a_discarded_block_are_named(bench):
    bench.arm()
    bench.emulated.faults.short_next = 1
    with pytest.raises(ProtocolError, match="incomplete"):
        bench.shoot()
    bench.emulated.faults.discard_next = 1
    with pytest.raises(ProtocolError, match="data discarded"):
        bench.shoot()
    assert bench.shoot().counter == 3


def test_a_late_frame_comes_after_its_time_out(bench):
    bench.emulated.faults.late_next_s.append(3600.0)
    bench.arm()
    bench.camera.trigger()
    with pytest.raises(DeviceStalled, match=r"no frame within 0\.1 s \(software\)"):
        bench.camera.read(0.1)
    bench.emulated._late_s = 0.0
    assert bench.camera.read(5.0).counter == 1


def test_another_pixel_format_than_was_set_is_named(bench):
    bench.arm()
    bench.emulated.faults.wrong_format = 0x01100003
    with pytest.raises(ProtocolError, match=r"61 x 40 pixels of Mono10; it was set to 61 x 40 of Mono8"):
        bench.shoot()
    bench.emulated.faults.wrong_format = 0x01080009
    with pytest.raises(ProtocolError, match="0x01080009"):
        bench.shoot()
    bench.emulated.faults.wrong_format = None
    assert bench.shoot().counter == 3


def test_with_5_percent_of_transfers_lost_every_frame_is_right_or_named():
    bench = Bench()
    bench.camera.open()
    bench.arm(exposure_us=500.0)
    bench.emulated.faults.lost_fraction = 0.05
    right = named = 0
    for _ in range(80):
        bench.camera.trigger()
        try:
            frame = bench.camera.read(0.2)
        except (ProtocolError, DeviceStalled):
            named += 1
        else:
            assert np.array_equal(frame.image, bench.scene.taken[frame.counter - 1][2])
            right += 1
    bench.camera.close()
    assert right > 40
    assert named > 3


def test_running_freely_incomplete_frames_can_be_passed_over():
    bench = Bench(options={"incomplete_frames": "pass-over"})
    bench.camera.open()
    bench.arm(trigger="free-running")
    bench.emulated.faults.lose_next.extend(["payload"] * 2)
    frame = bench.camera.read(5.0)
    assert bench.camera.incomplete in (1, 2)  # both may be of one frame
    assert frame.counter == 1 + bench.camera.incomplete
    assert np.array_equal(frame.image, bench.scene.taken[frame.counter - 1][2])
    bench.emulated.faults.lost_fraction = 1.0
    with pytest.raises(DeviceStalled, match=r"were incomplete, the last: block \d is incomplete"):
        bench.camera.read(0.1)
    bench.arm(trigger="software")
    bench.emulated.faults.lost_fraction = 0.0
    bench.emulated.faults.lose_next.append("payload")
    with pytest.raises(ProtocolError, match="block 0 is incomplete"):
        bench.shoot()
    bench.camera.close()


# What goes wrong with the cable and the bus.


@pytest.mark.parametrize("transfers", [0, 1, 2, 4])
def test_unplugged_within_a_frame_is_absent_and_replugged_it_goes_on(bench, transfers):
    bench.arm()
    last = bench.shoot().counter
    bench.emulated.faults.unplug_in = transfers
    bench.camera.trigger()
    with pytest.raises(DeviceAbsent, match="unplugged: plug it in again"):
        bench.camera.read(5.0)
    with pytest.raises(DeviceAbsent, match="open it"):
        bench.camera.read(5.0)
    with pytest.raises(DeviceAbsent, match=r"no USB3 Vision camera.*046d:0001"):
        bench.camera.open()
    bench.emulated.plug()
    assert bench.camera.open()
    bench.arm()
    assert bench.shoot().counter > last


def test_unplugged_while_it_is_waited_for_is_told_at_once(bench):
    bench.arm()
    timer = threading.Timer(0.05, bench.emulated.unplug)
    timer.start()
    before = time.monotonic()
    with pytest.raises(DeviceAbsent):
        bench.camera.read(60.0)
    timer.join()
    assert time.monotonic() - before < 30


@pytest.mark.parametrize("act", ["trigger", "arm", "disarm", "close"])
def test_unplugged_between_two_calls(bench, act):
    bench.arm()
    bench.emulated.unplug()
    if act == "close":
        bench.camera.close()
    else:
        with pytest.raises(DeviceAbsent):
            getattr(bench.camera, act)(*([CameraSettings()] if act == "arm" else []))
    with pytest.raises(DeviceAbsent):
        bench.camera.arm(CameraSettings())
    bench.camera.disarm()


def test_a_stalled_control_endpoint_is_cleared_and_asked_again(bench):
    bench.emulated.faults.stalled = 1
    bench.arm()
    assert bench.shoot()
    bench.emulated.faults.stalled = 100
    with pytest.raises(DeviceStalled, match="control endpoint"):
        bench.arm()
    bench.emulated.faults.stalled = 0


def test_silence_on_a_read_is_asked_again_and_on_a_write_named(bench):
    bench.arm()
    bench.emulated.faults.silent = 1
    assert bench.camera._control.features.whole("Width") == WIDTH
    bench.emulated.faults.silent = 1
    with pytest.raises(DeviceStalled, match="control_timeout_ms"):
        bench.camera.trigger()  # a trigger that may have been taken is not given twice
    assert bench.shoot()


def test_a_camera_that_asks_for_time_is_waited_for(bench):
    bench.emulated.faults.pending = 3
    bench.arm()
    assert bench.shoot()


def test_the_camera_is_found_by_its_serial_number():
    cameras = [EmulatedU3vCamera(identity=EmulatedIdentity(serial=name, width=16, height=16)) for name in ("A", "B")]
    bus = EmulatedUsb([OtherDevice(), *cameras])
    camera = Usb3VisionCamera(Usb3VisionOptions(serial="B"), backend=bus)
    assert "serial number B" in camera.open()
    camera.close()
    with pytest.raises(DeviceAbsent, match=r"2 USB3 Vision cameras are there \(A, B\)"):
        Usb3VisionCamera(backend=bus).open()
    with pytest.raises(DeviceAbsent, match=r"serial number 'C'.*camera A, camera B"):
        Usb3VisionCamera(Usb3VisionOptions(serial="C"), backend=bus).open()
    assert bus.opened == 0


@pytest.mark.parametrize("kind", [(0x0E, 0x01), (0xEF, 0x02), (0xFF, 0x05)])
def test_a_device_of_another_class_is_no_camera(kind):
    bus = EmulatedUsb([OtherDevice(*kind)])
    with pytest.raises(DeviceAbsent, match=r"class EF, subclass 05.*046d:0001"):
        Usb3VisionCamera(backend=bus).open()
    with pytest.raises(DeviceAbsent, match="nothing else"):
        Usb3VisionCamera(backend=EmulatedUsb([])).open()


def test_a_camera_in_use_or_forbidden_says_so():
    bench = Bench()
    bench.bus.claimed_elsewhere = True
    with pytest.raises(DeviceAbsent, match="another program"):
        bench.camera.open()
    bench.bus.claimed_elsewhere, bench.bus.forbidden = False, True
    with pytest.raises(DeviceAbsent, match="udev"):
        bench.camera.open()
    bench.bus.forbidden = False
    assert bench.camera.open()
    bench.camera.close()
    assert bench.bus.opened == 0


def test_a_device_that_only_looks_like_a_camera_is_named():
    with pytest.raises(ProtocolError, match=r"control .* and stream"):
        Usb3VisionCamera(backend=EmulatedUsb([OtherDevice(0xEF, 0x05)])).open()


def test_a_camera_whose_registers_are_nonsense_is_named():
    for address, size, value, told in (
        (0x10020, 8, 0, "no stream interface"),
        (0x30000, 8, 0, "0 descriptions"),
        (0x1D8, 8, 0xDEAD0000, "invalid address"),
    ):
        bench = Bench()
        bench.emulated.memory.put(address, value, size)
        with pytest.raises(ProtocolError, match=told):
            bench.camera.open()
        assert bench.bus.opened == 0


@pytest.mark.parametrize("seed", range(20))
def test_whatever_a_device_answers_only_named_errors_leave(seed):
    random = np.random.default_rng(seed)
    bench = Bench(options={"control_timeout_ms": 10})
    answer = bench.emulated.answer

    def damaged():
        data = bytearray(answer() or b"")
        if data and random.random() < 0.05:
            data[int(random.integers(0, len(data)))] ^= int(random.integers(1, 256))
        return bytes(data) or None

    bench.emulated.answer = damaged
    with suppress(FringedError):
        bench.camera.open()
        bench.arm()
        bench.shoot(0.05)
    bench.camera.close()
    assert bench.bus.opened == 0


@pytest.mark.parametrize("seed", range(40))
def test_whatever_a_camera_says_of_itself_only_named_errors_leave(seed):
    random = np.random.default_rng(seed)
    bench = Bench(zipped=bool(seed % 2), options={"control_timeout_ms": 10})
    for region in bench.emulated.memory._regions.values():
        for _ in range(3):
            region[int(random.integers(0, len(region)))] ^= int(random.integers(1, 256))
    with suppress(FringedError):
        bench.camera.open()
        bench.arm()
        bench.shoot(0.05)
    bench.camera.close()
    assert bench.bus.opened == 0


def test_a_start_that_fails_half_way_leaves_the_camera_free(bench):
    started = bench.camera._control.features.execute

    def refusing(name):
        if name == "AcquisitionStart":
            raise ProtocolError("the camera refused to start")
        started(name)

    bench.camera._control.features.execute = refusing
    with pytest.raises(ProtocolError, match="refused to start"):
        bench.arm()
    bench.camera._control.features.execute = started
    bench.arm(bits=10)
    assert bench.shoot()


def test_an_error_of_the_bus_is_a_device_error(bench, monkeypatch):
    from usb.core import USBError

    def broken(*_):
        raise USBError("Input/Output Error", -1, errno.EIO)

    bench.arm()
    monkeypatch.setattr(bench.bus, "bulk_write", broken)
    with pytest.raises(DeviceError, match="check the cable"):
        bench.camera.trigger()


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
