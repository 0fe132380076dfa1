"""The MS3100 as one camera: settings to the serial line, frames from an image transport, all that cannot be refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from duncantech_lines import EmulatorProcess, MemoryLine, PtyPort

from fringed.config import simulated_station, validate
from fringed.data import CameraSettings
from fringed.devices import building
from fringed.devices.building import DriverContext, build_devices
from fringed.devices.camera.base import MachineClock
from fringed.devices.camera.duncantech import DUNCANTECH, DuncanTechCamera
from fringed.devices.camera.duncantech_control import DuncanTechControl
from fringed.devices.camera.duncantech_options import DuncanTechOptions, control_settings
from fringed.emulators.ms3100_camera import EmulatedMs3100
from fringed.errors import ConfigurationError, DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.hookspecs import Adjustable, Camera, Driver, Params, RawFrame, Setting, Watched

WIDTH, HEIGHT = 24, 16
SMALL = {
    "port": "memory",
    "images": {"driver": "fake"},
    "width_px": WIDTH,
    "height_px": HEIGHT,
    "reply_timeout_s": 0.03,
}


class FakeImages:
    """An image transport that counts its frames and fills red, green and blue with 10, 20 and 30."""

    simulated = replayed = False
    period_s = 0.0

    def __init__(self, size_px: tuple[int, int] = (WIDTH, HEIGHT)) -> None:
        self.clock, self.size_px = MachineClock(), size_px
        self.armed: CameraSettings | None = None
        self.log: list[str] = []
        self.counter = 0
        self.gone = False
        self.brings: dict[str, Any] = {}

    def open(self) -> str:
        self.log.append("open")
        return "fake frames"

    def close(self) -> None:
        self.armed = None
        self.log.append("close")

    def arm(self, settings: CameraSettings) -> CameraSettings:
        self.armed = replace(settings, electrons_per_dn=51.0, read_noise_electrons=12.0, **self.brings)
        return self.armed

    def disarm(self) -> None:
        self.armed = None

    def trigger(self) -> None:
        self.log.append("trigger")

    def read(self, timeout_s: float) -> RawFrame:
        assert self.armed is not None
        if self.gone:
            raise DeviceAbsent("fake frames are gone")
        self.counter += 1
        image = np.zeros((HEIGHT, WIDTH, 3), np.uint8 if self.armed.bits == 8 else np.uint16) + np.array([10, 20, 30])
        image = image.astype(np.uint8 if self.armed.bits == 8 else np.uint16)
        if self.armed.channel != "rgb":
            image = image[..., 0]
        return RawFrame(image, self.counter, 0.0, self.armed.exposure_us * 1e-6)


def camera_of(images: Camera | None = None, **options: Any) -> tuple[DuncanTechCamera, MemoryLine, Any]:
    chosen = validate({**SMALL, **options}, DuncanTechOptions, "camera.options")
    settings = control_settings(chosen)
    line = MemoryLine(EmulatedMs3100(replace(settings.dialect, unverified=True)))
    images = FakeImages() if images is None else images
    camera = DuncanTechCamera(DuncanTechControl(line, settings), images, chosen)
    camera.open()
    return camera, line, images


def test_it_is_a_camera_that_names_both_its_parts() -> None:
    camera, _, images = camera_of()
    as_camera: Camera = camera
    assert "MS3100 on memory" in as_camera.open() and "frames from fake frames" in as_camera.open()
    assert as_camera.size_px == (WIDTH, HEIGHT)
    assert as_camera.period_s == pytest.approx(1 / 7.5)
    assert (as_camera.simulated, as_camera.replayed, as_camera.clock) == (False, False, images.clock)


def test_exposure_goes_to_the_serial_line_and_frames_come_from_the_image_transport() -> None:
    camera, line, images = camera_of(settle_frames=0)
    in_force = camera.arm(CameraSettings(exposure_us=8333.333, channel="green"))
    assert in_force == CameraSettings(
        exposure_us=8375.0, channel="green", electrons_per_dn=51.0, read_noise_electrons=12.0
    )
    assert [line.camera.ccds[channel].lines for channel in (1, 2, 3)] == [67, 64, 64]  # green alone is in use
    assert (images.armed.exposure_us, images.armed.channel) == (8375.0, "rgb")
    frame = camera.read(1.0)
    assert frame.image.shape == (HEIGHT, WIDTH) and frame.image.flags.c_contiguous
    assert (int(frame.image[0, 0]), frame.image.dtype, frame.counter) == (20, np.uint8, 1)


@pytest.mark.parametrize("bits", [8, 10])
def test_three_ccds_in_one_exposure(bits: int) -> None:
    camera, line, _ = camera_of()
    assert camera.arm(CameraSettings(exposure_us=10000, channel="rgb", bits=bits)).bits == bits
    assert {ccd.lines for ccd in line.camera.ccds.values()} == {80}
    image = camera.read(1.0).image
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert image[3, 4].tolist() == [10, 20, 30]
    assert image.dtype == (np.uint8 if bits == 8 else np.uint16)


@pytest.mark.parametrize(("channel", "level"), [("red", 10), ("green", 20), ("blue", 30)])
def test_one_ccd_alone(channel: Any, level: int) -> None:
    camera, _, _ = camera_of()
    camera.arm(CameraSettings(channel=channel))
    assert (camera.read(1.0).image == level).all()


def test_camera_set_to_a_mono_output_delivers_that_and_nothing_else() -> None:
    camera, line, images = camera_of(output="white")
    camera.arm(CameraSettings(exposure_us=1000, channel="white"))
    assert images.armed.channel == "white"
    assert {ccd.lines for ccd in line.camera.ccds.values()} == {8}
    assert camera.read(1.0).image.shape == (HEIGHT, WIDTH)
    with pytest.raises(UsageError, match=r"output mode is 'white'.*bytes are not known"):
        camera.arm(CameraSettings(channel="rgb"))


@pytest.mark.parametrize("output", ["red", "green", "blue"])
def test_mono_output_of_one_ccd_sets_that_ccd(output: Any) -> None:
    camera, line, images = camera_of(output=output)
    assert camera.arm(CameraSettings(exposure_us=1000, channel=output)).channel == output
    assert images.armed.channel == "white"
    channel = camera.control.settings.dialect.channels[output]
    assert {c: ccd.lines for c, ccd in line.camera.ccds.items()} == {c: 8 if c == channel else 64 for c in (1, 2, 3)}


def test_frames_that_may_have_the_old_settings_are_left_out() -> None:
    camera, _, _ = camera_of(settle_frames=2)
    camera.arm(CameraSettings(channel="green"))
    assert [camera.read(1.0).counter for _ in range(2)] == [3, 4]
    camera.arm(CameraSettings(channel="green"))
    with pytest.raises(DeviceStalled, match="settings before"):
        camera.read(0.0)


def test_gain_and_offset_at_zero_db_are_raw_options() -> None:
    camera, line, _ = camera_of(gain={"red": 1, "green": 2, "blue": 3}, offset={"green": 10})
    assert camera.arm(CameraSettings(channel="rgb")).gain_db == 0
    assert [line.camera.ccds[channel].gain for channel in (1, 2, 3)] == [2, 1, 3]
    assert 0x04 not in {line.sent[i + 3] for i in range(0, len(line.sent) - 3) if line.sent[i] == 2}


def test_an_offset_that_differs_needs_unverified_commands() -> None:
    camera, line, _ = camera_of(offset={"green": 11})
    with pytest.raises(UsageError, match="enable_unverified"):
        camera.arm(CameraSettings(channel="green"))
    camera, line, _ = camera_of(offset={"green": 11}, enable_unverified=True)
    camera.arm(CameraSettings(channel="green"))
    assert line.camera.ccds[1].offset == 11


def test_decibels_need_a_measured_step() -> None:
    camera, _, _ = camera_of(gain={"green": 256})
    with pytest.raises(UsageError, match="dB scale of the MS3100's gain is not known"):
        camera.arm(CameraSettings(channel="green", gain_db=6.0))
    camera, line, _ = camera_of(gain={"green": 256}, gain_step_db=0.05)
    in_force = camera.arm(CameraSettings(channel="green", gain_db=6.02))
    assert line.camera.ccds[1].gain == 256 + 120
    assert in_force.gain_db == pytest.approx(6.0)
    assert (in_force.electrons_per_dn, in_force.read_noise_electrons) == (0.0, 0.0)  # not known at that gain
    with pytest.raises(UsageError, match="0 to 1023"):
        camera.arm(CameraSettings(channel="green", gain_db=48.0))


def test_trigger_mode_is_stated_not_set() -> None:
    camera, _, _ = camera_of()
    for trigger in ("software", "hardware"):
        with pytest.raises(UsageError, match=r"trigger mode.*not known.*trigger_mode"):
            camera.arm(CameraSettings(channel="green", trigger=trigger))
    camera.arm(CameraSettings(channel="green"))
    with pytest.raises(UsageError, match="runs freely"):
        camera.trigger()
    camera, _, images = camera_of(trigger_mode="external")
    assert camera.arm(CameraSettings(channel="green", trigger="software")).trigger == "software"
    camera.trigger()
    assert images.log[-1] == "trigger"
    assert camera.read(1.0).counter == 1
    with pytest.raises(UsageError, match="trigger mode 'free-running'"):
        camera.arm(CameraSettings(channel="green"))


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        (CameraSettings(bits=12, channel="green"), "8 or 10"),
        (CameraSettings(exposure_us=10, channel="green"), "125 to 130750 us"),
        (CameraSettings(exposure_us=2e5, channel="green"), "125 to 130750 us"),
        (CameraSettings(channel="white"), "gives rgb, red, green, blue"),
    ],
)
def test_settings_that_it_has_not_change_nothing(settings: CameraSettings, why: str) -> None:
    camera, line, _ = camera_of()
    before = bytes(line.sent)
    with pytest.raises(UsageError, match=why):
        camera.arm(settings)
    assert bytes(line.sent) == before


def test_image_transport_of_another_format_is_named() -> None:
    with pytest.raises(DeviceError, match=r"32 x 16; the MS3100 has 24 x 16.*MS4100"):
        camera_of(FakeImages((32, 16)))
    camera, _, images = camera_of(settle_frames=0)
    images.brings = {"bits": 8}
    with pytest.raises(DeviceError, match="delivers bits 8 where 10 is asked"):
        camera.arm(CameraSettings(channel="green", bits=10))
    images.brings = {}
    camera.arm(CameraSettings(channel="green", bits=10))
    images.armed = replace(images.armed, bits=8)
    with pytest.raises(ProtocolError, match="uint8"):
        camera.read(1.0)


def test_frames_last_as_long_as_the_ccds_integrate_whatever_the_transport_believes() -> None:
    camera, _, images = camera_of()
    images.brings = {"exposure_us": 1000.0}
    assert camera.arm(CameraSettings(exposure_us=8000, channel="green")).exposure_us == 8000
    frame = camera.read(1.0)
    assert (frame.exposure_start_s, frame.exposure_end_s) == (pytest.approx(-0.007), pytest.approx(0.001))


def test_unplugged_control_ends_the_next_read_and_comes_back_by_open() -> None:
    camera, line, images = camera_of()
    camera.arm(CameraSettings(channel="green"))
    line.unplug(comes_back=False)
    with pytest.raises(DeviceAbsent, match="vanished"):
        camera.read(1.0)
    assert images.log[-1] == "close"
    with pytest.raises(DeviceError, match="arm first"):
        camera.read(1.0)
    with pytest.raises(DeviceAbsent, match="no such port"):
        camera.open()
    line.plugged = True
    camera.open()
    camera.arm(CameraSettings(channel="green"))
    assert camera.read(1.0).counter == 2


def test_unplugged_image_transport_ends_the_read_and_frees_the_port() -> None:
    camera, line, images = camera_of()
    camera.arm(CameraSettings(channel="green"))
    images.gone = True
    with pytest.raises(DeviceAbsent, match="frames are gone"):
        camera.read(1.0)
    assert not line.opened
    camera.close()


class AdjustableImages(FakeImages):
    """One that can be asked whether it is there, and has a setting of its own."""

    level = 3

    def check(self) -> None:
        if self.gone:
            raise DeviceAbsent("fake frames are gone")

    def settings(self) -> list[Setting]:
        return [Setting("BlackLevel", self.level)]

    def adjust(self, name: str, value: bool | float | str) -> None:
        assert name == "BlackLevel"
        self.level = int(value)


def test_resting_it_notices_that_one_of_its_parts_has_gone() -> None:
    camera, line, images = camera_of(AdjustableImages())
    as_watched: Watched = camera
    as_watched.check()
    images.gone = True
    with pytest.raises(DeviceAbsent, match="frames are gone"):
        as_watched.check()
    images.gone = False
    line.unplug(comes_back=False)
    with pytest.raises(DeviceAbsent, match="memory"):
        as_watched.check()


def test_own_settings_are_read_and_set_and_those_of_the_transport_too() -> None:
    camera, line, images = camera_of(AdjustableImages())
    as_adjustable: Adjustable = camera
    found = {setting.name: setting for setting in as_adjustable.settings()}
    assert found["green_offset"].value == 10
    assert found["green_gain"].value is None  # its opcode is not enabled
    assert (found["blue_integration"].least, found["blue_integration"].most) == (1, 1046)
    assert not any(found[name].verified for name in found if name != "images_BlackLevel")
    as_adjustable.adjust("red_integration", 99)
    as_adjustable.adjust("images_BlackLevel", 5)
    assert (line.camera.ccds[2].lines, images.level) == (99, 5)
    camera.arm(CameraSettings(channel="green"))
    with pytest.raises(UsageError, match="while the camera is armed"):
        as_adjustable.adjust("red_integration", 9)
    camera.disarm()
    for name in ("infrared_gain", "red_flavour", "red", ""):
        with pytest.raises(UsageError, match=r"it has red_gain, red_offset"):
            as_adjustable.adjust(name, 1)


def test_enabled_unverified_opcodes_fill_in_the_values() -> None:
    camera, _, _ = camera_of(enable_unverified=True)
    found = {setting.name: setting.value for setting in camera.settings()}
    assert (found["green_gain"], found["green_offset"], found["green_integration"]) == (256, 10, 64)


def test_faults_of_the_line_while_arming_are_repaired() -> None:
    camera, line, _ = camera_of(enable_unverified=True)
    for fault in ("drop", "garble", "late", "lose"):
        line.camera.order(fault, 1)
        camera.arm(CameraSettings(exposure_us=20000, channel="rgb"))
        assert {ccd.lines for ccd in line.camera.ccds.values()} == {160}


def test_simulated_light_follows_the_exposure_on_the_serial_line() -> None:
    sensor = {"width_px": 116, "height_px": 87}
    station = {"real_time": False, "noise": False, "sensor": sensor, "scene": {"object": "plane", "ambient": 0.3}}
    devices = build_devices(simulated_station({"simulation": station, "camera": {"options": {"warm_up": False}}}))
    camera, _, _ = camera_of(devices.camera, **sensor)
    means = []
    try:
        for exposure_us in (4000, 8000):
            in_force = camera.arm(CameraSettings(exposure_us=exposure_us, channel="rgb", bits=10))
            assert (in_force.exposure_us, in_force.bits) == (exposure_us, 10)
            frame = camera.read(5.0)
            assert frame.exposure_end_s - frame.exposure_start_s == pytest.approx(exposure_us * 1e-6)
            means.append(frame.image.mean())
    finally:
        camera.close()
    assert camera.simulated
    assert means[1] == pytest.approx(2 * means[0], rel=0.1)


@pytest.fixture
def fake_driver(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    built: list[Any] = []

    class FakeOptions(Params, frozen=True, kw_only=True):
        lamp: bool = False

    def make(options: Any, context: Any) -> FakeImages:
        built.append((options, context))
        return FakeImages()

    monkeypatch.setattr(
        building, "built_in", lambda kind, name: Driver("fake", FakeOptions, make) if name == "fake" else None
    )
    return built


def test_driver_builds_both_parts_from_its_options(fake_driver: list[Any], tmp_path: Path) -> None:
    raw = {**SMALL, "port": str(tmp_path / "none"), "images": {"driver": "fake", "options": {"lamp": True}}}
    context = DriverContext("station", MachineClock())
    camera = DUNCANTECH.create(validate(raw, DUNCANTECH.Options, "camera.options"), context)
    assert fake_driver[0][0].lamp and fake_driver[0][1] is context
    with pytest.raises(DeviceAbsent, match="none"):
        camera.open()


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"images": {"driver": "nothing"}}, r"camera.options.images.driver: 'nothing'"),
        ({"images": {"driver": "duncantech"}}, r"camera.options.images.driver: 'duncantech'"),
        ({"images": {"driver": "fake", "options": {"lamb": 1}}}, r"images.options.lamb.*did you mean 'lamp'"),
        ({"images": {}}, r"camera.options.images.driver: nothing"),
        ({"channels": {"red": 1}}, r"need 1, 2 and 3"),
        ({"opcodes": {"get_gain": 5}}, r"none of them twice"),
        ({"gain": {"red": 2000}}, r"camera.options.gain.red: 2000.*gain_max = 1023"),
        ({"offset": {"red": 200}}, r"camera.options.offset.red: 200"),
        ({"reply_timeout_s": 0}, r"camera.options.reply_timeout_s: 0"),
        ({"output": "bayer"}, r"camera.options.output: 'bayer'"),
    ],
)
def test_wrong_options_are_named_with_what_is_allowed(fake_driver: list[Any], wrong: dict[str, Any], why: str) -> None:
    with pytest.raises(ConfigurationError, match=why):
        DUNCANTECH.create(validate({**SMALL, **wrong}, DUNCANTECH.Options, "camera.options"), None)


def test_with_the_emulator_as_a_process(tmp_path: Path) -> None:
    emulator = EmulatorProcess(tmp_path / "ms3100")
    options = validate({**SMALL, "reply_timeout_s": 2.0}, DuncanTechOptions, "camera.options")
    control = DuncanTechControl(PtyPort(tmp_path / "ms3100"), control_settings(options))
    camera = DuncanTechCamera(control, FakeImages(), options)
    try:
        emulator.next("ready")
        camera.open()
        camera.arm(CameraSettings(exposure_us=25000, channel="rgb"))
        assert {ccd["integration_us"] for ccd in emulator.state()["ccds"].values()} == {25000.0}
        emulator.order(do="unplug")
        emulator.next("unplugged")
        with pytest.raises(DeviceAbsent):
            camera.read(1.0)
        emulator.order(do="plug")
        emulator.next("plugged")
        camera.open()
        camera.arm(CameraSettings(exposure_us=1000, channel="rgb"))
        assert camera.read(1.0).image.shape == (HEIGHT, WIDTH, 3)
    finally:
        camera.close()
        emulator.close()
