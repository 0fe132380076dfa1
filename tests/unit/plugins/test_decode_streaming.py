"""Frames that are decoded while they arrive give what the finished set gives."""

from __future__ import annotations

import numpy as np
import pytest
from fringe_truth import columns, run, seen

from fringed.data import CameraSettings
from fringed.errors import Cancelled, DataError
from fringed.hookspecs import FrameSetStart, ProjectorTarget, StreamingProcessor
from fringed.testing import RecordingContext
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.phase.accumulate import Accumulator
from fringed_plugins.phase.decode import Keep, decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group

TARGET = ProjectorTarget(1024, 768)
NOISE = NoiseModel(2.3, 0.0)
ALL = Keep(wrapped=True, residual=True, confidence=True)


def noisy(periods_steps, kind=np.uint8, gain=1.0):
    """Return frames of a ramp over the projector with 1.5 levels of noise, and their groups."""
    u = columns(300, 20, 3, 1020)
    rng = np.random.default_rng(5)
    frames, groups = [], []
    for period, steps in periods_steps:
        shifts = 2 * np.pi * np.arange(steps) / steps
        groups.append(Group(tuple(range(len(frames), len(frames) + steps)), tuple(shifts), period))
        frames += [120 + 90 * np.cos(2 * np.pi * u / period + s) + rng.normal(0, 1.5, u.shape) for s in shifts]
    stack = gain * np.array(frames)
    return (stack if np.dtype(kind).kind == "f" else np.rint(stack)).astype(kind), groups


def streamed(stack, groups, size_px, order, limits, keep):
    sums = Accumulator(stack.shape[1:], stack.dtype, groups, limits, size_px, noise=NOISE, keep=keep, threads=2)
    for index in order:
        frame = stack[index].copy()
        sums.add(index, frame)
        frame[:] = 77  # the sink may not look at it again
    return sums.finish(stack)


def assert_alike(one, other, rounding=0.0):
    """`rounding` in units of the last place of 100 grey levels, 7.6e-6; 0: the same bits."""
    for name, a, b in zip(one._fields, one, other, strict=True):
        assert a.shape == b.shape, name
        if rounding == 0 or a.dtype == np.uint16:
            assert np.array_equal(a, b, equal_nan=a.dtype != np.uint16), name
        elif name not in ("residual", "confidence"):
            assert np.allclose(a, b, rtol=rounding * 1e-6, atol=rounding * 1e-6, equal_nan=True), name


SETS = {
    "four steps": ((1024.0, 4), (128.0, 4), (16.0, 4)),
    "closed and summed": ((1024.0, 3), (128.0, 7), (16.0, 5)),
    "many steps": ((1024.0, 6), (32.0, 13)),
    "one period": ((1024.0, 4),),
}


@pytest.mark.parametrize("name", SETS)
def test_frames_in_order_give_the_very_same_maps(name):
    stack, groups = noisy(SETS[name])
    limits = Thresholds(saturation_dn=255.0)
    whole = decode(stack, groups, NOISE, limits, 1024, keep=ALL)
    assert_alike(whole, streamed(stack, groups, 1024, range(len(stack)), limits, ALL))
    assert np.isfinite(whole.phase_rad).mean() > 0.95


@pytest.mark.parametrize("name", SETS)
def test_frames_in_any_order_give_the_same_maps_to_rounding(name):
    stack, groups = noisy(SETS[name])
    limits = Thresholds(saturation_dn=255.0)
    order = np.random.default_rng(2).permutation(len(stack))
    whole = decode(stack, groups, NOISE, limits, 1024, keep=ALL)
    # Phases reach 400 rad, where float32 has 3e-5; sums in another order differ in their last bits.
    assert_alike(whole, streamed(stack, groups, 1024, order, limits, ALL), rounding=40)


def test_the_loop_over_three_groups_at_once_gives_what_one_after_the_other_gives():
    stack, groups = noisy(SETS["four steps"])
    stack[1, 3, 50:60], stack[6, 4, 50:60], stack[11, 5, 50:60] = 255, 255, 255
    stack[4:8, 6, 50:90] = stack[8:12, 6, 50:90]  # orders that contradict each other
    stack[8:, 7, 50:90] = 100
    limits = Thresholds(saturation_dn=255.0, modulation_drop=0.2)
    keep = Keep(wrapped=True, residual=True)
    whole = decode(stack, groups, NOISE, limits, 1024, keep=keep)
    assert_alike(whole, streamed(stack, groups, 1024, range(12), limits, keep), rounding=40)
    assert all((whole.rejected & reason).any() for reason in (1, 2, 4, 8, 64))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("steps", [3, 4, 5, 6, 9])
def test_wrapped_phase_of_one_group_is_streamed(kind, steps):
    stack, groups = noisy([(16.0, steps)], kind, gain=1.0 if kind == np.uint8 else 200.0)
    whole = decode(stack, groups, NOISE, Thresholds(), keep=Keep(wrapped=True))
    assert_alike(whole, streamed(stack, groups, None, range(steps), Thresholds(), Keep(wrapped=True)))


def test_saturation_in_a_coarse_level_is_remembered():
    stack, groups = noisy(SETS["closed and summed"])
    stack[1, 3, 50:60] = 255
    got = streamed(stack, groups, 1024, range(len(stack)), Thresholds(saturation_dn=255.0), Keep())
    assert (got.rejected[3, 50:60] & 1).all()
    assert np.count_nonzero(got.rejected & 1) == 10


def test_a_frame_that_is_missing_or_comes_twice_is_told():
    stack, groups = noisy(SETS["four steps"])
    sums = Accumulator(stack.shape[1:], stack.dtype, groups, Thresholds(), 1024)
    sums.add(3, stack[3])
    with pytest.raises(ValueError, match="frame 3 came twice"):
        sums.add(3, stack[3])
    with pytest.raises(ValueError, match="shape"):
        sums.add(4, stack[4, :5])
    with pytest.raises(ValueError, match=r"frames \[0, 1, 2, 4"):
        sums.finish()


def test_levels_wait_for_what_the_frames_have_to_show():
    stack, groups = noisy(SETS["closed and summed"])
    limits = Thresholds(saturation_dn=255.0)
    sums = Accumulator(stack.shape[1:], stack.dtype, groups, Thresholds(), 1024)
    for index, frame in enumerate(stack):
        sums.add(index, frame)
    with pytest.raises(ValueError, match="noise is unknown"):
        sums.finish()
    sums.settle(NOISE, limits)
    assert_alike(decode(stack, groups, NOISE, limits, 1024), sums.finish(stack))


def test_frames_of_other_groups_are_none_of_its_business():
    stack, groups = noisy(SETS["four steps"])
    got = streamed(stack, groups[2:], None, range(len(stack)), Thresholds(), Keep())
    assert_alike(decode(stack, groups[2:], NOISE, Thresholds()), got)


CASES = {
    "phase-shift": (PhaseShiftDecoder, PhaseShiftEncoder, {"periods": 64.0, "steps": 5}),
    "multi-frequency": (MultiFrequencyDecoder, MultiFrequencyEncoder, {}),
}


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("name", CASES)
def test_decoders_return_from_a_stream_what_they_return_from_a_set(name, known):
    decoder, encoder, params = CASES[name]
    sequence = encoder().encode(encoder.Params(**params), TARGET)
    settings = CameraSettings(electrons_per_dn=51.0, read_noise_electrons=12.0) if known else CameraSettings()
    frame_set = seen(sequence, columns(200, 40, 5, 1015), noise_dn=1.5, gain=0.85, settings=settings)
    expected = run(decoder, {"frames": frame_set})
    assert isinstance(decoder(), StreamingProcessor)
    start = FrameSetStart(sequence, settings, frame_set.frames.shape[1:], "uint8")
    sink = decoder().begin(start, decoder.Params(), RecordingContext())
    for index, frame in enumerate(frame_set.frames):
        sink.add(index, frame)
    got = sink.finish(frame_set, RecordingContext())
    for field in ("phase_rad", "modulation", "background", "rejected"):
        assert np.array_equal(getattr(got, field), getattr(expected, field), equal_nan=field != "rejected"), field
    # Of a square root squared, or of the square itself: float32 has 1.2e-7.
    assert np.allclose(got.sigma_rad, expected.sigma_rad, rtol=5e-7, atol=0, equal_nan=True)
    assert (got.kind, got.period_px, got.projector_px) == (expected.kind, expected.period_px, expected.projector_px)


def test_a_set_that_cannot_be_decoded_is_refused_before_its_first_frame():
    sequence = PhaseShiftEncoder().encode(PhaseShiftEncoder.Params(periods=8.0), TARGET)
    start = FrameSetStart(sequence, CameraSettings(), (8, 8), "uint8")
    with pytest.raises(DataError, match="8 periods across the projector"):
        MultiFrequencyDecoder().begin(start, MultiFrequencyDecoder.Params(), RecordingContext())
    with pytest.raises(DataError, match="group 3 is wanted"):
        PhaseShiftDecoder().begin(start, PhaseShiftDecoder.Params(group=3), RecordingContext())


def test_a_stream_can_be_cancelled_at_its_end():
    sequence = PhaseShiftEncoder().encode(PhaseShiftEncoder.Params(periods=64.0), TARGET)
    frame_set = seen(sequence, columns(20, 10, 5, 1015))
    start = FrameSetStart(sequence, CameraSettings(), (10, 20), "uint8")
    sink = PhaseShiftDecoder().begin(start, PhaseShiftDecoder.Params(), RecordingContext())
    for index, frame in enumerate(frame_set.frames):
        sink.add(index, frame)
    with pytest.raises(Cancelled):
        sink.finish(frame_set, RecordingContext(cancelled=True))
