"""Shifts that are not what was asked for: found again, with their uncertainty, or refused with a reason."""

from __future__ import annotations

import fringe_truth as truth
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.data import FrameSet, PatternFrame, PatternSequence
from fringed.errors import DataError
from fringed.testing import RecordingContext
from fringed_plugins.decoders.unknown_shifts import UnknownShiftsDecoder
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.unknown.unknown_shifts import estimated_shifts

HEIGHT, WIDTH = 180, 260
X, Y = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
PHASE = 2 * np.pi * X / 11.3 + 4 * np.exp(-((X - 130) ** 2 + (Y - 90) ** 2) / (2 * 40.0**2))
BACKGROUND = 110 + 40 * (X / WIDTH - 0.5) + 20 * np.sin(Y / 60)
MODULATION = 0.5 * BACKGROUND * (0.6 + 0.4 * np.cos((X - 130) / 200))
NOISE = NoiseModel(4 + 1 / 12, 0.0)


def frames(shifts, noise_dn=2.0, seed=0, phase=PHASE):
    rng = np.random.default_rng(seed)
    stack = [BACKGROUND + MODULATION * np.cos(phase + s) + rng.normal(0, noise_dn, phase.shape) for s in shifts]
    return np.clip(np.rint(stack), 0, 255).astype(np.uint8)


def even(count):
    return 2 * np.pi * np.arange(count) / count


def centred(shifts):
    shifts = np.asarray(shifts)
    return shifts - shifts.mean()


def set_of(images, asked, style="sinusoidal"):
    parts = tuple(
        PatternFrame(style, period_px=11.3, shift_rad=float(s), step=k, steps=len(asked)) for k, s in enumerate(asked)
    )
    return FrameSet(
        images, PatternSequence("phase-shift", 260, 180, parts, (np.zeros((1, 1, 1), np.uint8),) * len(asked))
    )


@pytest.mark.parametrize("count", [3, 4, 5, 6, 9])
def test_shifts_wrong_by_a_third_of_a_radian_are_found(count):
    rng = np.random.default_rng(count)
    for trial in range(3):
        true = even(count) + rng.normal(0, 0.3, count)
        found = estimated_shifts(frames(true, seed=trial), even(count), NOISE)
        assert found.converged, found.reason
        off = centred(np.array(found.shifts_rad) - true)
        # Three and four frames rest on the fringes being even: 23 of them, tapered, leave some 1e-3.
        assert np.abs(off).max() < (4e-3 if count < 5 else 2e-3)
        assert np.abs(off).max() < 5 * max(found.sigma_rad)


def bound(true, pixels_used, noise_dn=2.0):
    """Return the Cramer-Rao bound of each shift, the mean taken off; background and modulation of each pixel free."""
    model = np.stack([np.ones_like(true), np.cos(true), np.sin(true)], axis=1)
    rest = np.eye(len(true)) - model @ np.linalg.pinv(model)
    per_pixel = np.mean(MODULATION**2) / (2 * noise_dn**2) * np.cos(true[:, None] - true[None]) * rest
    mean_off = np.eye(len(true)) - 1 / len(true)
    return np.sqrt(np.diag(mean_off @ np.linalg.pinv(pixels_used * per_pixel) @ mean_off))


@pytest.mark.parametrize("count", [5, 7])
def test_uncertainty_is_near_the_bound_and_true(count):
    true = even(count) + np.random.default_rng(count).normal(0, 0.3, count)
    runs = [estimated_shifts(frames(true, seed=s), even(count), NOISE) for s in range(14)]
    off = np.array([centred(np.array(r.shifts_rad) - true) for r in runs])
    scatter = np.sqrt(np.mean(off**2))
    limit = np.sqrt(np.mean(bound(true, HEIGHT * WIDTH, np.sqrt(NOISE.constant_dn2)) ** 2))
    assert 0.8 < scatter / limit < 1.35  # 14 runs of a few shifts each: the scatter is known to some 10 %
    stated = np.sqrt(np.mean([np.square(r.sigma_rad) for r in runs]))
    assert 0.8 < stated / scatter < 1.6


def test_uneven_light_does_not_bias_five_frames():
    few = PHASE / 12  # two fringes in view, background and modulation that follow them
    true = even(5) + np.array([0.3, -0.2, 0.1, -0.4, 0.2])
    found = estimated_shifts(frames(true, phase=few), even(5), NOISE)
    assert found.converged
    assert np.abs(centred(np.array(found.shifts_rad) - true)).max() < 3e-3


def test_few_fringes_and_three_frames_are_told_as_uncertain():
    few = PHASE / 12
    found = estimated_shifts(frames(even(3), phase=few), even(3), NOISE)
    off = np.abs(centred(np.array(found.shifts_rad) - even(3))).max() if found.converged else 0.0
    assert not found.converged or (max(found.sigma_rad) > 0.01 and off < 5 * max(found.sigma_rad))


@pytest.mark.parametrize("sign", [1, -1])
def test_asked_shifts_settle_the_sign(sign):
    true = sign * (even(5) + 0.1)
    found = estimated_shifts(frames(true), sign * even(5), NOISE)
    assert found.converged
    assert np.abs(centred(np.array(found.shifts_rad) - true)).max() < 3e-3


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_types_and_layouts_give_the_same(dtype):
    true = even(5) + np.array([0.3, -0.2, 0.1, -0.4, 0.2])
    stack = frames(true)
    plain = estimated_shifts(stack, even(5), NOISE)
    other = np.asfortranarray(stack.astype(dtype))
    other.flags.writeable = False
    assert np.allclose(plain.shifts_rad, estimated_shifts(other, even(5), NOISE).shifts_rad, atol=1e-9)


def test_saturated_and_nan_pixels_are_left_out():
    true = even(5) + np.array([0.3, -0.2, 0.1, -0.4, 0.2])
    stack = frames(true).astype(np.float32)
    stack[1, 20:60] = 255
    stack[2, 100:120] = np.nan
    found = estimated_shifts(stack, even(5), NOISE, saturation_dn=255)
    assert found.converged
    assert np.abs(centred(np.array(found.shifts_rad) - true)).max() < 3e-3


@pytest.mark.parametrize(
    ("shifts", "words"),
    [
        ([0.0, 0.0, 0.0], "alike"),
        ([0.0] * 6, "alike"),
        ([0.0, 1.0, 1.0], "two values"),
        ([0.0, np.pi, 0.0, np.pi, 0.0], "two values"),
        ([0.0, 2.0, 0.0, 2.0], "two values"),
    ],
)
def test_degenerate_sets_are_refused_with_a_reason(shifts, words):
    found = estimated_shifts(frames(shifts), even(len(shifts)), NOISE)
    assert not found.converged
    assert words in found.reason
    assert np.isnan(found.shifts_rad).all() and np.isnan(found.sigma_rad).all()


def test_moving_and_flickering_sets_are_refused():
    moving = np.stack([frames([s], phase=PHASE * (1 + 0.02 * k), seed=k)[0] for k, s in enumerate(even(6))])
    assert not estimated_shifts(moving, even(6), NOISE).converged
    flicker = np.stack([np.clip(frames([0.0])[0] * f, 0, 255).astype(np.uint8) for f in (0.8, 0.9, 1.0, 1.1)])
    found = estimated_shifts(flicker, even(4), NOISE)
    assert not found.converged and "brightness" in found.reason


def test_dark_and_saturated_sets_are_refused():
    for value in (0, 255):
        found = estimated_shifts(np.full((4, 40, 50), value, np.uint8), even(4), NOISE, saturation_dn=255)
        assert not found.converged and found.reason


def test_counts_are_checked():
    with pytest.raises(ValueError, match="three frames or more"):
        estimated_shifts(frames([0.0, 1.0]), [0.0, 1.0], NOISE)
    with pytest.raises(ValueError, match="asked shifts"):
        estimated_shifts(frames(even(4)), even(5), NOISE)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.floats(0, 6.2), min_size=5, max_size=8), st.integers(0, 5))
def test_any_shifts_are_found_or_refused(shifts, seed):
    true = np.array(shifts)
    found = estimated_shifts(frames(true, seed=seed, noise_dn=1.0), true + 0.05 * np.sin(3 * true), NOISE)
    if found.converged:
        off = centred(truth.wrapped(np.array(found.shifts_rad) - true))
        assert np.abs(off).max() < max(10 * max(found.sigma_rad), 0.02)
    else:
        assert found.reason


def scattered(phase_map):
    """Return the error of the phase, the common offset taken off."""
    off = truth.wrapped(phase_map.phase_rad - PHASE)
    return float(np.nanstd(truth.wrapped(off - np.angle(np.nanmean(np.exp(1j * off))))))


def test_decoding_with_estimated_shifts_leaves_only_noise():
    from fringed_plugins.decoders.sinusoidal import PhaseShiftDecoder

    true = even(5) + np.array([0.3, -0.2, 0.35, -0.4, 0.2])
    taken = set_of(frames(true), even(5))
    good = truth.run(UnknownShiftsDecoder, {"frames": taken})
    bad = truth.run(PhaseShiftDecoder, {"frames": taken}, max_residual=5.0)
    noise = 2.0 * np.sqrt(2 / 5) * np.sqrt(np.mean(1 / MODULATION**2))
    assert scattered(good) < 1.15 * noise
    assert scattered(bad) > 4 * noise


def test_difference_to_the_asked_shifts_is_warned_of_once_it_matters():
    for error, warned in ((0.0, False), (0.02, False), (0.3, True)):
        context = RecordingContext()
        true = even(5) + error * np.array([1, -1, 1, -1, 0])
        UnknownShiftsDecoder().run({"frames": set_of(frames(true), even(5))}, UnknownShiftsDecoder.Params(), context)
        levels = [level for level, _ in context.logged]
        assert ("warning" in levels) == warned
        if warned:
            text = next(text for level, text in context.logged if level == "warning")
            assert "4 of 5" in text and "frame 0: +17" in text


def test_decoder_refuses_what_tells_no_shifts():
    with pytest.raises(DataError, match="cannot be estimated: the frames are alike"):
        truth.run(UnknownShiftsDecoder, {"frames": set_of(frames([0.0] * 4), even(4))})
    with pytest.raises(DataError, match="group 3"):
        truth.run(UnknownShiftsDecoder, {"frames": set_of(frames(even(4)), even(4))}, group=3)


def test_contract_is_kept(plugin_contract):
    plugin_contract.processor(UnknownShiftsDecoder, {"frames": set_of(frames(even(4) + 0.1), even(4))})
