"""Doubtful fringe orders: settled by what surrounds them where that knows, dropped where it does not."""

from __future__ import annotations

import numpy as np
import pytest
from fringe_truth import intensities

from fringed.data import Reject
from fringed_plugins.phase.decode import decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.projection.graycode import Code, bits_needed, cell_of
from fringed_plugins.phase.shifts import Group
from fringed_plugins.phase.temporal.absolute import decode_joint
from fringed_plugins.phase.temporal.gray import decode_gray_fringes
from fringed_plugins.phase.temporal.graybits import BitFrames

HEIGHT, WIDTH, SIZE_PX, PERIOD_PX, MODULATION = 150, 420, 1024, 16.0, 40.0
SHIFTS = tuple(2 * np.pi * np.arange(4) / 4)


def relief():
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return 60 + 0.65 * x + 8 * np.sin(x / 60) * np.cos(y / 50)


def board():
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return relief() + 37.0 * ((x // 70 + y // 60) % 2)


def fringes(u, periods, light, noise, seed=0):
    rng = np.random.default_rng(seed)
    stack = np.concatenate([intensities(u, period, 4, 100.0, MODULATION * light) for period in periods])
    groups = [Group(tuple(range(4 * i, 4 * i + 4)), SHIFTS, period) for i, period in enumerate(periods)]
    return stack + rng.normal(0, noise, stack.shape), groups


def eight_bits(frames):
    return np.clip(np.rint(frames), 0, 255).astype(np.uint8)


def hierarchical(u, light, noise, thresholds):
    frames, groups = fringes(u, (1024.0, 128.0, 16.0), light, noise)
    return decode(eight_bits(frames), groups, NoiseModel(noise**2 + 1 / 12, 0.0), thresholds, SIZE_PX, threads=2)


def heterodyne(u, light, noise, thresholds):
    frames, groups = fringes(u, (1024 / 56, 1024 / 63, 16.0), light, noise)
    return decode_joint(eight_bits(frames), groups, NoiseModel(noise**2 + 1 / 12, 0.0), thresholds, SIZE_PX, threads=2)


def gray(u, light, noise, thresholds):
    frames, groups = fringes(u, (16.0,), light, noise)
    code = Code(bits_needed(SIZE_PX, 8.0), 8.0)
    cell = cell_of(u, code)
    word = cell ^ (cell >> 1)
    rng = np.random.default_rng(9)
    bits = [100.0 + MODULATION * light * (2 * ((word >> (code.bits - 1 - b)) & 1) - 1) for b in range(code.bits)]
    stack = eight_bits(np.concatenate([frames, np.array(bits) + rng.normal(0, noise, (code.bits, *u.shape))]))
    found = BitFrames(code, tuple(range(4, 4 + code.bits)), (-1,) * code.bits)
    return decode_gray_fringes(
        stack, groups, found, NoiseModel(noise**2 + 1 / 12, 0.0), thresholds, SIZE_PX, threads=2
    )  # fmt: skip


def wrong_and_kept(got, u):
    kept = got.rejected == 0
    assert np.array_equal(np.isfinite(got.phase_rad), kept)
    off = got.phase_rad * PERIOD_PX / (2 * np.pi) - u
    return float((np.abs(off[kept]) > PERIOD_PX / 2).mean()) if kept.any() else 0.0, float(kept.mean())


@pytest.mark.parametrize("method", [hierarchical, heterodyne, gray])
@pytest.mark.parametrize("surface", [relief, board])
@pytest.mark.parametrize(("snr", "wrong_at_most", "kept_at_least"), [(5.0, 1e-4, 0.97), (2.0, 1e-2, 0.9)])
def test_orders_of_a_noisy_set_are_right_and_most_points_stay(method, surface, snr, wrong_at_most, kept_at_least):
    u = surface()
    wrong, kept = wrong_and_kept(method(u, 1.0, MODULATION / snr, Thresholds()), u)
    assert wrong < wrong_at_most
    assert kept > kept_at_least


@pytest.mark.parametrize("method", [hierarchical, heterodyne, gray])
def test_without_windows_each_pixel_stands_by_itself_and_few_stay(method):
    u = relief()
    alone = Thresholds(window_snr=0.0)
    wrong, kept = wrong_and_kept(method(u, 1.0, MODULATION / 3, alone), u)
    assert wrong < 1e-2
    assert kept < 0.1


@pytest.mark.parametrize("method", [hierarchical, heterodyne, gray])
@pytest.mark.parametrize("snr", [20.0, 8.0, 4.0])
def test_what_is_not_lit_stays_dropped_right_up_to_the_light(method, snr):
    u = relief()
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    light = ((x - 210) ** 2 / 180**2 + (y - 75) ** 2 / 60**2 < 1).astype(float)
    got = method(u, light, MODULATION / snr, Thresholds())
    kept = got.rejected == 0
    assert (kept & (light == 0)).sum() < 2e-4 * (light == 0).sum()
    assert kept[light > 0].mean() > 0.93
    assert wrong_and_kept(got, u)[0] < 3e-4


def test_few_doubtful_pixels_are_settled_by_their_neighbours():
    u = relief()
    noise = MODULATION / 9
    alone = hierarchical(u, 1.0, noise, Thresholds(window_snr=0.0, similar_neighbours=0, border_glow=0.0))
    doubtful = alone.rejected != 0
    assert 0.0005 < doubtful.mean() < 0.01
    got = hierarchical(u, 1.0, noise, Thresholds(similar_neighbours=0, border_glow=0.0))
    settled = doubtful & (got.rejected == 0)
    assert settled.sum() > 0.95 * doubtful.sum()
    assert wrong_and_kept(got, u)[0] < 1e-4
    # The phase itself is what the pixel measured; only its whole turns were chosen.
    finest = np.angle(np.exp(1j * (got.phase_rad - 2 * np.pi * u / PERIOD_PX)))[settled]
    assert np.std(finest) == pytest.approx(np.sqrt(0.5) / 9, rel=0.15)
    assert np.median(got.sigma_rad[settled]) == pytest.approx(np.sqrt(0.5) / 9, rel=0.15)


def test_pixels_that_contradict_themselves_without_noise_are_not_explained_away():
    u = relief()
    frames, groups = fringes(u, (1024.0, 128.0, 16.0), 1.0, 0.5)
    mixed = np.zeros(u.shape, bool)
    mixed[70:76, 100:300:20] = True
    other, _ = fringes(u + 60.0, (1024.0, 128.0, 16.0), 1.0, 0.0)
    frames[:, mixed] = (0.5 * frames + 0.5 * other)[:, mixed]  # two surfaces in one pixel
    got = decode(eight_bits(frames), groups, NoiseModel(0.3, 0.0), Thresholds(order_turns=0.2), SIZE_PX, threads=1)
    assert (got.rejected[mixed] != 0).mean() > 0.9
    assert (got.rejected[~mixed] == 0).mean() > 0.99


def test_result_does_not_depend_on_threads():
    u = board()
    for noise in (MODULATION / 9, MODULATION / 3):
        frames, groups = fringes(u, (1024.0, 128.0, 16.0), 1.0, noise)
        one, three = (
            decode(eight_bits(frames), groups, NoiseModel(noise**2, 0.0), Thresholds(), SIZE_PX, threads=threads)
            for threads in (1, 3)
        )
        assert np.array_equal(one.phase_rad, three.phase_rad, equal_nan=True)
        assert np.array_equal(one.rejected, three.rejected)


def test_all_dark_saturated_or_tiny_images_are_no_trouble():
    frames, groups = fringes(relief(), (1024.0, 128.0, 16.0), 0.0, 6.0)
    got = decode(eight_bits(frames), groups, NoiseModel(36.0, 0.0), Thresholds(), SIZE_PX, threads=2)
    assert (got.rejected != 0).mean() > 0.9999
    for shape in ((1, 1), (1, 9), (9, 1), (3, 3)):
        small, groups = fringes(np.full(shape, 300.0), (1024.0, 128.0, 16.0), 1.0, 12.0)
        got = decode(eight_bits(small), groups, NoiseModel(144.0, 0.0), Thresholds(), SIZE_PX, threads=2)
        assert np.array_equal(np.isnan(got.phase_rad), got.rejected != 0)
    white = np.full((12, 30, 40), 255, np.uint8)
    got = decode(white, groups, NoiseModel(9.0, 0.0), Thresholds(saturation_dn=255.0), SIZE_PX, threads=2)
    assert (got.rejected & Reject.SATURATED).all()
