"""Harmonics of fringes against the closed form of a gamma, and their removal on an independent blurred projector."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from gamma_truth import field, gamma_curve, harmonics, seen

from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder
from fringed_plugins.phase.nonlinear import harmonics as model
from fringed_plugins.phase.nonlinear.blur import blur_indicator
from fringed_plugins.phase.nonlinear.regional import estimate_harmonics, remove
from fringed_plugins.phase.nonlinear.regional_fit import Fringes


def by_definition(ratios, steps, phase):
    """Return the error of N steps by taking the N frames and their arctangent."""
    total = 0
    for n in range(steps):
        shift = 2 * np.pi * n / steps
        frame = sum(b * np.cos(k * (phase + shift)) for k, b in enumerate(ratios))
        total = total + frame * np.exp(-1j * shift)
    return np.angle(total * np.exp(-1j * phase))


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2, 3.0])
def test_harmonics_of_a_gamma_are_those_of_its_closed_form(gamma):
    found = model.tone_harmonics(gamma_curve(gamma), count=8)
    # The curve is interpolated between 256 levels: a second-order error of (1/255)^2, a little more near black.
    np.testing.assert_allclose(found[1:], harmonics(gamma, 8)[1:], atol=2e-5)


@pytest.mark.parametrize("steps", [3, 4, 5, 6, 8, 12])
def test_the_error_of_a_phase_is_what_its_frames_give(steps):
    phase = np.linspace(-np.pi, np.pi, 101)
    ratios = harmonics(2.2)
    np.testing.assert_allclose(model.phase_error(ratios, steps, phase), by_definition(ratios, steps, phase), atol=1e-12)


def test_more_steps_see_less_and_double_steps_as_much_as_twice_the_steps():
    phase = np.linspace(-np.pi, np.pi, 2000, endpoint=False)
    ratios = harmonics(2.2, 16)
    rms = {n: np.sqrt(np.mean(model.phase_error(ratios, n, phase) ** 2)) for n in (3, 4, 5, 6)}
    assert rms[3] > 10 * rms[4] > 10 * rms[5]
    pair = [model.phase_error(ratios, 3, phase + shift) for shift in (0.0, np.pi / 3)]
    double = np.sqrt(np.mean((sum(pair) / 2) ** 2))
    assert double < 0.15 * rms[3]  # what is left are even multiples of the ripple, of second order in B_2


def test_blur_takes_more_of_the_higher_harmonics():
    ratios = harmonics(2.2, 6)
    damped = model.blurred(ratios, 0.08)
    u = 2 * np.pi * np.arange(256) / 256
    light = ((1 + np.cos(u)) / 2) ** 2.2
    kernel = np.exp(-0.5 * ((np.arange(256) - 128) / (0.08 * 256)) ** 2)
    smooth = np.fft.ifft(np.fft.fft(light) * np.fft.fft(np.fft.ifftshift(kernel / kernel.sum()))).real
    np.testing.assert_allclose(damped[1:], model.harmonics_of(smooth, 6)[1:], atol=1e-4)


@pytest.mark.parametrize("steps", [4, 5, 6, 12])
def test_second_harmonic_shows_in_the_misfit(steps):
    rng = np.random.default_rng(0)
    phase = rng.uniform(-np.pi, np.pi, 20_000)
    shifts = 2 * np.pi * np.arange(steps) / steps
    total = phase + shifts[:, None]
    frames = (100 + 60 * np.cos(total) + 60 * 0.03 * np.cos(2 * total)).astype(np.float32)
    frames += rng.standard_normal(frames.shape).astype(np.float32)
    found, uneven = model.second_harmonic(frames, shifts)
    assert found == pytest.approx(0.03, abs=1e-3)  # 1/60 noise, 20,000 pixels: 2e-4
    assert uneven < 0.02


def test_three_steps_hide_the_second_harmonic():
    with pytest.raises(ValueError, match="4 or more show it"):
        model.second_harmonic(np.zeros((3, 10), np.float32), np.arange(3) * 2 * np.pi / 3)
    with pytest.raises(ValueError, match="no fundamental"):
        model.harmonics_of(np.ones(16))


# Harmonics that a multi-frequency set tells by itself.


@lru_cache
def maps(steps, gamma=2.2, noise_dn=0.0, sigmas=(1.0, 2.2), periods=(8, 64), seed=0):
    """Return the true fine phase, the measured one, and the fringes, fine first, of 1024 columns."""
    u, sigma = field(sigmas=sigmas)
    params = MultiFrequencyEncoder.Params(periods=[1, *periods], steps=steps, precompensate=False)
    sequence = MultiFrequencyEncoder().encode(params, ProjectorTarget(1024, 768))
    frames = seen(sequence, u, sigma, gamma_curve(gamma), noise_dn=noise_dn, seed=seed).frames.astype(float)
    found = []
    for number in (2, 1):
        stack = frames[number * steps : (number + 1) * steps]
        turns = np.exp(-2j * np.pi * np.arange(steps) / steps)
        vector = (2 / steps * np.tensordot(turns, stack, 1)).astype(np.complex64)
        found.append(Fringes(vector, steps, 1024 / periods[number - 1]))
    true = 2 * np.pi * u * periods[-1] / 1024
    measured = true + np.angle(found[0].vector * np.exp(-1j * true))
    return true, measured.astype(np.float32), found


@pytest.mark.parametrize(("steps", "least"), [(3, 10.0), (4, 3.0)])
def test_harmonics_that_follow_the_blur_are_taken_off_without_any_calibration(steps, least):
    true, measured, fringes = maps(steps)
    found = estimate_harmonics(measured, fringes[0], fringes[1:])
    assert found.converged, found.reason
    before = np.std(measured - true)
    after = np.std(remove(measured, found) - true)
    assert before > 0.1 if steps == 3 else before > 0.002
    assert after < before / least
    assert found.rms_rad == pytest.approx(before, rel=0.15)


def test_one_strength_for_the_whole_field_is_not_enough():
    true, measured, fringes = maps(3)
    plain = estimate_harmonics(measured, fringes[0], fringes[1:], blur_terms=1)
    blurred = estimate_harmonics(measured, fringes[0], fringes[1:])
    assert np.std(remove(measured, blurred) - true) < 0.3 * np.std(remove(measured, plain) - true)


def test_noise_is_averaged_over_the_view():
    true, measured, fringes = maps(3, noise_dn=1.0)
    found = estimate_harmonics(measured, fringes[0], fringes[1:])
    _, clean, _ = maps(3)
    bias = np.std(remove(clean, found) - true)  # the same coefficients on a map without noise
    assert bias < 0.02
    assert 0.0003 < found.deviation_rad < 0.01


def test_fringes_without_harmonics_stay_as_they_are():
    true, measured, fringes = maps(4, gamma=1.0)
    found = estimate_harmonics(measured, fringes[0], fringes[1:])
    # What is left are the rounded grey levels of the coarse fringes, 8 times larger in the fine phase.
    assert np.abs(remove(measured, found) - measured).max() < 0.006
    assert np.std(remove(measured, found) - true) < 0.004


def test_masked_pixels_wrong_orders_and_order_in_memory_do_no_harm():
    true, measured, fringes = maps(3)
    spoiled = measured.copy()
    spoiled[:, ::3] = np.nan
    spoiled[::7] += np.float32(2 * np.pi)
    spoiled = np.asfortranarray(spoiled)
    spoiled.setflags(write=False)
    found = estimate_harmonics(spoiled, fringes[0], fringes[1:])
    out = remove(spoiled, found)
    assert np.array_equal(np.isnan(out), np.isnan(spoiled))
    error = np.angle(np.exp(1j * (out - true)))
    assert np.nanstd(error) < 0.1 * np.std(measured - true)


def test_a_harmonic_too_strong_for_three_steps_is_told():
    _, measured, fringes = maps(3, gamma=2.6, sigmas=(0.3, 0.5))
    found = estimate_harmonics(measured, fringes[0], fringes[1:])
    assert not found.converged
    assert "take more steps" in found.reason


def test_what_cannot_be_told_is_refused():
    _, measured, fringes = maps(3)
    with pytest.raises(ValueError, match="one frequency"):
        estimate_harmonics(measured, fringes[0], [])
    with pytest.raises(ValueError, match="blur terms"):
        estimate_harmonics(measured, fringes[0], fringes[1:], blur_terms=4)
    with pytest.raises(ValueError, match="0 pixels"):
        estimate_harmonics(np.full_like(measured, np.nan), fringes[0], fringes[1:])
    found = estimate_harmonics(measured, fringes[0], fringes[1:])
    with pytest.raises(ValueError, match="shape"):
        remove(measured[:4], found)


def test_the_blur_indicator_is_that_of_the_lens_and_not_of_the_surface():
    _, measured, fringes = maps(4)
    spots = (1 + 0.5 * np.sin(np.arange(measured.size).reshape(measured.shape) / 7)).astype(np.float32)
    valid = np.isfinite(measured)
    plain, spotted = (
        blur_indicator((fringes[0].vector * s, 4), (fringes[1].vector * s, 4), valid) for s in (np.float32(1), spots)
    )
    np.testing.assert_allclose(plain, spotted, atol=1e-3)
    sigma = np.linspace(1.0, 2.2, len(measured))
    expected = -2 * (np.pi * sigma) ** 2 * (1 / 16**2 - 1 / 128**2)
    rows = slice(8, -8)
    measured_rows = plain.mean(axis=1)[rows]
    # The pixel's own width and the gamma's fundamental shift the logarithm by a constant.
    assert np.std(measured_rows - expected[rows]) < 0.01
    assert not blur_indicator((fringes[0].vector, 4), (fringes[1].vector, 4), np.zeros_like(valid)).any()
