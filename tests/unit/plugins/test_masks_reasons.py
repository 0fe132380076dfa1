"""Optional masks: each drops what it is for, says why, and leaves the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import columns, run, seen
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fringed.data import Reject
from fringed.errors import DataError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder
from fringed_plugins.phase.masks.hot import flag_hot, hot_in_dark
from fringed_plugins.phase.masks.order_median import settle_by_median
from fringed_plugins.phase.masks.repeated import flag_repeated
from fringed_plugins.phase.masks.shadow import flag_shadow
from fringed_plugins.phase.masks.specks import flag_specks

TARGET = ProjectorTarget(1024, 768)


def shown(u, **how):
    sequence = MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), TARGET)
    return seen(sequence, u, **how)


def changed(frame_set, change):
    frames = frame_set.frames.astype(float)
    change(frames)
    return replace(frame_set, frames=np.clip(np.rint(frames), 0, 255).astype(np.uint8))


def decoded(frames, **params):
    return run(MultiFrequencyDecoder, {"frames": frames}, **params)


HOT = [(10, 30), (25, 77), (40, 5)]


def with_hot_pixels(frames):
    for y, x in HOT[:2]:
        frames[:, y, x] += 60  # a dark current that adds
    frames[:, HOT[2][0], HOT[2][1]] = 20  # a pixel that never answers


def test_hot_pixels_are_found_flagged_and_blanked():
    frames = changed(shown(columns(120, 60, 20, 1000), noise_dn=1.0, gain=0.5), with_hot_pixels)
    phase = decoded(frames, hot_pixel_spread=1.0)
    hot = (phase.rejected & Reject.HOT_PIXEL) > 0
    assert sorted(map(tuple, np.argwhere(hot).tolist())) == sorted(HOT)
    assert np.isnan(phase.phase_rad[hot]).all()
    assert not ((decoded(frames).rejected & Reject.HOT_PIXEL) > 0).any()  # off by default


def test_listed_pixels_are_dropped_and_places_outside_refused():
    frames = shown(columns(120, 60, 20, 1000), gain=0.5)
    phase = decoded(frames, hot_pixels=[[3, 4], [59, 119]])
    assert np.argwhere(phase.rejected & Reject.HOT_PIXEL).tolist() == [[3, 4], [59, 119]]
    with pytest.raises(DataError, match="row 60, column 0 is not in an image of 60 rows"):
        decoded(frames, hot_pixels=[[60, 0]])


def test_edges_of_light_make_no_hot_pixels():
    rng = np.random.default_rng(2)
    light = np.where(np.add.outer(np.arange(80), np.arange(90)) % 20 < 10, 40.0, 160.0)
    light = (light + rng.normal(0, 1.0, light.shape)).astype(np.float32)
    flags = np.zeros(light.shape, np.uint16)
    flag_hot(light, light / 2, flags, (1.0, 10.0), threads=2)
    assert not flags.any()


def test_dark_frame_shows_hot_pixels():
    rng = np.random.default_rng(3)
    dark = rng.normal(4, 1.0, (100, 120))
    dark[7, 9], dark[50, 60] = 30, 200
    assert np.argwhere(hot_in_dark(np.rint(np.clip(dark, 0, 255)).astype(np.uint8))).tolist() == [[7, 9], [50, 60]]


def shaded(frames):
    frames[:, 10:20, 30:50] = 90 + 0.02 * frames[:, 10:20, 30:50]  # other light, hardly a fringe
    frames[:, 30:40, 30:50] = 3 + 0.02 * frames[:, 30:40, 30:50]  # nothing at all


def test_shadow_is_told_from_black():
    frames = changed(shown(columns(120, 60, 20, 1000), gain=0.5, noise_dn=0.3), shaded)
    phase = decoded(frames, min_contrast=0.05)
    shadow, low = (phase.rejected & Reject.SHADOW) > 0, (phase.rejected & Reject.LOW_MODULATION) > 0
    assert shadow[10:20, 30:50].all()
    assert not shadow[30:40, 30:50].any()
    assert low[30:40, 30:50].all()
    assert shadow.sum() == 200
    assert ((phase.rejected == 0) | shadow | low | (phase.rejected & Reject.DISCONTINUITY > 0)).all()


def test_islands_below_the_size_are_dropped():
    u = columns(120, 60, 20, 1000)

    def hide(frames):
        frames[:, 20:32, 20:32] = 10
        frames[:, 24:28, 24:28] = 10 + 0.5 * np.arange(12).reshape(12, 1, 1)  # no island: another residual
        frames[:, 23:28, 23:28] = base.frames[:, 23:28, 23:28]

    base = shown(u, gain=0.5)
    frames = changed(base, hide)
    settings = {"min_border_modulation": 0.0, "min_similar_neighbours": 4}
    kept = decoded(frames, **settings).rejected[23:28, 23:28] == 0
    assert kept.any()
    dropped = decoded(frames, min_region_px=30, **settings)
    assert (dropped.rejected[23:28, 23:28] & Reject.ISOLATED)[kept].all()
    assert (dropped.rejected == 0).sum() == (decoded(frames, **settings).rejected == 0).sum() - kept.sum()


def test_one_camera_pixel_stays_for_each_projector_pixel():
    u = columns(600, 10, 100.2, 250.7)  # four camera pixels for each column
    phase = decoded(shown(u, gain=0.8), drop_repeated=True)
    kept = phase.rejected == 0
    column = phase.phase_rad * phase.period_px / (2 * np.pi)
    for y in range(10):
        seen_columns = np.rint(column[y][kept[y]])
        assert len(set(seen_columns.tolist())) == len(seen_columns)
    assert ((phase.rejected == 0) | (phase.rejected == Reject.REPEATED)).all()
    # The nearest of four pixels a quarter apart is within an eighth; a cell at the end may have lost it.
    assert np.percentile(np.abs(column[kept] - np.rint(column[kept])), 95) < 0.14


def test_runs_of_repeated_pixels_go_down_for_rows():
    u = np.linspace(5.1, 9.9, 40, dtype=np.float32)[:, None] + np.zeros((40, 3), np.float32)
    flags = np.zeros((40, 3), np.uint16)
    flag_repeated(2 * np.pi * u / 8, flags, (8.0, 0.0), down=True, threads=1)
    assert (flags == 0).sum(axis=0).tolist() == [6, 6, 6]
    assert set(np.rint(u[flags == 0]).tolist()) == {5.0, 6.0, 7.0, 8.0, 9.0, 10.0}


def test_a_gap_or_a_step_ends_a_run():
    u = np.array([[5.0, 5.1, 20.0, 5.05, 5.2]], np.float32)
    flags = np.zeros((1, 5), np.uint16)
    flag_repeated(2 * np.pi * u / 8, flags, (8.0, 0.0), threads=1)
    assert flags.tolist() == [[0, 1024, 0, 0, 1024]]


@pytest.mark.parametrize("window", [3, 5])
def test_median_mends_single_orders_and_keeps_the_phase(window):
    rng = np.random.default_rng(5)
    true = 0.2 * np.arange(80)[None] + 0.1 * np.arange(50)[:, None] + rng.normal(0, 0.05, (50, 80))
    wrong = rng.random(true.shape) < 0.03
    phase = (true + 2 * np.pi * wrong * rng.choice([-8, -1, 1, 8], true.shape)).astype(np.float32)
    phase[20, 30] = np.nan
    settle_by_median(phase, window, threads=2)
    assert np.isnan(phase[20, 30])
    phase[20, 30] = true[20, 30]
    assert (np.abs(phase - true) > 1).mean() < (2e-3 if window == 3 else 1e-4)
    assert np.abs(np.angle(np.exp(1j * (phase - true)))).max() < 1e-4


def test_median_leaves_a_step_where_it_is():
    true = np.where(np.arange(60) < 30, 10.0, 10.0 + 6 * np.pi)[None] + 0.05 * np.arange(40)[:, None]
    phase = true.astype(np.float32)
    settle_by_median(phase, 5)
    assert np.abs(phase - true).max() < 1e-4


def test_window_of_the_median_is_odd_and_small():
    with pytest.raises(ValueError, match="odd"):
        settle_by_median(np.zeros((5, 5), np.float32), 4)
    with pytest.raises(ValueError, match="odd"):
        settle_by_median(np.zeros((5, 5), np.float32), 11)


@given(
    kept=arrays.arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))), least=st.integers(2, 20)
)  # fmt: skip
def test_specks_agree_with_counting_by_hand(kept, least):
    flags = np.where(kept, 0, 2).astype(np.uint16)
    flag_specks(flags, least)
    seen_px, sizes = set(), {}
    for start in map(tuple, np.argwhere(kept)):
        if start in seen_px:
            continue
        region, edge = {start}, [start]
        while edge:
            y, x = edge.pop()
            for place in ((y + i, x + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
                inside = 0 <= place[0] < kept.shape[0] and 0 <= place[1] < kept.shape[1]
                if inside and kept[place] and place not in region:
                    region.add(place)
                    edge.append(place)
        seen_px |= region
        sizes |= dict.fromkeys(region, len(region))
    for place in map(tuple, np.argwhere(kept)):
        assert (flags[place] == 0) == (sizes[place] >= least)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 2)])
def test_masks_take_images_of_any_size(shape):
    light, flags = np.full(shape, 50, np.float32), np.zeros(shape, np.uint16)
    flag_hot(light, light, flags, (1.0, 1.0))
    flag_shadow(light, light, flags, (0.5, 4.0))
    flag_repeated(light * np.arange(light.size, dtype=np.float32).reshape(shape), flags, (8.0, 0.0))
    settle_by_median(light, 3)
    assert not flags.any()
    flag_specks(flags, 100)
    assert (flags == Reject.ISOLATED).all()


def test_wrapped_phases_have_masks_too():
    frames = changed(shown(columns(120, 60, 20, 1000), noise_dn=1.0, gain=0.5), with_hot_pixels)
    phase = run(PhaseShiftDecoder, {"frames": frames}, hot_pixel_spread=1.0, min_region_px=50)
    assert np.argwhere(phase.rejected & Reject.HOT_PIXEL).tolist() == [list(place) for place in sorted(HOT)]
