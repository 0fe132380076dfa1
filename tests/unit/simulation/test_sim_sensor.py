"""Electrons to numbers: the statistics of the noise, and that it can be repeated."""

import msgspec
import numpy as np
import pytest

from fringed.config import SimulationConfig
from fringed.data import CameraSettings
from fringed.errors import UsageError
from fringed.simulation import rows
from fringed.simulation.sensor import Sensor

SHAPE = (500, 400)
CONFIG = msgspec.convert({"sensor": {"width_px": 400, "height_px": 500}}, SimulationConfig)
QUIET = msgspec.structs.replace(CONFIG.sensor, dsnu_electrons=0.0, prnu=0.0)


def sensor_with(**changes):
    return Sensor(msgspec.structs.replace(CONFIG, **changes))


@pytest.mark.parametrize("electrons", [0.0, 500.0, 8000.0])
def test_noise_has_the_variance_of_shot_and_read_noise_and_rounding(electrons):
    sensor = sensor_with(sensor=QUIET)
    settings = sensor.in_force(CameraSettings(bits=12, exposure_us=8333.333))
    frame = sensor.digitise(np.full(SHAPE, electrons, np.float32), settings, 7).astype(float)
    dark = 20 * 8333.333e-6
    per_dn = settings.electrons_per_dn
    offset = 2.0 * 4095 / 255
    expected = (electrons + dark + 12**2) / per_dn**2 + 1 / 12
    # 200,000 samples: the mean is known to sd / 447, the variance to sqrt(2) / 447 of itself
    assert frame.mean() == pytest.approx(offset + (electrons + dark) / per_dn, abs=5 * np.sqrt(expected) / 447)
    assert frame.var() == pytest.approx(expected, rel=5 * np.sqrt(2) / 447)


def test_noise_is_gaussian_and_independent_from_pixel_to_pixel_and_frame_to_frame():
    sensor = sensor_with(sensor=QUIET)
    settings = sensor.in_force(CameraSettings(bits=16))
    flat = np.full(SHAPE, 5000.0, np.float32)
    frames = np.stack([sensor.digitise(flat, settings, counter).astype(float) for counter in (1, 2)])
    z = (frames - frames.mean()) / frames.std()
    assert np.mean(z**4) == pytest.approx(3.0, abs=5 * np.sqrt(96 / z.size))
    assert np.abs(z).max() > 4.0
    for a, b in ((z[0], z[1]), (z[0][:, :-1], z[0][:, 1:]), (z[0][:-1], z[0][1:])):
        assert abs((a * b).mean()) < 5 / np.sqrt(a.size)


def test_the_same_seed_and_counter_give_the_same_frame_on_any_number_of_threads(monkeypatch):
    flat = np.full(SHAPE, 3000.0, np.float32)
    settings = sensor_with().in_force(CameraSettings())
    first = sensor_with().digitise(flat, settings, 3)
    monkeypatch.setattr(rows, "BLOCKS_PER_THREAD", 17)
    assert (sensor_with().digitise(flat, settings, 3) == first).all()
    monkeypatch.setattr(rows, "threads", lambda: 1)
    assert (sensor_with().digitise(flat, settings, 3) == first).all()
    assert (sensor_with().digitise(flat, settings, 4) != first).mean() > 0.5
    assert (sensor_with(seed=2).digitise(flat, settings, 3) != first).mean() > 0.5


def test_fixed_patterns_belong_to_the_sensor():
    sensor = sensor_with()
    assert sensor.sensitivity().std() == pytest.approx(0.01, rel=0.02)
    assert sensor.sensitivity().mean() == pytest.approx(1.0, abs=2e-4)
    assert (sensor.sensitivity() == sensor_with().sensitivity()).all()
    settings = sensor.in_force(CameraSettings(bits=16))
    dark = np.zeros(SHAPE, np.float32)
    mean = np.mean([sensor.digitise(dark, settings, k).astype(float) for k in range(100)], axis=0)
    electrons = mean.std() * settings.electrons_per_dn
    assert electrons == pytest.approx(np.hypot(2.0, 12 / 10), rel=0.05)


def test_frames_saturate_at_the_full_well_and_at_the_last_number():
    sensor = sensor_with(noise=False)
    flood = np.full(SHAPE, 1e6, np.float32)
    assert (sensor.digitise(flood, sensor.in_force(CameraSettings(bits=8)), 0) == 255).all()
    assert (sensor.digitise(flood, sensor.in_force(CameraSettings(bits=12)), 0) == 4095).all()
    without_offset = sensor_with(noise=False, sensor=msgspec.structs.replace(QUIET, offset_dn=0.0))
    half = np.full(SHAPE, 13000.0 / 2, np.float32)
    frame = without_offset.digitise(half, without_offset.in_force(CameraSettings(bits=8)), 0)
    assert (frame == 128).all()


def test_gain_makes_a_number_of_fewer_electrons():
    sensor = sensor_with(noise=False)
    plain, loud = (sensor.in_force(CameraSettings(gain_db=gain)) for gain in (0.0, 20.0))
    assert plain.electrons_per_dn == pytest.approx(13000 / 255)
    assert loud.electrons_per_dn == pytest.approx(1300 / 255)
    assert plain.read_noise_electrons == 0.0
    assert sensor_with().in_force(CameraSettings()).read_noise_electrons == 12.0


def test_unquantised_frames_have_sixteen_bits_whatever_was_asked():
    sensor = sensor_with(noise=False, quantise=False)
    settings = sensor.in_force(CameraSettings(bits=8))
    assert settings.bits == 16
    assert sensor.digitise(np.full(SHAPE, 100.0, np.float32), settings, 0).dtype == np.uint16


@pytest.mark.parametrize("wrong", [{"exposure_us": 0.0}, {"exposure_us": float("nan")}, {"bits": 4}, {"bits": 24}])
def test_settings_that_the_sensor_has_not_are_refused(wrong):
    with pytest.raises(UsageError, match="asked"):
        sensor_with().in_force(CameraSettings(**wrong))
