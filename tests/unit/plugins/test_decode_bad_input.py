"""Decoding of whatever arrays may come: not finite, tiny, strided, of foreign types; none is written to."""

from __future__ import annotations

import numpy as np
import pytest
from fringe_truth import columns, intensities, wrapped
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fringed_plugins.phase.decode import Keep, decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group

NOISE = NoiseModel(1.0, 0.01)
OPEN = Thresholds(modulation_dn=1.0, similar_neighbours=0, border_glow=0.0, window_snr=0.0)
ALL = Keep(wrapped=True, residual=True, confidence=True)


def group(steps, period=16.0, first=0):
    return Group(tuple(range(first, first + steps)), tuple(2 * np.pi * np.arange(steps) / steps), period)


def fringes(steps=4, shape=(5, 70)):
    return intensities(columns(shape[1], shape[0], 0, 60), 16.0, steps)


def expected(shape=(5, 70)):
    return 2 * np.pi * columns(shape[1], shape[0], 0, 60) / 16


def check(frames, steps=4, tolerance=0.02, scale=1.0):
    limits = Thresholds(modulation_dn=scale, residual=0.2, similar_neighbours=0, border_glow=0.0)
    got = decode(frames, [group(steps)], NoiseModel(scale**2, 0.0), limits, threads=1)
    assert not got.rejected.any()
    assert np.abs(wrapped(got.phase_rad - expected(got.phase_rad.shape))).max() < tolerance
    assert all(plane.flags.c_contiguous for plane in got)


@pytest.mark.parametrize("kind", ["u1", "<u2", ">u2", "<i2", ">i4", "f2", "<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("steps", [3, 4, 5, 6])
def test_any_type_of_number_is_decoded(kind, steps):
    # Half a level of rounding in each frame, over a modulation of 90: below 0.01 rad.
    check(np.rint(fringes(steps)).astype(kind), steps)


@pytest.mark.parametrize("steps", [3, 4, 5])
def test_large_16_bit_numbers_keep_their_precision(steps):
    check(np.rint(250 * fringes(steps)).astype(np.uint16), steps, tolerance=1e-4, scale=10.0)


@pytest.mark.parametrize("steps", [4, 5])
def test_layout_makes_no_difference(steps):
    plain = np.rint(fringes(steps)).astype(np.uint8)
    wide = np.zeros((2 * steps, 9, 140), np.uint8)
    wide[::2, 2:7, ::2] = plain
    check(np.asfortranarray(plain), steps)
    check(wide[::2, 2:7, ::2], steps)
    check(plain[::-1, ::-1, ::-1][::-1, ::-1, ::-1], steps)
    check(np.stack([plain] * 3, axis=-1)[..., 1], steps)


def test_read_only_frames_are_decoded_and_never_written_to():
    frames = np.rint(fringes()).astype(np.uint8)
    before = frames.copy()
    frames.flags.writeable = False
    check(frames)
    assert np.array_equal(frames, before)


def test_frames_that_overlap_in_memory_are_decoded():
    # A picture whose rows move by one pixel from frame to frame: one buffer, seen through five windows.
    line = np.rint(intensities(np.arange(200.0), 4.0, 1)[0]).astype(np.uint8)
    frames = np.lib.stride_tricks.as_strided(line, (4, 3, 60), (1, 0, 1))
    got = decode(frames, [group(4)], NOISE, OPEN, threads=1)
    # Frame k is shifted by k pixels, a quarter of a period.
    assert np.abs(wrapped(got.phase_rad - 2 * np.pi * np.arange(60) / 4)).max() < 0.02


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("steps", [3, 4, 5, 6])
def test_a_pixel_that_is_not_finite_is_dropped_alone(bad, steps):
    frames = fringes(steps).astype(np.float32)
    frames[steps - 1, 2, 33] = bad
    got = decode(frames, [group(steps)], NOISE, OPEN, keep=ALL, threads=1)
    assert got.rejected[2, 33] != 0
    assert np.isnan(got.phase_rad[2, 33]) and np.isnan(got.sigma_rad[2, 33])
    assert np.count_nonzero(got.rejected) == 1
    assert np.isfinite(got.phase_rad).sum() == got.phase_rad.size - 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_level_that_is_not_finite_drops_the_pixel(level, bad):
    groups = [group(3, 64.0), group(5, 32.0, 3), group(4, 16.0, 8)]
    u = columns(70, 5, 1, 60)
    frames = np.concatenate([intensities(u, g.period_px, len(g.frames)) for g in groups]).astype(np.float32)
    frames[groups[level].frames[1], 3, 40] = bad
    got = decode(frames, groups, NOISE, OPEN, 64, keep=ALL, threads=1)
    assert got.rejected[3, 40] != 0 and np.isnan(got.phase_rad[3, 40])
    assert np.count_nonzero(got.rejected) == 1


@pytest.mark.parametrize("frames", [np.zeros((4, 6, 7), np.uint8), np.full((4, 6, 7), 255, np.uint8)])
def test_nothing_left_is_no_error(frames):
    got = decode(frames, [group(4)], NOISE, Thresholds(saturation_dn=255.0))
    assert got.rejected.all()
    assert np.isnan(got.phase_rad).all() and np.isnan(got.sigma_rad).all()
    assert np.isfinite(got.modulation).all() and np.isfinite(got.background).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (1, 2049), (2, 2), (3, 1391), (64, 64)])
@pytest.mark.parametrize("steps", [3, 4, 6, 7])
def test_any_size_is_decoded(shape, steps):
    u = np.linspace(0, 60, shape[0] * shape[1]).reshape(shape)
    groups = [group(steps, 64.0), group(steps, 16.0, steps)]
    frames = np.rint(np.concatenate([intensities(u, g.period_px, steps) for g in groups])).astype(np.uint8)
    got = decode(frames, groups, NOISE, OPEN, 64, keep=ALL)
    inside = u < 60
    assert np.abs(got.phase_rad - 2 * np.pi * u / 16)[inside].max() < 0.05


@pytest.mark.parametrize("shape", [(4, 0, 5), (4, 5, 0)])
def test_a_picture_without_pixels_gives_maps_without_pixels(shape):
    got = decode(np.zeros(shape, np.uint8), [group(4)], NOISE, OPEN)
    assert got.phase_rad.shape == got.rejected.shape == shape[1:]


@given(
    hnp.arrays(np.float32, (5, 3, 6), elements=st.floats(-1e6, 1e6, width=32) | st.just(np.float32(np.nan))),
    st.sampled_from([3, 4, 5]),
)
@settings(max_examples=60, deadline=None)
def test_whatever_comes_a_kept_pixel_has_a_finite_phase(frames, steps):
    got = decode(frames, [group(steps)], NOISE, OPEN, threads=1)
    kept = got.rejected == 0
    assert np.isfinite(got.phase_rad[kept]).all() and np.isfinite(got.sigma_rad[kept]).all()
    assert np.isnan(got.phase_rad[~kept]).all()
    assert (np.abs(got.phase_rad[kept]) <= np.float32(np.pi)).all()


@pytest.mark.parametrize("groups", [[], [group(4), group(4, 8.0)]])
def test_a_wrapped_phase_of_no_group_or_of_two_is_refused(groups):
    with pytest.raises(ValueError, match="a wrapped phase needs exactly one"):
        decode(np.zeros((4, 5, 5), np.uint8), groups, NOISE, OPEN)


def test_two_steps_are_refused():
    with pytest.raises(ValueError, match="at least three different ones"):
        decode(np.zeros((2, 5, 5), np.uint8), [group(2)], NOISE, OPEN)
