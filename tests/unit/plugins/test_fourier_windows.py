"""Windowed Fourier filtering and ridges: of frames, and of phase maps whose noise is to go."""

from __future__ import annotations

from dataclasses import replace

import fringe_truth as truth
import numpy as np
import pytest

from fringed.data import PhaseMap
from fringed.errors import Cancelled, DataError
from fringed.hookspecs import ProjectorTarget
from fringed.testing import RecordingContext
from fringed_plugins.decoders.windowed_fourier import WindowedFourier
from fringed_plugins.encoders.fourier import FourierEncoder
from fringed_plugins.phase.single_frame.window_bank import Bank, bank_of, noise_of_coefficients
from fringed_plugins.phase.single_frame.windowed_fourier import filtered, ridges

HEIGHT, WIDTH = 220, 320
X, Y = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
PHASE = 2 * np.pi * X / 16 + 3 * np.exp(-((X - 160) ** 2 + (Y - 110) ** 2) / (2 * 50.0**2))
BANK = Bank((0.15, 0.65), (-0.25, 0.25))
INNER = (slice(40, -40), slice(40, -40))


def off(phase):
    return truth.wrapped(phase - PHASE)


def phase_map(noise_rad, kind="wrapped", sigma=True):
    phase = PHASE + np.random.default_rng(2).normal(0, noise_rad, PHASE.shape)
    values = (truth.wrapped(phase) if kind == "wrapped" else phase).astype(np.float32)
    flat = np.ones_like(values)
    return PhaseMap(values, 50 * flat, 100 * flat, np.zeros(values.shape, np.uint16), kind, 16.0,
                    sigma_rad=noise_rad * flat if sigma else None)  # fmt: skip


def test_without_a_threshold_everything_in_the_bank_comes_back():
    field = np.exp(1j * PHASE).astype(np.complex64)
    found = filtered(field, BANK, 0.0)
    # The sum of the squared windows is flat within 1e-4 inside the bank; its ends are 1/sigma beyond the signal.
    assert np.abs(found.field[INNER] - field[INNER]).max() < 0.03
    assert np.sqrt(np.mean(off(np.angle(found.field))[INNER] ** 2)) < 2e-3


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_real_fringes_become_their_analytic_signal(dtype):
    found = filtered(np.cos(PHASE).astype(dtype), BANK, 0.01)
    assert np.abs(np.abs(found.field[INNER]) - 1).max() < 0.03
    assert np.sqrt(np.mean(off(np.angle(found.field))[INNER] ** 2)) < 3e-3


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_noise_is_bounded_by_what_is_stated(noise):
    field = np.cos(PHASE) + np.random.default_rng(1).normal(0, noise, PHASE.shape)
    found = filtered(field, BANK, 3 * noise_of_coefficients(noise, 10, is_complex=False))
    scatter = np.sqrt(np.mean(off(np.angle(found.field))[INNER] ** 2))
    stated = noise * np.sqrt(np.mean(found.noise_gain[INNER]))
    assert 0.5 * stated < scatter < 1.15 * stated
    assert found.kept < 0.95


def test_coefficients_have_the_noise_that_the_threshold_assumes():
    noise = np.random.default_rng(3).normal(0, 2.0, (256, 256))
    none = filtered(noise, Bank((1.0, 1.5), (-0.3, 0.3), 8.0), 5.5 * noise_of_coefficients(2.0, 8.0, is_complex=False))
    some = filtered(noise, Bank((1.0, 1.5), (-0.3, 0.3), 8.0), noise_of_coefficients(2.0, 8.0, is_complex=False))
    assert none.kept < 1e-3
    assert some.kept == pytest.approx(np.exp(-1), abs=0.08)  # the height of complex Gaussian noise is Rayleigh's


def test_ridge_follows_the_phase_and_its_frequency():
    ridge = ridges(np.cos(PHASE), BANK)
    assert np.sqrt(np.mean(off(ridge.phase_rad)[INNER] ** 2)) < 0.02
    slope = np.gradient(PHASE, axis=1)
    assert np.abs(ridge.along - slope)[INNER].max() < 0.03
    assert ridge.amplitude[INNER].min() > 0.6


@pytest.mark.parametrize("method", ["filter", "ridges"])
@pytest.mark.parametrize("kind", ["wrapped", "absolute", "relative"])
def test_noisy_phase_map_gets_quieter_and_keeps_its_kind(method, kind):
    noisy = phase_map(0.3, kind)
    found = truth.run(WindowedFourier, {"phase": noisy}, method=method)
    assert found.kind == kind
    before, after = (np.sqrt(np.nanmean(off(m.phase_rad)[INNER] ** 2)) for m in (noisy, found))
    assert after < before / 5
    if kind != "wrapped":
        assert np.nanmax(np.abs(found.phase_rad - PHASE)[INNER]) < 1.0  # orders stay


def test_noise_of_a_map_that_does_not_tell_it_is_estimated():
    told, untold = (truth.run(WindowedFourier, {"phase": phase_map(0.2, sigma=s)}) for s in (True, False))
    assert np.nanmedian(untold.sigma_rad) == pytest.approx(np.nanmedian(told.sigma_rad), rel=0.25)


def test_dropped_pixels_stay_dropped_and_weak_ridges_are():
    noisy = phase_map(0.2)
    phase, rejected = noisy.phase_rad.copy(), noisy.rejected.copy()
    phase[50:80, 50:90], rejected[50:80, 50:90] = np.nan, 2
    phase[120:170, 200:250] = np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 50))
    found = truth.run(WindowedFourier, {"phase": replace(noisy, phase_rad=phase, rejected=rejected)})
    assert np.isnan(found.phase_rad[50:80, 50:90]).all() and (found.rejected[50:80, 50:90] == 2).all()
    assert (found.rejected[130:160, 210:240] != 0).mean() > 0.9
    assert np.isfinite(found.phase_rad).mean() > 0.8


@pytest.mark.parametrize("method", ["filter", "ridges"])
def test_frame_with_a_carrier_is_decoded(method):
    made = FourierEncoder().encode(FourierEncoder.Params(periods=64), ProjectorTarget(1024, 768))
    u = truth.columns(WIDTH, HEIGHT, 100, 800) + 4 * np.exp(-((X - 160) ** 2 + (Y - 110) ** 2) / (2 * 50.0**2))
    found = truth.run(WindowedFourier, {"frames": truth.seen(made, u, 8.0, gain=0.8)}, method=method)
    error = truth.wrapped(found.phase_rad - 2 * np.pi * u / 16)
    assert (found.rejected == 0).mean() > 0.85
    assert np.sqrt(np.nanmean(error**2)) < 0.03


@pytest.mark.parametrize("sigma_px", [0.5, 500.0])
def test_windows_that_do_not_fit_are_refused(sigma_px):
    with pytest.raises(ValueError, match="px"):
        filtered(np.cos(PHASE), Bank((0.2, 0.5), (0, 0), sigma_px), 0.0)
    with pytest.raises(DataError):
        truth.run(WindowedFourier, {"phase": phase_map(0.1)}, window_px=150.0)


def test_bad_frequencies_are_refused():
    with pytest.raises(ValueError, match="rad/px"):
        Bank((0.5, 0.2), (0, 0)).frequencies()
    with pytest.raises(ValueError, match="rad/px"):
        Bank((0.5, 4.0), (0, 0)).frequencies()
    with pytest.raises(ValueError, match="no two neighbours"):
        bank_of(np.zeros((64, 64), np.complex64), 10.0)


def test_exactly_one_input_is_taken():
    noisy = phase_map(0.2)
    with pytest.raises(DataError, match="either a FrameSet"):
        truth.run(WindowedFourier, {})
    empty = replace(noisy, phase_rad=np.full_like(noisy.phase_rad, np.nan), rejected=np.ones_like(noisy.rejected))
    with pytest.raises(DataError, match="no pixel"):
        truth.run(WindowedFourier, {"phase": empty})


def test_work_can_be_stopped_between_windows():
    class Late(RecordingContext):
        def progress(self, fraction, text=""):
            super().progress(fraction, text)
            self.cancelled = fraction > 0.4

    context = Late()
    with pytest.raises(Cancelled):
        WindowedFourier().run({"phase": phase_map(0.2)}, WindowedFourier.Params(), context)
    assert max(context.fractions) < 0.6


def test_contract_is_kept(plugin_contract):
    plugin_contract.processor(WindowedFourier, {"phase": phase_map(0.2)})
