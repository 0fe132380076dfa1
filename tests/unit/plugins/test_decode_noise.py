"""Phase noise beside what theory allows: least squares, weighted least squares, the Cramer-Rao bound."""

from __future__ import annotations

import numpy as np
import pytest
from fringe_truth import run, seen, wrapped

from fringed.data import CameraSettings
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.sinusoidal import PhaseShiftDecoder
from fringed_plugins.encoders.sinusoidal import PhaseShiftEncoder
from fringed_plugins.phase.decode import decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel, estimate_noise, noise_group
from fringed_plugins.phase.shifts import Group
from fringed_plugins.phase.weighting import weigh

OPEN = Thresholds(modulation_dn=0.0, modulation_snr=0.0, residual=10.0, similar_neighbours=0, border_glow=0.0)
SENSOR = NoiseModel((12 / 51) ** 2, 1 / 51)  # 12 electrons of read noise, 51 for a grey level: a full well of 13 ke-
PHASES = np.linspace(-np.pi, np.pi, 96, endpoint=False) + 0.01
ROWS = 1200


def group(steps):
    return Group(tuple(range(steps)), tuple(2 * np.pi * np.arange(steps) / steps), 16.0)


def light(steps, background, modulation):
    """Return the exact intensities (steps, 96) for 96 phases."""
    shifts = 2 * np.pi * np.arange(steps) / steps
    return background + modulation * np.cos(PHASES + shifts[:, None])


def bound_rad(steps, background, modulation, noise):
    """Return the Cramer-Rao bound for each phase, background and modulation being unknown too."""
    shifts = 2 * np.pi * np.arange(steps) / steps
    variance = noise.constant_dn2 + noise.slope_dn * light(steps, background, modulation)
    angle = PHASES + shifts[:, None]
    gradient = np.stack([np.ones_like(angle), np.cos(angle), -modulation * np.sin(angle)], axis=-1)
    information = np.einsum("kxi,kxj,kx->xij", gradient, gradient, 1 / variance)
    return np.sqrt(np.linalg.inv(information)[:, 2, 2])


def noisy(steps, background, modulation, noise, seed=0):
    """Return frames (steps, rows, 96) with Gaussian noise of the model's variance."""
    ideal = light(steps, background, modulation)[:, None, :]
    rng = np.random.default_rng(seed)
    scatter = np.sqrt(noise.constant_dn2 + noise.slope_dn * ideal)
    return (ideal + scatter * rng.normal(size=(steps, ROWS, PHASES.size))).astype(np.float32)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values, dtype=float))))


# 115,200 errors: their deviation is known to 0.2 %; 3 % is the figure that issue 3 asks for.
@pytest.mark.parametrize("steps", range(3, 17))
def test_read_noise_is_at_the_cramer_rao_bound(steps):
    noise = NoiseModel(1.5**2, 0.0)
    got = decode(noisy(steps, 110, 80, noise, steps), [group(steps)], noise, OPEN, threads=1)
    bound = rms(bound_rad(steps, 110, 80, noise))
    assert rms(wrapped(got.phase_rad - PHASES)) == pytest.approx(bound, rel=0.03)
    assert rms(got.sigma_rad) == pytest.approx(bound, rel=0.03)


@pytest.mark.parametrize("modulation", [50, 100])
@pytest.mark.parametrize("steps", range(3, 17))
def test_shot_and_read_noise_are_at_the_bound_with_weights(steps, modulation):
    frames = noisy(steps, 110, modulation, SENSOR, steps)
    got = decode(frames, [group(steps)], SENSOR, OPEN, threads=1)
    weigh(got.phase_rad, got.sigma_rad, frames, group(steps), SENSOR, threads=1)
    bound = rms(bound_rad(steps, 110, modulation, SENSOR))
    assert rms(wrapped(got.phase_rad - PHASES)) == pytest.approx(bound, rel=0.03)
    assert rms(got.sigma_rad) == pytest.approx(bound, rel=0.03)


@pytest.mark.parametrize("steps", [3, 4, 8, 16])
@pytest.mark.parametrize(("modulation", "loss"), [(40, 1.03), (100, 1.24)])
def test_without_weights_sigma_tells_what_shot_noise_costs(steps, modulation, loss):
    got = decode(noisy(steps, 110, modulation, SENSOR, steps), [group(steps)], SENSOR, OPEN, threads=1)
    error = rms(wrapped(got.phase_rad - PHASES))
    assert rms(got.sigma_rad) == pytest.approx(error, rel=0.03)
    bound = rms(bound_rad(steps, 110, modulation, SENSOR))
    assert 0.98 * bound < error < loss * bound


def test_three_steps_leave_nothing_to_weigh():
    frames = noisy(3, 110, 100, SENSOR)
    got = decode(frames, [group(3)], SENSOR, OPEN, threads=1)
    before = got.phase_rad.copy()
    weigh(got.phase_rad, got.sigma_rad, frames, group(3), SENSOR, threads=1)
    assert np.abs(wrapped(got.phase_rad - before)).max() < 5e-6  # three numbers fit three unknowns exactly


def test_dropped_pixels_stay_dropped_when_weighed():
    frames = noisy(4, 110, 100, SENSOR)[:, :4]
    phase = np.full(frames.shape[1:], np.nan, np.float32)
    phase[1] = 0.5
    sigma = phase.copy()
    weigh(phase, sigma, frames, group(4), SENSOR, threads=1)
    assert np.isnan(phase[[0, 2, 3]]).all() and np.isnan(sigma[[0, 2, 3]]).all()
    assert np.isfinite(phase[1]).all()


def test_the_decoder_weighs_where_it_is_asked_to():
    sequence = PhaseShiftEncoder().encode(PhaseShiftEncoder.Params(periods=64.0, steps=8), ProjectorTarget(1024, 768))
    u = np.linspace(5, 1015, 400) + np.zeros((300, 1))
    settings = CameraSettings(electrons_per_dn=51.0, read_noise_electrons=12.0)
    clean = seen(sequence, u, gain=0.8, settings=settings)
    rng = np.random.default_rng(0)
    shaken = clean.frames + np.sqrt(SENSOR.constant_dn2 + SENSOR.slope_dn * clean.frames) * rng.normal(
        size=clean.frames.shape
    )
    frames = type(clean)(np.clip(np.rint(shaken), 0, 255).astype(np.uint8), sequence, settings=settings)
    truth = 2 * np.pi * u / 16
    plain, weighed = (run(PhaseShiftDecoder, {"frames": frames}, weights=w) for w in ("equal", "noise"))
    scatter = [np.nanstd(wrapped(phase.phase_rad - truth)) for phase in (plain, weighed)]
    assert scatter[1] < 0.9 * scatter[0]  # fringes from black to white: a fifth of the deviation is to be had
    # What is not the camera's noise: the projector's grey levels are rounded, 0.05 DN^2 where a dark frame has 0.14.
    assert np.nanmedian(weighed.sigma_rad) == pytest.approx(scatter[1], rel=0.1)


def test_noise_is_estimated_from_the_first_group_with_a_residual():
    groups = [group(3), Group((3, 4, 5, 6, 7), tuple(2 * np.pi * np.arange(5) / 5), 8.0), group(4)]
    assert noise_group(groups) is groups[1]
    assert noise_group(groups[:1]) is groups[0]


def test_noise_of_a_picture_without_three_lines_is_a_guess():
    assert estimate_noise(np.zeros((4, 2, 50), np.uint8), group(4), "columns") == NoiseModel(1.0, 0.0)
    assert estimate_noise(np.zeros((4, 50, 2), np.uint8), group(4), "rows") == NoiseModel(1.0, 0.0)
