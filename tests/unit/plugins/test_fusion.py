"""Several exposures made one, against maps whose phase, noise and light are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.data import PhaseMap, Reject
from fringed.errors import DataError
from fringed.testing import RecordingContext
from fringed_plugins.decoders.fusion import FuseExposures
from fringed_plugins.phase.exposure.fusion import ExposedMap, FusionLimits, Light, fuse, relative_light

SHAPE = (90, 120)
NONE = np.zeros((0, 0), np.float32)


def exposed(gain, seed, phase, albedo, wrapped=False, black=3.0):
    """A map as 8-bit frames of a scene would give it: shot and read noise, saturated above, lost in noise below."""
    rng = np.random.default_rng(seed)
    modulation, background = 100 * gain * albedo, black + 110 * gain * albedo
    frame_sigma = np.sqrt(background / 50 + 0.1)
    sigma = frame_sigma * np.sqrt(2 / 4) / modulation
    seen = phase + sigma * rng.standard_normal(SHAPE)
    if wrapped:
        seen = np.angle(np.exp(1j * seen))
    rejected = np.where(background + modulation > 255, Reject.SATURATED, 0)
    rejected |= np.where(modulation < 5 * frame_sigma, Reject.LOW_MODULATION, 0)
    bad = rejected > 0
    return ExposedMap(
        np.where(bad, np.nan, seen).astype(np.float32),
        np.where(bad, np.nan, sigma).astype(np.float32),
        modulation.astype(np.float32),
        background.astype(np.float32),
        NONE,
        rejected.astype(np.uint16),
    )


@pytest.fixture(scope="module")
def scene():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 100.0
    albedo = np.exp(-4.6 * (0.5 + 0.5 * np.sin(7 * x + 3 * y)))  # 0.01 to 1
    return 40 * x + 3 * np.sin(9 * y), albedo


GAINS = (1.0, 8.0, 0.125)


@pytest.fixture(scope="module")
def bracket(scene):
    phase, albedo = scene
    return [exposed(gain, seed, phase, 4 * albedo) for seed, gain in enumerate(GAINS)]


def test_every_pixel_that_any_exposure_shows_is_there_and_its_deviation_is_true(scene, bracket):
    fused = fuse(bracket, False)
    kept = fused.rejected == 0
    single = [one.rejected == 0 for one in bracket]
    assert np.array_equal(kept, np.any(single, axis=0))
    assert kept.mean() > 0.99 > 0.8 > max(one.mean() for one in single)
    error = (fused.phase_rad - scene[0])[kept] / fused.sigma_rad[kept]
    # 10,800 independent normal errors: their mean square is 1 within 1.4 %, their mean 0 within 1 %.
    assert abs(np.mean(error**2) - 1) < 0.06
    assert abs(error.mean()) < 0.05


def test_deviation_is_never_worse_than_the_best_exposures(bracket):
    fused = fuse(bracket, False)
    best = np.nanmin([np.where(one.rejected == 0, one.sigma_rad, np.nan) for one in bracket], axis=0)
    kept = fused.rejected == 0
    assert np.all(fused.sigma_rad[kept] <= best[kept] * (1 + 1e-6))


def test_weights_are_inverse_variances():
    ones = np.ones((1, 3), np.float32)
    mask = np.zeros((1, 3), np.uint16)
    maps = [ExposedMap(ones * p, ones * s, ones, ones, NONE, mask) for p, s in ((1.0, 0.1), (1.2, 0.2), (0.9, 0.3))]
    fused = fuse(maps, False, [Light(1.0, 0.0)] * 3)
    weights = np.array([1 / 0.01, 1 / 0.04, 1 / 0.09])
    assert fused.phase_rad[0, 0] == pytest.approx(weights @ [1.0, 1.2, 0.9] / weights.sum(), abs=1e-6)
    assert fused.sigma_rad[0, 0] == pytest.approx(weights.sum() ** -0.5, rel=1e-6)


def test_light_of_the_maps_is_measured_with_its_black_level(bracket):
    light = relative_light(bracket)
    darkest = min(GAINS)
    for one, gain in zip(light, GAINS, strict=True):
        assert one.gain == pytest.approx(darkest / gain, rel=1e-3)
        assert one.offset == pytest.approx(3.0 * (1 - darkest / gain), abs=0.02)
    fused = fuse(bracket, False)
    kept = fused.rejected == 0
    assert fused.background[kept] == pytest.approx(bracket[2].background[kept], rel=1e-3, abs=0.05)
    assert fused.modulation == pytest.approx(bracket[2].modulation, rel=1e-3)


def test_light_is_compared_over_a_map_between_where_two_share_nothing():
    column = np.linspace(0.01, 1, 400)[None, :] * np.ones((30, 1))
    parts = [(column < 0.35), (column > 0.3) & (column < 0.7), (column > 0.65)]
    maps = []
    for gain, part in zip((16.0, 4.0, 1.0), parts, strict=True):
        values = (column * gain).astype(np.float32)
        maps.append(ExposedMap(values, values, values, values + 2, NONE, (~part * 2).astype(np.uint16)))
    assert [one.gain for one in relative_light(maps)] == pytest.approx([1 / 16, 1 / 4, 1], rel=1e-5)
    assert all(one.measured for one in relative_light(maps))


def test_backgrounds_compare_light_where_no_pixel_is_valid_in_both():
    column = np.linspace(0.01, 1, 400)[None, :] * np.ones((30, 1))
    dark, bright = (ExposedMap(*(np.float32(column * gain),) * 3, np.float32(column * gain + 2), NONE,
                               (flag * (np.arange(400) > 200 if gain > 1 else np.arange(400) <= 200)).astype(np.uint16)
                               * np.ones((30, 1), np.uint16))
                    for gain, flag in ((10.0, 2), (80.0, 2)))  # fmt: skip
    for maps in ((dark, bright), (bright, dark)):
        light = relative_light(maps)
        assert sorted(one.gain for one in light) == pytest.approx([1 / 8, 1], rel=1e-3)
        assert sorted(one.offset for one in light) == pytest.approx([0, 2 * 7 / 8], abs=0.01)


def test_map_that_nothing_links_still_gives_its_phases():
    ones = np.ones((40, 40), np.float32)
    left = np.arange(40)[None, :] < 20
    bright = ExposedMap(ones * 1, ones, 9 * ones, 9 * ones, NONE, (~left * np.ones((40, 1))).astype(np.uint16))
    dark = ExposedMap(ones * 2, ones, ones, ones, NONE, (left * 2 * np.ones((40, 1))).astype(np.uint16))
    light = relative_light([bright, dark])
    assert [one.measured for one in light] == [True, False]
    fused = fuse([bright, dark], False)
    assert not fused.rejected.any()
    assert np.array_equal(fused.phase_rad, np.where(left, 1, 2) * ones)
    context = RecordingContext()
    FuseExposures().run({"maps": (phase_map(bright), phase_map(dark))}, FuseExposures.Params(), context)
    assert [level for level, text in context.logged if "guessed scale" in text] == ["warning"]


def test_wrapped_phases_are_averaged_on_the_circle(scene):
    phase, albedo = scene
    maps = [exposed(gain, seed, phase, 4 * albedo, wrapped=True) for seed, gain in enumerate(GAINS)]
    fused = fuse(maps, True)
    kept = fused.rejected == 0
    assert kept.mean() > 0.99
    assert np.abs(fused.phase_rad[kept]).max() <= np.pi + 1e-6
    error = np.angle(np.exp(1j * (fused.phase_rad - phase)))[kept] / fused.sigma_rad[kept]
    assert abs(np.mean(error**2) - 1) < 0.06


@pytest.mark.parametrize(("by_rad", "flag"), [(2 * np.pi, Reject.FRINGE_ORDER), (1.0, Reject.RESIDUAL)])
def test_maps_that_contradict_each_other_drop_the_pixel_and_say_how(scene, by_rad, flag):
    phase, _ = scene
    maps = [exposed(1.0, seed, phase, np.full(SHAPE, 0.5)) for seed in range(2)]
    moved = maps[1].phase_rad.copy()
    moved[10:20, 30:40] += np.float32(by_rad)
    fused = fuse([maps[0], maps[1]._replace(phase_rad=moved)], False)
    where = np.zeros(SHAPE, bool)
    where[10:20, 30:40] = True
    assert np.all(fused.rejected[where] == flag)
    assert np.all(np.isnan(fused.phase_rad[where]) & np.isnan(fused.sigma_rad[where]))
    assert not fused.rejected[~where].any()  # 6 sigma: 2e-9 of honest pixels


def test_noisy_map_cannot_throw_out_a_good_one():
    ones = np.ones((4, 4), np.float32)
    mask = np.zeros((4, 4), np.uint16)
    good = ExposedMap(ones * 5, ones * 0.01, ones, ones, NONE, mask)
    noisy = ExposedMap(ones * (5 + 2 * np.pi), ones * 0.2, ones, ones, NONE, mask)
    fused = fuse([good, noisy], False, [Light(1, 0), Light(1, 0)])
    assert not fused.rejected.any() and np.all(fused.phase_rad == 5)
    fused = fuse([good, noisy], False, [Light(1, 0), Light(1, 0)], FusionLimits(ignored=100))
    assert np.all(fused.rejected == Reject.FRINGE_ORDER)


def test_pixel_that_all_drop_keeps_the_reasons_of_the_map_that_came_closest():
    ones = np.ones((1, 3), np.float32)
    dark = ExposedMap(ones * np.nan, ones, ones, ones, NONE, np.array([[2, 2, 1]], np.uint16))
    bright = ExposedMap(ones * np.nan, ones, 4 * ones, 4 * ones, NONE, np.array([[2 | 8, 1, 1]], np.uint16))
    fused = fuse([bright, dark], False, [Light(0.25, 0), Light(1, 0)])
    # Too dark in both: the bright one's reasons. Saturated in the bright one: the dark one's. In both: the dark one's.
    assert fused.rejected.tolist() == [[10, 2, 1]]
    assert np.isnan(fused.phase_rad).all() and np.all(fused.modulation == 1)


def test_nan_that_no_flag_tells_of_does_not_spread():
    ones = np.ones((1, 3), np.float32)
    mask = np.zeros((1, 3), np.uint16)
    holes = ones.copy()
    holes[0, 0] = np.nan
    maps = [ExposedMap(holes, ones, ones, ones, NONE, mask), ExposedMap(ones * 2, ones * holes, ones, ones, NONE, mask)]
    fused = fuse(maps, False, [Light(1, 0)] * 2)
    assert fused.rejected.tolist() == [[int(Reject.RESIDUAL), 0, 0]]
    assert fused.phase_rad[0, 1:].tolist() == [1.5, 1.5]


@settings(deadline=None, max_examples=60)
@given(
    st.integers(1, 5), st.integers(1, 9), st.integers(2, 3), st.booleans(), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_fused_phase_lies_between_those_it_is_made_of(height, width, count, wrapped, seed):
    rng = np.random.default_rng(seed)
    maps = []
    for _ in range(count):
        phase = rng.uniform(-3, 3, (height, width))
        arrays = [phase, *rng.uniform(0.01, 1, (3, height, width))]
        mask = (rng.random((height, width)) < 0.3) * 2
        maps.append(ExposedMap(*(a.astype(np.float32) for a in arrays), NONE, mask.astype(np.uint16)))
    fused = fuse(maps, wrapped, [Light(1, 0)] * count, FusionLimits(sigmas=1e4, ignored=1e3))
    seen = np.array([np.where(one.rejected == 0, one.phase_rad, np.nan) for one in maps])
    some = ~np.isnan(seen).all(axis=0)
    assert np.array_equal(fused.rejected == 0, some)
    if not wrapped and some.any():
        assert np.all(fused.phase_rad[some] <= np.nanmax(seen[:, some], axis=0) + 1e-5)
        assert np.all(fused.phase_rad[some] >= np.nanmin(seen[:, some], axis=0) - 1e-5)


def test_order_of_memory_type_and_threads_change_nothing(bracket):
    expected = fuse(bracket, False, threads=1)
    fortran = [ExposedMap(*(np.asfortranarray(array) for array in one)) for one in bracket]
    big = [ExposedMap(*(a.astype(a.dtype.newbyteorder(">")) for a in one)) for one in bracket]
    for other in (fortran, big, bracket):
        for one, two in zip(expected, fuse(other, False, threads=2), strict=True):
            np.testing.assert_array_equal(one, two)


def test_maps_that_cannot_be_fused_are_refused(bracket):
    with pytest.raises(ValueError, match="at least two"):
        fuse(bracket[:1], False)
    with pytest.raises(ValueError, match="shapes"):
        fuse([bracket[0], ExposedMap(*(array[:5] for array in bracket[1]))], False)


def phase_map(one, **changes):
    made = PhaseMap(
        one.phase_rad, one.modulation, one.background, one.rejected, "absolute", 16.0, sigma_rad=one.sigma_rad
    )
    return replace(made, **changes)


def run(maps, **params):
    return FuseExposures().run({"maps": tuple(maps)}, FuseExposures.Params(**params), RecordingContext())


def test_processor_says_what_fits_what(bracket):
    maps = [phase_map(one) for one in bracket]
    fused = run(maps)
    assert (fused.kind, fused.period_px) == ("absolute", 16.0)
    assert np.mean(fused.rejected == 0) > 0.99
    for changed, text in (
        ({"period_px": 8.0}, "period_px is 8.0, not 16.0"),
        ({"sigma_rad": None}, "no sigma_rad"),
        ({"kind": "wrapped"}, "kind is 'wrapped'"),
    ):
        with pytest.raises(DataError, match=text):
            run([maps[0], phase_map(bracket[1], **changed)])
    with pytest.raises(DataError, match="two or more"):
        run(maps[:1])
    with pytest.raises(DataError, match="2 scales"):
        run(maps, scales=[1.0, 8.0])
    with pytest.raises(DataError, match="relative"):
        run([replace(one, kind="relative") for one in maps])
    by_hand = run(maps, scales=list(GAINS))
    np.testing.assert_array_equal(by_hand.rejected, fused.rejected)


def test_confidence_is_the_best_of_those_that_count(bracket):
    sure = [np.full(SHAPE, value, np.float32) for value in (3.0, 9.0, 5.0)]
    fused = run([phase_map(one, confidence=c) for one, c in zip(bracket, sure, strict=True)])
    assert fused.confidence is not None
    only = [one.rejected == 0 for one in bracket]
    assert np.all(fused.confidence[only[0] & ~only[1] & ~only[2]] == 3.0)
    assert np.all(fused.confidence[only[1] & ~only[0] & ~only[2]] == 9.0)


def test_levels_of_one_set_are_decoded_by_themselves_and_fused():
    from fringed.data import CameraSettings, FrameSet
    from fringed.hookspecs import ProjectorTarget
    from fringed_plugins.decoders.levels import FuseLevels, level_of
    from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder

    encoder = MultiFrequencyEncoder()
    params = encoder.Params(periods=[1, 8, 32], levels=[1.0, 0.25])
    sequence = encoder.encode(params, ProjectorTarget(256, 192))
    rng = np.random.default_rng(4)
    u = np.linspace(20, 236, 180) + np.zeros((60, 1))
    gain = np.where(u > 128, 3.5, 0.8)  # the right half is shiny: at full level it saturates
    light = [2 + gain * np.interp(u, np.arange(256), pattern[0, :, 0]) for pattern in sequence.patterns]
    noise = [np.sqrt(0.06 + one / 51) * rng.standard_normal(u.shape) for one in light]
    frames = np.clip(np.rint(np.add(light, noise)), 0, 255).astype(np.uint8)
    settings = CameraSettings(electrons_per_dn=51.0, read_noise_electrons=12.0)
    frame_set = FrameSet(frames, sequence, settings=settings)
    fused = FuseLevels().run({"frames": frame_set}, FuseLevels.Params(), RecordingContext())
    kept = fused.rejected == 0
    assert kept.mean() > 0.97
    column = fused.phase_rad * fused.period_px / (2 * np.pi)
    assert np.abs(column - u)[kept].max() < 0.5
    assert np.median(fused.sigma_rad[:, :80]) < 0.05
    assert len(level_of(frame_set, 0.25).frames) == 12
    one = level_of(frame_set, 1.0)
    with pytest.raises(DataError, match="level 1 only"):
        FuseLevels().run({"frames": one}, FuseLevels.Params(), RecordingContext())
