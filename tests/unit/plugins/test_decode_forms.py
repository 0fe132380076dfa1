"""Closed forms, sums and the matrix are one least squares; other styles than sinusoids; confidence; what is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import columns, intensities, run, seen, wrapped
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.errors import DataError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder
from fringed_plugins.phase.decode import LEAN, Keep, decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, closed_form, style_residual, transform

QUIET = NoiseModel(1e-6, 0.0)
OPEN = Thresholds(
    modulation_dn=0.0, modulation_snr=0.0, residual=10.0, similar_neighbours=0, border_glow=0.0, window_snr=0.0
)
RAMP = columns(90, 4, 0, 1000)


def frames_at(shifts, period=16.0, light=120.0, modulation=90.0, u=RAMP):
    return np.array([light + modulation * np.cos(2 * np.pi * u / period + s) for s in shifts])


def by_matrix(frames, shifts):
    """Return background, phase, modulation and squared residual by plain float64 least squares."""
    model = np.stack([np.ones(len(shifts)), np.cos(shifts), -np.sin(shifts)], axis=1)
    flat = frames.reshape(len(shifts), -1).astype(float)
    light, cosine, sine = np.linalg.lstsq(model, flat, rcond=None)[0]
    misfit = ((flat - model @ [light, cosine, sine]) ** 2).sum(axis=0)
    return light, np.arctan2(sine, cosine), np.hypot(cosine, sine), misfit


@pytest.mark.parametrize("order", ["as they come", "shuffled", "offset"])
@pytest.mark.parametrize("steps", [3, 4, 5, 6, 7, 8, 16])
def test_every_form_is_the_same_least_squares(steps, order):
    shifts = 2 * np.pi * np.arange(steps) / steps + (0.7 if order == "offset" else 0.0)
    if order == "shuffled":
        shifts = np.random.default_rng(steps).permutation(shifts)
    rng = np.random.default_rng(1)
    frames = np.rint(frames_at(shifts) + rng.normal(0, 2, (steps, *RAMP.shape))).astype(np.uint8)
    found = closed_form(shifts)
    assert (found is not None) == (steps in (3, 4, 6))
    group = Group(tuple(range(steps)), tuple(shifts), 16.0)
    got = decode(frames, [group], QUIET, OPEN, keep=Keep(residual=True, wrapped=True), threads=1)
    light, phase, modulation, misfit = (a.reshape(RAMP.shape) for a in by_matrix(frames, shifts))
    # float32 of numbers below 255: 1e-5 of absolute, 2e-7 of relative error for each of some ten operations.
    assert np.abs(got.background - light).max() < 1e-4
    assert np.abs(got.modulation - modulation).max() < 1e-4
    assert np.abs(wrapped(got.phase_rad - phase)).max() < 2e-6
    assert np.abs(wrapped(got.wrapped_rad - phase)).max() < 2e-6
    if steps > 3:
        # The general sums lose 1e-6 of the squared modulation, 8100, to rounding.
        assert np.abs(got.residual**2 * (steps - 3) - misfit).max() < 0.03


def test_textbook_forms_are_the_matrix():
    assert np.allclose(transform(2 * np.pi * np.arange(3) / 3)[1:] * 3, [[2, -1, -1], [0, -(3**0.5), 3**0.5]])
    assert np.allclose(transform(np.pi / 2 * np.arange(4))[1:3] * 2, [[1, 0, -1, 0], [0, -1, 0, 1]])


@given(st.permutations(range(6)), st.floats(-20, 20), st.sampled_from([3, 4, 6]))
@settings(max_examples=60, deadline=None)
def test_equal_steps_are_recognised_in_any_order_and_from_anywhere(order, offset, steps):
    shifts = np.array([2 * np.pi * k / steps + offset for k in order if k < steps])
    found = closed_form(shifts)
    assert found is not None
    places, rest = found
    rebuilt = rest + 2 * np.pi * np.arange(steps) / steps
    assert np.abs(wrapped(shifts[list(places)] - rebuilt)).max() < 1e-8


@pytest.mark.parametrize(
    "shifts", [(0.0, 1.0, 2.0), (0.0, 1.5707, 3.1416, 4.7124), (0.0, 0.0, 2.0944), (0, 1, 2, 3, 4, 5)]
)
def test_other_steps_have_no_closed_form(shifts):
    assert closed_form(shifts) is None


def test_an_absolute_phase_does_not_depend_on_where_the_steps_begin():
    groups, frames = [], []
    for period, steps, begin in ((1024.0, 4, 0.3), (128.0, 6, -2.0), (16.0, 3, 5.0)):
        shifts = 2 * np.pi * np.arange(steps) / steps + begin
        groups.append(Group(tuple(range(len(frames), len(frames) + steps)), tuple(shifts), period))
        frames += list(frames_at(shifts, period))
    got = decode(np.array(frames, np.float32), groups, QUIET, OPEN, 1024, keep=Keep(wrapped=True), threads=1)
    truth = 2 * np.pi * RAMP / 16
    # float32 near 400 rad has steps of 3e-5; a turn of 64 periods has 8e-6 turns, 5e-5 rad.
    assert np.abs(got.phase_rad - truth).max() < 2e-4
    assert np.abs(wrapped(got.wrapped_rad - truth)).max() < 2e-4


def triangle(phase):
    return 2 * np.abs(wrapped(phase)) / np.pi - 1


PROFILES = {
    "triangular": lambda phase: -triangle(phase),
    "binary": lambda phase: np.sign(np.cos(phase) + 1e-12),
    "sawtooth": lambda phase: wrapped(phase + np.pi / 2) / np.pi,
    "trapezoidal": lambda phase: np.clip(-1.5 * triangle(phase), -1, 1),
}


@pytest.mark.parametrize("steps", [4, 5, 6, 8, 12])
@pytest.mark.parametrize("style", PROFILES)
def test_other_styles_are_decoded_by_their_fundamental(style, steps):
    phase = 2 * np.pi * np.linspace(0, 40, 2000).reshape(1, -1) + 0.05
    shifts = 2 * np.pi * np.arange(steps) / steps
    frames = np.array([120 + 90 * PROFILES[style](phase + s) for s in shifts], np.float32)
    limits = Thresholds(similar_neighbours=0, border_glow=0.0)
    group = Group(tuple(range(steps)), tuple(shifts), 64.0, style=style)
    got = decode(frames, [group], NoiseModel(1.0, 0.0), limits, threads=1)
    assert not (got.rejected & 8).any()
    # Each harmonic k = n N +- 1 shifts the phase by at most its amplitude over the fundamental's.
    even = 1 if style == "sawtooth" else 0
    power = {"triangular": 2, "trapezoidal": 2}.get(style, 1)
    worst = sum(k**-power for k in range(2, 4000) if (k - 1) % steps * ((k + 1) % steps) == 0 and (k % 2 or even))
    assert np.nanmax(np.abs(wrapped(got.phase_rad - phase))) < (worst if power == 2 else np.pi / steps + 0.05)


def test_a_triangle_is_no_misfit_only_where_it_was_asked_for():
    group = Group(tuple(range(8)), tuple(2 * np.pi * np.arange(8) / 8), 64.0, style="binary")
    assert style_residual(group) > 0.2
    phase = 2 * np.pi * np.linspace(0, 3, 500).reshape(1, -1)
    frames = np.array([120 + 90 * PROFILES["binary"](phase + s) for s in group.shifts_rad], np.float32)
    limits = Thresholds(similar_neighbours=0, border_glow=0.0)
    plain = Group(group.frames, group.shifts_rad, 64.0)
    assert (decode(frames, [plain], NoiseModel(1.0, 0.0), limits).rejected & 8).mean() > 0.9


def test_a_late_frame_of_binary_fringes_is_still_a_misfit():
    shifts = 2 * np.pi * np.arange(12) / 12
    phase = 2 * np.pi * np.linspace(0, 3, 500).reshape(1, -1)
    frames = np.array([120 + 90 * PROFILES["triangular"](phase + s) for s in shifts], np.float32)
    frames[7] = frames[1]
    group = Group(tuple(range(12)), tuple(shifts), 64.0, style="triangular")
    limits = Thresholds(similar_neighbours=0, border_glow=0.0)
    assert (decode(frames, [group], NoiseModel(1.0, 0.0), limits).rejected & 8).mean() > 0.7


def test_confidence_is_the_room_that_noise_leaves_an_order():
    modulation, sigma = 60.0, 1.5
    groups = [Group((0, 1, 2, 3), tuple(np.pi / 2 * np.arange(4)), 1024.0)]
    groups.append(Group((4, 5, 6, 7), tuple(np.pi / 2 * np.arange(4)), 64.0))
    for off in (0.0, 0.2, 0.4):
        coarse = RAMP + off * 64.0  # the coarse phase predicts the fine one wrongly by `off` periods
        frames = [frames_at(groups[0].shifts_rad, 1024.0, modulation=modulation, u=coarse)]
        frames.append(frames_at(groups[1].shifts_rad, 64.0, modulation=modulation))
        stack = np.concatenate(frames).astype(np.float32)
        got = decode(stack, groups, NoiseModel(sigma**2, 0.0), OPEN, 1024, keep=Keep(confidence=True), threads=1)
        one = sigma * np.sqrt(2 / 4) / modulation / (2 * np.pi)  # deviation of a phase, in turns
        expected = (0.5 - off) / (one * np.sqrt(16**2 + 1))
        assert np.median(got.confidence) == pytest.approx(expected, rel=0.01)


def test_confidence_tells_how_often_orders_are_wrong():
    # A modulation of 6 sigma and a ratio of 8 leave 3.3 deviations of room: one order in 1,000 is wrong.
    groups = [Group((0, 1, 2, 3), tuple(np.pi / 2 * np.arange(4)), 1024.0)]
    groups.append(Group((4, 5, 6, 7), tuple(np.pi / 2 * np.arange(4)), 128.0))
    u = columns(800, 250, 200, 800)
    rng = np.random.default_rng(3)
    stack = np.concatenate([frames_at(g.shifts_rad, g.period_px, 60, 12.0, u) for g in groups])
    stack = (stack + rng.normal(0, 2, stack.shape)).astype(np.float32)
    limits = replace(OPEN, order_turns=0.5)
    got = decode(stack, groups, NoiseModel(4.0, 0.0), limits, 1024, keep=Keep(confidence=True), threads=1)
    wrong = np.abs(got.phase_rad - 2 * np.pi * u / 128) > np.pi
    assert 2e-4 < wrong.mean() < 4e-3
    assert wrong[got.confidence > 2.5].mean() == 0
    assert wrong[got.confidence < 1.0].mean() > 10 * wrong.mean()


def test_one_frequency_has_no_order_to_doubt():
    stack = frames_at(np.pi / 2 * np.arange(4), 1024.0).astype(np.float32)
    group = Group((0, 1, 2, 3), tuple(np.pi / 2 * np.arange(4)), 1024.0)
    got = decode(stack, [group], QUIET, OPEN, 1024, keep=Keep(confidence=True), threads=1)
    assert np.isinf(got.confidence).all()


def test_what_is_not_asked_for_is_not_made_and_changes_nothing():
    frames = np.rint(intensities(RAMP, 16.0, 6)).astype(np.uint8)
    group = Group(tuple(range(6)), tuple(2 * np.pi * np.arange(6) / 6), 16.0)
    limits = Thresholds()
    full, lean = (decode(frames, [group], NoiseModel(1.0, 0.0), limits, keep=keep) for keep in (Keep(), LEAN))
    assert lean.sigma_rad.size == lean.background.size == 0
    for name in ("phase_rad", "modulation", "rejected"):
        assert np.array_equal(getattr(full, name), getattr(lean, name), equal_nan=name != "rejected")


def both_ways():
    """Return a set with fringes along columns and along rows, of a camera that sees the projector's diagonal."""
    target = ProjectorTarget(1024, 768)
    parts = [
        MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(orientation=o), target) for o in ("columns", "rows")
    ]
    u, v = columns(80, 6, 20, 1000), columns(80, 6, 30, 740)
    sets = [seen(part, place, gain=0.9) for part, place in zip(parts, (u, v), strict=True)]
    renumbered = [type(f)(**{**vars(f), "group": f.group + 3 * n}) for n, part in enumerate(parts) for f in part.frames]
    sequence = type(parts[0])(
        **{**vars(parts[0]), "frames": tuple(renumbered), "patterns": parts[0].patterns + parts[1].patterns}
    )
    return type(sets[0])(np.concatenate([s.frames for s in sets]), sequence), u, v


def test_the_orientation_asked_for_is_decoded():
    frame_set, u, v = both_ways()
    along = run(MultiFrequencyDecoder, {"frames": frame_set}, orientation="columns")
    down = run(MultiFrequencyDecoder, {"frames": frame_set}, orientation="rows")
    assert (along.orientation, along.projector_px) == ("columns", 1024)
    assert (down.orientation, down.projector_px) == ("rows", 768)
    assert np.nanmax(np.abs(along.phase_rad - 2 * np.pi * u / 16)) < 0.03
    assert np.nanmax(np.abs(down.phase_rad - 2 * np.pi * v / 12)) < 0.03
    only = run(PhaseShiftDecoder, {"frames": frame_set}, orientation="rows")
    assert np.nanmax(np.abs(wrapped(only.phase_rad - 2 * np.pi * v / 12))) < 0.03


def test_an_orientation_that_is_not_there_is_refused():
    with pytest.raises(DataError, match="fringes along columns"):
        run(PhaseShiftDecoder, {"frames": both_ways()[0]})
    sequence = MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), ProjectorTarget(1024, 768))
    with pytest.raises(DataError, match="choose one of columns"):
        run(PhaseShiftDecoder, {"frames": seen(sequence, RAMP)}, orientation="rows")


def test_decoders_keep_the_confidence_where_asked():
    sequence = MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), ProjectorTarget(1024, 768))
    frame_set = seen(sequence, RAMP, gain=0.9)
    assert run(MultiFrequencyDecoder, {"frames": frame_set}).confidence is None
    kept = run(MultiFrequencyDecoder, {"frames": frame_set}, keep_confidence=True)
    assert kept.confidence is not None and kept.confidence.shape == RAMP.shape
    assert (kept.confidence > 10).all()
