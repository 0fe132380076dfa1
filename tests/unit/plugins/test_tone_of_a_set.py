"""An uncompensated projector's harmonics are no misfit, while motion still is."""

import numpy as np
import pytest
from fringe_truth import columns, run, seen
from gamma_truth import field, gamma_curve
from gamma_truth import seen as blurred
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.data import Reject
from fringed.hookspecs import FrameSetStart, ProjectorTarget
from fringed.testing import RecordingContext
from fringed_plugins.decoders.correction import HarmonicCorrection
from fringed_plugins.decoders.gray import GrayPhaseShiftDecoder
from fringed_plugins.decoders.heterodyne import HeterodyneDecoder
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.encoders.gray import GrayPhaseShiftEncoder
from fringed_plugins.encoders.heterodyne import HeterodyneEncoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.phase.shifts import Group, style_residual, style_ripple_rad
from fringed_plugins.phase.tone import gamma_of

U = columns(400, 60, 20, 1000)


def group(steps, style="sinusoidal"):
    return Group(tuple(range(steps)), tuple(2 * np.pi * np.arange(steps) / steps), 16.0, style=style)


def bent(gamma, steps, u=U, offset=10.0, gain=180.0):
    phase = 2 * np.pi * u / 16.0 + 2 * np.pi * np.arange(steps)[:, None, None] / steps
    return offset + gain * ((1 + np.cos(phase)) / 2) ** gamma


def taken(encoder, gamma, curve=None, noise_dn=1.0, **params):
    sequence = encoder().encode(encoder.Params(**params), ProjectorTarget(1024, 768, curve))
    return seen(sequence, U, noise_dn, tone=gamma_curve(gamma), gain=0.8)


@given(gamma=st.floats(1.0, 2.6), steps=st.integers(4, 9), offset=st.floats(0, 60), gain=st.floats(20, 180))
@settings(max_examples=40, deadline=None)
def test_the_gamma_of_a_set_is_found_to_its_step(gamma, steps, offset, gain):
    found = gamma_of(bent(gamma, steps, offset=offset, gain=gain), [group(steps)])
    assert gamma - 0.11 < found < gamma + 0.21  # a step of 0.1, and the median of a few phases


def test_three_steps_fit_anything_so_the_most_is_supposed():
    assert gamma_of(bent(1.0, 3), [group(3)], most=2.2) == 2.2
    frames = np.concatenate([bent(1.0, 3), bent(1.0, 4)])
    four = Group((3, 4, 5, 6), group(4).shifts_rad, 16.0)
    assert gamma_of(frames, [group(3), four]) < 1.11


@pytest.mark.parametrize("steps", [4, 5])
def test_what_moves_in_a_third_of_the_picture_changes_nothing(steps):
    frames = bent(1.8, steps)
    frames[1, :20] = frames[0, :20]
    assert abs(gamma_of(frames, [group(steps)]) - gamma_of(bent(1.8, steps), [group(steps)])) < 0.21


@pytest.mark.parametrize(
    "frames", [np.zeros((4, 3, 5)), np.full((4, 2, 2), np.nan), np.zeros((4, 0, 7)), bent(2.0, 4)[:, :1, :1]]
)
def test_frames_that_show_nothing_are_no_error(frames):  # fmt: skip
    assert 1.0 <= gamma_of(frames, [group(4)]) <= 2.6


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64])
def test_the_guess_is_the_same_for_every_type(kind):
    frames = np.asfortranarray(np.rint(bent(2.2, 6)).astype(kind))
    frames.flags.writeable = False
    assert 2.15 < gamma_of(frames, [group(6)]) < 2.35


def test_residual_and_ripple_follow_the_series_of_gamma():
    # Of ((1 + cos x) / 2)^g the harmonics are a2 = (g - 1) / (g + 2), a3 = a2 (g - 2) / (g + 3) of the fundamental.
    for gamma in (1.4, 2.2):
        second = (gamma - 1) / (gamma + 2)
        third = second * (gamma - 2) / (gamma + 3)
        assert style_residual(group(6), gamma) == pytest.approx(3 * (second + abs(third)) ** 2, rel=0.25)
        assert style_ripple_rad(group(3), gamma) == pytest.approx(second / np.sqrt(2), rel=0.06)
        assert style_ripple_rad(group(4), gamma) == pytest.approx(abs(third) / np.sqrt(2), rel=0.15)
    assert style_residual(group(4)) == style_ripple_rad(group(3)) == 0.0


@pytest.mark.parametrize("gamma", [1.4, 1.8, 2.2, 2.6])
@pytest.mark.parametrize("steps", [4, 5, 6, 8])
def test_an_uncompensated_projector_leaves_a_full_map(steps, gamma):
    frames = taken(PhaseShiftEncoder, gamma, periods=64, steps=steps)
    phase = run(PhaseShiftDecoder, {"frames": frames})
    assert (phase.rejected == 0).mean() > 0.99
    off = np.angle(np.exp(1j * (phase.phase_rad - 2 * np.pi * U / 16.0)))
    assert np.sqrt(np.nanmean(off**2)) < 0.05


@pytest.mark.parametrize(
    ("encoder", "decoder"),
    [
        (MultiFrequencyEncoder, MultiFrequencyDecoder),
        (HeterodyneEncoder, HeterodyneDecoder),
        (GrayPhaseShiftEncoder, GrayPhaseShiftDecoder),
    ],
)
def test_absolute_phases_of_an_uncompensated_projector_are_kept_and_right(encoder, decoder):
    frames = taken(encoder, 2.2)
    phase = run(decoder, {"frames": frames})
    kept = phase.rejected == 0
    assert kept.mean() > 0.98
    off = (phase.phase_rad - phase.initial_phase_rad) * phase.period_px / (2 * np.pi) - U
    assert np.abs(off[kept]).max() < phase.period_px / 4


def test_a_linear_projector_is_judged_as_strictly_as_before():
    frames = taken(PhaseShiftEncoder, 1.0, periods=64, steps=6)
    moved = frames.frames.copy()
    moved[4, 10:30, 40:90] = moved[3, 10:30, 40:90]
    phase = run(PhaseShiftDecoder, {"frames": frames.__class__(moved, frames.sequence, settings=frames.settings)})
    late = (phase.rejected & Reject.RESIDUAL) > 0
    assert late[10:30, 40:90].mean() > 0.7
    late[10:30, 40:90] = False
    assert late.mean() < 0.001


@pytest.mark.parametrize("steps", [4, 6])
def test_a_late_frame_is_seen_beside_a_gamma(steps):
    frames = taken(PhaseShiftEncoder, 2.2, periods=64, steps=steps)
    moved = frames.frames.copy()
    moved[2, 10:30, 40:90] = moved[1, 10:30, 40:90]
    phase = run(PhaseShiftDecoder, {"frames": frames.__class__(moved, frames.sequence, settings=frames.settings)})
    late = (phase.rejected & Reject.RESIDUAL) > 0
    # The harmonics hide the smaller deviations: about half of the phases give the frame away.
    assert late[10:30, 40:90].mean() > 0.3
    late[10:30, 40:90] = False
    assert late.mean() < 0.01


def test_compensated_patterns_allow_no_harmonics():
    made = taken(PhaseShiftEncoder, 2.2, gamma_curve(1.0001), periods=64, steps=6)  # undoes the wrong curve
    assert made.sequence.precompensated
    assert (run(PhaseShiftDecoder, {"frames": made}).rejected == 0).mean() < 0.05


def test_frames_that_arrive_one_by_one_are_judged_alike():
    frames = taken(MultiFrequencyEncoder, 2.2)
    whole = run(MultiFrequencyDecoder, {"frames": frames})
    start = FrameSetStart(frames.sequence, frames.settings, frames.frames.shape[1:], "uint8")
    sink = MultiFrequencyDecoder().begin(start, MultiFrequencyDecoder.Params(), RecordingContext())
    for index, image in enumerate(frames.frames):
        sink.add(index, image)
    np.testing.assert_array_equal(sink.finish(frames, RecordingContext()).rejected, whole.rejected)


def test_harmonics_come_off_a_phase_that_was_averaged_over_periods():
    sequence = HeterodyneEncoder().encode(
        HeterodyneEncoder.Params(steps=3, periods=(8.0, 10.0, 11.0), precompensate=False), ProjectorTarget(1024, 768)
    )
    u, blur = field()
    frames = blurred(sequence, u, blur, gamma_curve(1.5))
    phase = run(HeterodyneDecoder, {"frames": frames}, systematic_rad=0.15)
    corrected = run(HarmonicCorrection, {"frames": frames, "phase": phase})
    errors = [
        np.nanstd((p.phase_rad - p.initial_phase_rad) * p.period_px / (2 * np.pi) - u) for p in (phase, corrected)
    ]
    assert errors[1] < 0.1 * errors[0]
