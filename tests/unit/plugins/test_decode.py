"""Decoding against fringes made from the definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import columns, intensities, run, seen, wrapped

from fringed.data import CameraSettings, FrameSet, Reject
from fringed.errors import DataError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.decode import decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel, estimate_noise
from fringed_plugins.phase.shifts import Group

TARGET = ProjectorTarget(1024, 768)
QUIET = NoiseModel(1e-6, 0.0)
OPEN = Thresholds(modulation_dn=0.0, modulation_snr=0.0, residual=10.0, similar_neighbours=0, border_glow=0.0)


def group(steps, period=16.0, initial=0.0, first=0):
    return Group(tuple(range(first, first + steps)), tuple(2 * np.pi * np.arange(steps) / steps), period, initial)


def encode(cls, **params):
    return cls().encode(cls.Params(**params), TARGET)


def test_arctangent_is_within_half_a_microradian():
    angle = np.linspace(-np.pi, np.pi, 20011)[1:-1]
    for scale in (1e-3, 1.0, 1e4):
        y, x = (np.sin(angle) * scale).astype(np.float32), (np.cos(angle) * scale).astype(np.float32)
        got = np.array([fast_atan2(a, b) for a, b in zip(y, x, strict=True)])
        assert np.abs(got - np.arctan2(y.astype(float), x.astype(float))).max() < 5e-7
    assert fast_atan2(np.float32(0), np.float32(0)) == 0


@pytest.mark.parametrize("steps", [3, 4, 5, 6, 8, 12])
def test_noise_free_phase_is_exact(steps):
    u = columns(64, 6, 0, 63)
    frames = intensities(u, 16.0, steps, initial_rad=0.3).astype(np.float32)
    got = decode(frames, [group(steps, initial=0.3)], QUIET, OPEN, threads=1)
    # float32: 120 +- 90 carries 1.5e-5 of the modulation's 90, and the sums of N frames average it.
    assert np.abs(wrapped(got.phase_rad - 2 * np.pi * u / 16 - 0.3)).max() < 1e-6
    assert np.allclose(got.modulation, 90, atol=1e-3)
    assert np.allclose(got.background, 120, atol=1e-3)
    assert not got.rejected.any()


def test_unequal_shifts_are_solved_by_least_squares():
    shifts = (0.0, 0.9, 2.5, 4.4)
    u = columns(64, 6, 0, 63)
    phase = 2 * np.pi * u / 16
    frames = np.array([120 + 90 * np.cos(phase + s) for s in shifts], np.float32)
    got = decode(frames, [Group((0, 1, 2, 3), shifts, 16.0)], QUIET, OPEN, threads=1)
    assert np.abs(wrapped(got.phase_rad - phase)).max() < 2e-6


@pytest.mark.parametrize("steps", [3, 4, 6])
def test_scatter_reaches_the_cramer_rao_bound_and_sigma_tells_it(steps):
    noise, modulation = 2.0, 80.0
    u = columns(400, 300, 0, 399)
    rng = np.random.default_rng(steps)
    frames = intensities(u, 16.0, steps, modulation=modulation) + rng.normal(0, noise, (steps, *u.shape))
    got = decode(frames.astype(np.float32), [group(steps)], NoiseModel(noise**2, 0.0), OPEN, threads=2)
    error = wrapped(got.phase_rad - 2 * np.pi * u / 16)
    bound = noise * np.sqrt(2 / steps) / modulation
    # 120,000 samples: the deviation is known to 0.2 %; 3 % leaves room for second-order terms.
    assert error.std() == pytest.approx(bound, rel=0.03)
    assert np.median(got.sigma_rad) == pytest.approx(bound, rel=0.03)


def test_sixteen_bits_decode_like_eight():
    sequence = encode(PhaseShiftEncoder, periods=64.0, steps=4)
    u = columns(200, 8, 10, 900)
    settings = CameraSettings(bits=16)
    deep = run(PhaseShiftDecoder, {"frames": seen(sequence, u, gain=200.0, settings=settings, dtype=np.uint16)})
    plain = run(PhaseShiftDecoder, {"frames": seen(sequence, u, gain=0.9)})
    assert np.abs(wrapped(deep.phase_rad - plain.phase_rad)).max() < 0.03  # 8 bits: half a level of 115
    assert not deep.rejected.any()


def absolute(frames, **params):
    return run(MultiFrequencyDecoder, {"frames": frames}, **params)


def test_absolute_phase_counts_from_the_first_column():
    u = columns(500, 20, 2, 1021)
    phase = absolute(seen(encode(MultiFrequencyEncoder), u, gain=0.9))
    assert phase.kind == "absolute"
    assert phase.projector_px == 1024
    assert not phase.rejected.any()
    # Half a grey level of rounding in four frames and the interpolated pattern: 0.02 rad.
    assert np.abs(phase.phase_rad - 2 * np.pi * u / 16).max() < 0.03


def test_noise_at_the_projectors_border_throws_no_point_to_the_other_side():
    u = np.concatenate([columns(300, 40, 0, 3), columns(300, 40, 1020, 1023)], axis=1)
    phase = absolute(seen(encode(MultiFrequencyEncoder), u, noise_dn=2.0, gain=0.7))
    kept = phase.rejected == 0
    assert np.abs(phase.phase_rad - 2 * np.pi * u / 16)[kept].max() < 0.3
    assert kept[(u > 1) & (u < 1022)].all()


def test_rows_give_the_same_phase_as_columns():
    u = columns(300, 8, 5, 760)
    phase = absolute(seen(encode(MultiFrequencyEncoder, orientation="rows"), u, gain=0.9))
    assert phase.orientation == "rows"
    assert phase.projector_px == 768
    assert np.abs(phase.phase_rad - 2 * np.pi * u / 12).max() < 0.03


def test_different_steps_for_each_frequency_are_decoded():
    u = columns(300, 8, 5, 1000)
    phase = absolute(seen(encode(MultiFrequencyEncoder, steps=[3, 6, 5]), u, gain=0.9))
    assert np.abs(phase.phase_rad - 2 * np.pi * u / 16).max() < 0.03


def corrupt(frame_set, change):
    frames = frame_set.frames.astype(float)
    change(frames)
    return replace(frame_set, frames=np.clip(np.rint(frames), 0, 255).astype(np.uint8))


def base(noise_dn=0.0):
    return seen(encode(MultiFrequencyEncoder), columns(100, 60, 20, 1000), gain=0.8, noise_dn=noise_dn)


def test_saturated_pixels_are_dropped():
    def burn(frames):
        frames[5, 10:20, 30:40] = 255

    phase = absolute(corrupt(base(), burn))
    assert (phase.rejected[10:20, 30:40] & Reject.SATURATED).all()
    assert np.isnan(phase.phase_rad[10:20, 30:40]).all()
    assert not phase.rejected[25:, :].any()


def test_dark_pixels_are_dropped():
    def shade(frames):
        frames[:, 10:20, 30:40] = 10 + 0.01 * frames[:, 10:20, 30:40]

    phase = absolute(corrupt(base(), shade))
    assert (phase.rejected[10:20, 30:40] & Reject.LOW_MODULATION).all()
    assert np.isnan(phase.sigma_rad[10:20, 30:40]).all()
    assert np.isfinite(phase.background).all()


def test_a_frame_of_another_scene_is_found_by_its_residual():
    def shift(frames):
        frames[9, 10:30, 30:60] = frames[8, 10:30, 30:60]

    phase = absolute(corrupt(base(), shift))
    inside = phase.rejected[10:30, 30:60]
    assert ((inside & Reject.RESIDUAL) > 0).mean() > 0.7  # where both frames happen to agree nothing is wrong


def test_contradicting_frequencies_are_dropped_as_fringe_order():
    def slide(frames):  # the coarse frequency, by an eighth of the way to the next order
        phase = 2 * np.pi * columns(100, 60, 20, 1000) / 1024 + 2 * np.pi * 0.4 / 8
        for k in range(4):
            frames[k] = 102 + 100 * np.cos(phase + 2 * np.pi * k / 4)

    phase = absolute(corrupt(base(), slide))
    assert ((phase.rejected & Reject.FRINGE_ORDER) > 0).mean() > 0.95


def test_isolated_specks_are_dropped():
    def spot(frames):
        u = columns(100, 60, 20, 1000)
        other = intensities(np.full(u.shape, 900.0), 1024.0, 4, 102, 100)
        frames[:4, 5, 7], frames[:4, 30, 50] = other[:, 5, 7], other[:, 30, 50]
        for frequency, period in ((1, 128.0), (2, 16.0)):
            other = intensities(np.full(u.shape, 900.0), period, 4, 102, 100)
            part = slice(4 * frequency, 4 * frequency + 4)
            frames[part, 5, 7], frames[part, 30, 50] = other[:, 5, 7], other[:, 30, 50]

    phase = absolute(corrupt(base(), spot))
    assert set(zip(*np.nonzero(phase.rejected & Reject.ISOLATED), strict=True)) == {(5, 7), (30, 50)}


def test_mixed_pixels_lose_fine_modulation_and_are_dropped():
    # Half of the light from u, half from half a fine period further: the fine fringes cancel, the coarse stay.
    u = columns(100, 60, 20, 1000)
    sequence = encode(MultiFrequencyEncoder)
    one, two = seen(sequence, u, gain=0.8), seen(sequence, u + 7.5, gain=0.8)
    mixed = FrameSet(((one.frames.astype(int) + two.frames) // 2).astype(np.uint8), sequence)
    phase = absolute(mixed, min_modulation_dn=0.0, min_modulation_snr=0.0)
    assert ((phase.rejected & Reject.DISCONTINUITY) > 0).mean() > 0.9


def test_sigma_follows_the_sensors_data_sheet():
    settings = CameraSettings(electrons_per_dn=51.0, read_noise_electrons=12.0)
    phase = run(
        PhaseShiftDecoder, {"frames": seen(encode(PhaseShiftEncoder), columns(64, 8, 0, 1000), settings=settings)}
    )
    variance = phase.background / 51 + (12 / 51) ** 2 + 1 / 12
    expected = np.sqrt(2 / 6 * variance) / phase.modulation
    good = phase.rejected == 0
    assert np.allclose(phase.sigma_rad[good], expected[good], rtol=1e-4)


@pytest.mark.parametrize("steps", [3, 4, 6])
def test_noise_is_estimated_from_the_frames_where_the_camera_does_not_tell_it(steps):
    u = columns(400, 100, 0, 1000)
    rng = np.random.default_rng(3)
    ideal = intensities(u, 16.0, steps)
    frames = ideal + rng.normal(size=ideal.shape) * np.sqrt(1.0 + 0.02 * ideal)
    model = estimate_noise(np.rint(frames).astype(np.uint8), group(steps), "columns")
    # 96 lines of 400 pixels in 8 bins: each variance is known to 4 %.
    assert model.constant_dn2 + 120 * model.slope_dn == pytest.approx(1.0 + 0.02 * 120 + 1 / 12, rel=0.12)


def test_estimated_noise_ignores_the_projectors_harmonics():
    u = columns(400, 100, 0, 1000)
    phase = 2 * np.pi * u / 16
    shifts = 2 * np.pi * np.arange(4) / 4
    rng = np.random.default_rng(4)
    frames = np.array([120 + 80 * np.cos(phase + s) + 15 * np.cos(2 * (phase + s)) for s in shifts])
    frames += rng.normal(0, 1.5, frames.shape)
    model = estimate_noise(np.rint(frames).astype(np.uint8), group(4), "columns")
    assert model.constant_dn2 + 120 * model.slope_dn == pytest.approx(1.5**2 + 1 / 12, rel=0.12)


def test_threads_do_not_change_the_result():
    frames = base(noise_dn=2.0)
    groups = [group(4, 1024.0), group(4, 128.0, first=4), group(4, 16.0, first=8)]
    one, four = (decode(frames.frames, groups, QUIET, OPEN, 1024, threads=n) for n in (1, 4))
    for a, b in zip(one, four, strict=True):
        assert np.array_equal(a, b, equal_nan=a.dtype != np.uint8)


def test_coarsest_frequency_of_several_periods_is_refused():
    sequence = encode(PhaseShiftEncoder, periods=8.0)
    with pytest.raises(DataError, match="8 periods across the projector"):
        absolute(seen(sequence, columns(64, 8, 0, 1000)))


def test_frames_that_are_no_fringes_are_refused():
    frame_set = base()
    other = tuple(replace(frame, style="spiral") for frame in frame_set.sequence.frames)
    strange = replace(frame_set, sequence=replace(frame_set.sequence, frames=other))
    with pytest.raises(DataError, match="style 'spiral'"):
        absolute(strange)


def test_two_orientations_in_one_set_are_refused():
    frame_set = base()
    frames = list(frame_set.sequence.frames)
    frames[8:] = [replace(frame, orientation="rows") for frame in frames[8:]]
    strange = replace(frame_set, sequence=replace(frame_set.sequence, frames=tuple(frames)))
    with pytest.raises(DataError, match="along columns and rows"):
        absolute(strange)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 2), (2, 3), (5, 4)])
def test_tiny_pictures_are_decoded(shape):
    phase = absolute(seen(encode(MultiFrequencyEncoder), np.full(shape, 300.0), gain=0.9), min_similar_neighbours=0)
    assert np.abs(phase.phase_rad - 2 * np.pi * 300 / 16).max() < 0.03


def test_glow_beside_an_edge_is_dropped_and_the_edge_stays():
    # The lens spreads a fifth of the last lit column's light onto its dark neighbour, with its phase.
    def spread(frames):
        frames[:, :, 50:] = 2.0
        frames[:, :, 50] += 0.2 * frames[:, :, 49]

    phase = absolute(corrupt(base(), spread))
    assert (phase.rejected[2:-2, 50] == Reject.DISCONTINUITY).all()
    assert not phase.rejected[2:-2, 40:50].any()
    kept = absolute(corrupt(base(), spread), min_border_modulation=0.0)
    assert not kept.rejected[2:-2, 50].any()
