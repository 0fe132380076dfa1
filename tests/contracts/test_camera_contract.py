"""What every camera does: over the simulated one always, over a real one with `-m hardware`.

A real camera is named by `FRINGED_HARDWARE_CONFIG`, the path of a station's configuration.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from fringed.config import load_station, simulated_station
from fringed.data import CameraSettings
from fringed.devices.building import build_devices
from fringed.errors import DeviceError, DeviceStalled
from fringed.hookspecs import Camera, Clock
from fringed.loading import load_plugins

SMALL = {"simulation": {"real_time": False, "sensor": {"width_px": 116, "height_px": 87}, "scene": {"object": "plane"}}}


class CameraContract:
    """The promises of `hookspecs.Camera`."""

    @pytest.fixture
    def camera(self) -> Camera:
        raise AssertionError("each class of cameras makes its own")

    @pytest.fixture
    def opened(self, camera):
        camera.open()
        yield camera
        camera.close()

    def test_it_says_whether_it_is_simulated_or_replayed(self, camera):
        assert isinstance(camera.simulated, bool)
        assert isinstance(camera.replayed, bool)

    def test_it_has_every_part_of_the_interface(self, camera):
        for name in ("open", "close", "arm", "disarm", "trigger", "read"):
            assert callable(getattr(camera, name))
        clock: Clock = camera.clock
        before = clock.now()
        clock.sleep(0.01)
        assert clock.now() - before >= 0.0099

    def test_opening_names_the_device(self, opened):
        assert opened.open()

    def test_closing_and_disarming_are_harmless_at_any_time(self, camera):
        camera.close()
        camera.disarm()
        camera.open()
        camera.disarm()
        camera.close()
        camera.close()

    def test_nothing_is_read_from_a_camera_that_is_closed_or_not_armed(self, camera):
        with pytest.raises(DeviceError):
            camera.arm(CameraSettings())
        camera.open()
        with pytest.raises(DeviceError):
            camera.read(0.1)
        camera.close()

    def test_frames_come_at_their_own_pace(self, opened):
        settings = opened.arm(CameraSettings(exposure_us=5000.0, trigger="free-running", channel="green"))
        frames = [opened.read(5.0) for _ in range(4)]
        width, height = opened.size_px
        for frame in frames:
            assert frame.image.shape == (height, width)
            assert frame.image.dtype == (np.uint8 if settings.bits <= 8 else np.uint16)
            assert frame.exposure_end_s - frame.exposure_start_s == pytest.approx(settings.exposure_us * 1e-6, rel=0.05)
            assert frame.exposure_end_s <= opened.clock.now() + 1e-9
        assert np.diff([frame.counter for frame in frames]).tolist() == [1, 1, 1]
        pace = np.diff([frame.exposure_start_s for frame in frames])
        assert pace == pytest.approx(opened.period_s, rel=0.02)

    def test_a_triggered_frame_begins_after_its_trigger(self, opened):
        opened.arm(CameraSettings(exposure_us=5000.0, trigger="software", channel="green"))
        for _ in range(3):
            asked = opened.clock.now()
            opened.trigger()
            frame = opened.read(5.0)
            assert frame.exposure_start_s >= asked

    def test_without_a_trigger_it_stalls_for_as_long_as_it_was_told(self, opened):
        opened.arm(CameraSettings(trigger="software", channel="green"))
        before = opened.clock.now()
        with pytest.raises(DeviceStalled, match=r"0\.25"):
            opened.read(0.25)
        assert opened.clock.now() - before == pytest.approx(0.25, abs=0.2)

    def test_the_settings_in_force_tell_its_noise(self, opened):
        settings = opened.arm(CameraSettings(exposure_us=5000.0, channel="green"))
        assert settings.exposure_us == pytest.approx(5000.0, rel=0.05)
        assert settings.electrons_per_dn > 0
        assert settings.read_noise_electrons > 0

    def test_counters_go_on_when_it_is_armed_again(self, opened):
        opened.arm(CameraSettings(channel="green"))
        first = opened.read(5.0).counter
        opened.disarm()
        opened.arm(CameraSettings(channel="green"))
        assert opened.read(5.0).counter > first


class TestSimulatedCamera(CameraContract):
    @pytest.fixture
    def camera(self):
        return build_devices(simulated_station(SMALL)).camera


@pytest.mark.hardware
class TestRealCamera(CameraContract):
    @pytest.fixture
    def camera(self):
        path = os.environ.get("FRINGED_HARDWARE_CONFIG")
        if not path:
            pytest.skip("FRINGED_HARDWARE_CONFIG names no configuration of a real station")
        return build_devices(load_station(Path(path)), load_plugins).camera
