"""The USB3 Vision driver over an emulated camera, when frames, cable, bus or camera go wrong."""

import errno
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from test_usb3vision import WIDTH, Bench

from fringed.data import CameraSettings
from fringed.devices.camera.usb3vision import Usb3VisionCamera
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.emulators.u3v import EmulatedUsb, OtherDevice
from fringed.emulators.u3v_camera import EmulatedU3vCamera
from fringed.emulators.u3v_memory import EmulatedIdentity
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, FringedError, ProtocolError


@pytest.fixture
def bench():
    made = Bench()
    made.camera.open()
    yield made
    made.camera.close()
    assert made.bus.opened == 0


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
