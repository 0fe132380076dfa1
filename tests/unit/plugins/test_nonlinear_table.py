"""Tables of the phase error, the ripple of few steps against many, and rounding that spares the phase."""

from __future__ import annotations

import numpy as np
import pytest
from gamma_truth import field, gamma_curve, harmonics, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.sinusoidal import PhaseShiftEncoder
from fringed_plugins.phase.nonlinear.harmonics import phase_error
from fringed_plugins.phase.nonlinear.ripple import equal_steps, likeness, subset_ripple
from fringed_plugins.phase.nonlinear.rounding import nearest_levels, quiet_levels
from fringed_plugins.phase.nonlinear.table import error_series, plane_error, series_error, subtract_table, table_of

RATIOS = harmonics(2.2) * 0.7 ** (np.arange(13) ** 2 / 4)  # some blur
RATIOS[:2] = 1


def bent(true, steps):
    return true + phase_error(RATIOS, steps, true)


@pytest.mark.parametrize("steps", [3, 4, 5])
@pytest.mark.parametrize("turns", [0, 40])
def test_a_table_undoes_the_error_it_was_measured_from(steps, turns):
    true = np.linspace(-np.pi, np.pi, 40_000) + 2 * np.pi * turns
    amplitudes, left = error_series(bent(true, steps) - true, true, steps)
    assert left < 2e-4
    corrected = subtract_table(bent(true, steps).astype(np.float32), table_of(amplitudes, steps))
    # Four harmonics of the ripple, 256 entries with straight lines between: (2 pi / 256)^2 / 8 of 9 x 0.2 rad.
    np.testing.assert_allclose(corrected, true, atol=4e-4)


def test_noise_and_outliers_do_not_bend_a_table():
    rng = np.random.default_rng(0)
    true = rng.uniform(-np.pi, np.pi, 50_000)
    error = phase_error(RATIOS, 3, true) + 0.05 * rng.standard_normal(len(true))
    error[::50] += 2.0
    error[::33] = np.nan
    amplitudes, left = error_series(error, true, 3)
    np.testing.assert_allclose(series_error(amplitudes, 3, true), phase_error(RATIOS, 3, true), atol=3e-3)
    assert left == pytest.approx(0.05, rel=0.05)


def test_a_table_needs_pixels_and_phases():
    with pytest.raises(ValueError, match="500 or more"):
        error_series(np.zeros(10), np.zeros(10), 3)
    with pytest.raises(ValueError, match="less than one ripple"):
        error_series(np.zeros(5000), np.zeros(5000), 3)
    with pytest.raises(ValueError, match="make a plane"):
        plane_error(np.full((50, 50), np.nan, np.float32))


def test_what_departs_from_a_plane_is_its_ripple():
    y, x = np.mgrid[0:150, 0:200]
    true = 380 * (0.9 * x + 0.02 * y + 3) / (200 + 0.1 * x - 0.05 * y)  # a plane seen by a pinhole: 60 fringes
    found = plane_error(bent(true, 3).astype(np.float32))
    amplitudes, _ = error_series(found, bent(true, 3) - found, 3)
    corrected = subtract_table(bent(true, 3).astype(np.float32), table_of(amplitudes, 3))
    assert np.std(corrected - true) < 0.05 * np.std(bent(true, 3) - true)


def test_nan_and_the_edges_of_a_turn():
    phase = np.array([[np.nan, np.pi, -np.pi, 0.0]], np.float32)
    table = np.full(256, 0.25)
    np.testing.assert_allclose(subtract_table(phase, table), phase - np.float32(0.25), atol=1e-6)


# Few steps against many.


def frames_of(steps, curve=None, precompensate=False, **params):
    u, sigma = field()
    target = ProjectorTarget(1024, 768, curve if precompensate else None)
    sequence = PhaseShiftEncoder().encode(PhaseShiftEncoder.Params(periods=64, steps=steps, **params), target)
    return seen(sequence, u, sigma, gamma_curve())


def test_many_steps_hold_few_and_tell_their_ripple():
    found = frames_of(12)
    shifts = [frame.shift_rad for frame in found.sequence.frames]
    valid = np.ones(found.frames.shape[1:], bool)
    ripple = {steps: subset_ripple(found.frames, shifts, steps, valid) for steps in (3, 4, 6)}
    sigma = field()[1]
    rows = np.exp(-2 * (np.pi * sigma[:, :1] / 16) ** 2 * (2**2 - 1)) * harmonics(2.2)[2]
    assert ripple[3].rms_rad == pytest.approx(np.sqrt(np.mean(rows**2) / 2), rel=0.1)
    assert ripple[3].rms_rad > 10 * ripple[4].rms_rad
    shuffled = np.random.default_rng(0).permutation(12)
    again = subset_ripple(found.frames[shuffled], np.array(shifts)[shuffled], 3, valid)
    assert again.rms_rad == pytest.approx(ripple[3].rms_rad, rel=1e-6)


def test_a_compensated_set_has_hardly_any():
    plain, straight = frames_of(12), frames_of(12, gamma_curve(), precompensate=True)
    shifts = [frame.shift_rad for frame in plain.sequence.frames]
    valid = np.ones(plain.frames.shape[1:], bool)
    before, after = (subset_ripple(found.frames, shifts, 3, valid).rms_rad for found in (plain, straight))
    assert after < before / 50


def test_steps_that_do_not_hold_others_are_refused():
    shifts = 2 * np.pi * np.arange(7) / 7
    with pytest.raises(ValueError, match="take a multiple"):
        subset_ripple(np.zeros((7, 30, 30)), shifts, 3, np.ones((30, 30), bool))
    with pytest.raises(ValueError, match="not equal steps"):
        equal_steps([0.0, 1.0, 2.0])


def test_likeness_tells_surfaces_apart():
    y, x = np.mgrid[0:120, 0:160] / 120
    plane = 100 * np.exp(-((x - 0.6) ** 2 + (y - 0.5) ** 2) / 2)
    ball = np.where((x - 0.6) ** 2 + (y - 0.5) ** 2 < 0.16, 150 * np.sqrt(1 - (x - 0.6) ** 2 - (y - 0.5) ** 2), 5)
    assert likeness(plane, 0.5 * plane + 3) > 0.999
    assert likeness(plane, ball) < 0.9
    assert likeness(ball, np.roll(ball, 30, axis=1)) < 0.9
    assert likeness(np.ones((5, 7)), np.ones((5, 7))) == 1.0
    assert likeness(np.array([[3]]), np.array([[4]])) == 1.0


# Rounding.


@pytest.mark.parametrize(("period", "steps"), [(16, 4), (16, 8), (24, 3), (32, 4)])
def test_rounding_moves_the_error_where_the_phase_does_not_see_it(period, steps):
    curve = gamma_curve()
    wanted = (1 + np.cos(2 * np.pi * np.arange(960) / period)) / 2
    orders = [k for k in range(2, period // 2) if k % steps in (1, steps - 1)]

    def size(levels):
        """Return what reaches the phase behind a blur of 0.8 px."""
        spectrum = np.abs(np.fft.rfft(curve[levels] - wanted)) * 2 / len(wanted)
        damping = [np.exp(-2 * (np.pi * 0.8 * k / period) ** 2) for k in orders]
        return np.sqrt(np.sum((damping * spectrum[[k * 960 // period for k in orders]]) ** 2))

    plain, quiet = nearest_levels(wanted, curve), quiet_levels(wanted, curve, period, steps)
    assert size(quiet) < 0.7 * size(plain)
    assert np.abs(curve[quiet] - wanted).max() < 2 * np.diff(curve).max()


def test_frames_that_are_shifts_of_each_other_stay_so():
    curve, u = gamma_curve(), np.arange(64)
    first, second = (quiet_levels((1 + np.cos(2 * np.pi * (u + shift) / 16)) / 2, curve, 16, 4) for shift in (0, 4))
    np.testing.assert_array_equal(np.roll(first, -4), second)


@settings(max_examples=20, deadline=None)
@given(period=st.floats(4.0, 40.0), steps=st.integers(0, 8), gamma=st.floats(1.0, 3.0))
def test_rounded_levels_stay_near_the_wanted_light(period, steps, gamma):
    curve = gamma_curve(gamma)
    wanted = (1 + np.cos(2 * np.pi * np.arange(240) / period)) / 2
    levels = quiet_levels(wanted, curve, period, steps)
    assert levels.dtype == np.uint8
    assert np.abs(curve[levels] - wanted).max() <= 4 * np.diff(curve).max()
    if abs(period - round(period)) > 1e-6:
        np.testing.assert_array_equal(levels, nearest_levels(wanted, curve))
