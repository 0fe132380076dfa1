"""Colours unmixed: the crosstalk measured on bars, channels separated, their noise."""

from __future__ import annotations

import colour_truth as colour
import fringe_truth as truth
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.data import FrameSet, PatternSequence
from fringed.errors import DataError, UsageError
from fringed.hookspecs import ProjectorTarget
from fringed.testing import RecordingContext
from fringed_plugins.decoders.colour import MeasureCrosstalk
from fringed_plugins.encoders.one_shot import ColourBarsEncoder
from fringed_plugins.phase.colours.colour import Colours, noise_of_unmixed, unmix
from fringed_plugins.phase.colours.crosstalk import checked_condition, measure_crosstalk
from fringed_plugins.phase.noise import NoiseModel

TARGET = ProjectorTarget(256, 192)
WIDTH, HEIGHT = 120, 90
U = truth.columns(WIDTH, HEIGHT, 20, 230)
ALBEDO = 0.6 + 0.4 * np.sin(np.arange(WIDTH) / 9.0) * np.ones((HEIGHT, 1)) * 0.5


def bars(**kwargs):
    return colour.shots(ColourBarsEncoder().encode(ColourBarsEncoder.Params(), TARGET), U, **kwargs)


def measured(frame_set, **params):
    inputs = {"frames": frame_set, "calibration": truth.small_rig()}
    context = RecordingContext()
    return MeasureCrosstalk().run(inputs, MeasureCrosstalk.Params(**params), context), context


def test_crosstalk_is_found_on_a_surface_of_varying_brightness():
    found, _ = measured(bars(reflectance=ALBEDO * np.ones((3, 1, 1))))
    # 10,800 pixels of 1.5 grey levels of noise over about 110 of light: 1e-4, and rounding's share.
    assert np.abs(found.crosstalk - colour.MIX).max() < 1e-3
    assert found.crosstalk.sum() == pytest.approx(3.0)
    assert found.residuals["black_green_dn"] == pytest.approx(2.0, abs=0.2)
    assert found.residuals["crosstalk_sigma"] < 5e-4
    assert found.hash == truth.small_rig().hash  # geometry is what it was


def test_stated_error_is_the_scatter():
    matrices = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        even = np.ones((3, 40, 50))
        lights = [np.reshape(c, (3, 1, 1)) * even for c in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1))]
        clean = np.stack([colour.camera_channels(light, colour.GREY, 0) for light in lights])
        matrices.append(measure_crosstalk(clean + rng.normal(0, 2, clean.shape), 255.0))
    scatter = np.std([m.matrix for m in matrices], axis=0, ddof=1).mean()
    # The normalisation ties the entries together, which takes off some of their independent errors.
    assert 0.6 < scatter / np.mean([m.sigma for m in matrices]) < 1.3


def test_gains_of_the_camera_stay_in_the_matrix():
    images = bars(noise_dn=0.0).frames.astype(float)
    images[1::3] = 2 + 0.6 * (images[1::3] - 2)  # a green sensor less sensitive
    stack = images.reshape(5, 3, HEIGHT, WIDTH)
    found = measure_crosstalk(stack, 255.0)
    separate = unmix(stack[2].astype(np.float32), Colours(found.matrix, tuple(found.black_dn)))
    assert np.abs(separate[[0, 2]]).max() < 0.01 * separate[1].min()


def test_outliers_do_not_count():
    frame_set = bars(reflectance=ALBEDO * np.ones((3, 1, 1)))
    spoilt = frame_set.frames.copy()
    spoilt[3, 20:40, 30:60] = 130  # a red label
    found, _ = measured(FrameSet(spoilt, frame_set.sequence))
    assert np.abs(found.crosstalk - colour.MIX).max() < 2e-3


def test_projector_that_does_not_add_its_colours_is_told():
    frame_set = bars(noise_dn=0.0)
    white = frame_set.frames.copy()
    white[12:15] = np.minimum(white[12:15] * 1.15, 254)
    _, context = measured(FrameSet(white, frame_set.sequence))
    assert any(level == "warning" and "does not add" in text for level, text in context.logged)
    _, context = measured(frame_set)
    assert not [text for level, text in context.logged if level == "warning"]


@pytest.mark.parametrize(("gain", "words"), [(0.5, "lit and not saturated"), (400.0, "are saturated")])
def test_too_little_and_too_much_light_are_refused(gain, words):
    with pytest.raises(DataError, match=words):
        measured(bars(gain=gain))


def test_camera_without_colours_is_refused():
    frame_set = bars()
    grey = frame_set.frames.copy()
    grey[1::3] = grey[0::3]
    grey[2::3] = grey[0::3]
    with pytest.raises(DataError, match="cannot be told apart"):
        measured(FrameSet(grey, frame_set.sequence))


def test_set_without_bars_is_refused():
    frame_set = bars()
    first = PatternSequence("x", 256, 192, frame_set.sequence.frames[:9], frame_set.sequence.patterns[:9])
    with pytest.raises(DataError, match="9 of the 15 frames"):
        measured(FrameSet(frame_set.frames[:9], first))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_channels_are_separated(dtype):
    light = np.random.default_rng(0).uniform(0.1, 1, (3, 7, 9))
    seen = (5 + 200 * np.einsum("cj,jhw->chw", colour.MIX, light)).astype(dtype)
    found = unmix(np.asfortranarray(seen), Colours(colour.MIX, (5.0, 5.0, 5.0)))
    # Rounding to whole grey levels is at most one, times the largest row sum of the inverse.
    limit = 1e-3 if seen.dtype.kind == "f" else np.abs(np.linalg.inv(colour.MIX)).sum(axis=1).max()
    assert np.abs(found - 200 * light).max() < limit
    assert found.dtype == np.float32


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(0, 0.3), min_size=6, max_size=6), st.integers(1, 5), st.integers(1, 6))
def test_unmixing_undoes_any_mixing(off, height, width):
    mix = np.eye(3)
    mix[~np.eye(3, dtype=bool)] = off
    light = np.random.default_rng(1).uniform(0, 200, (3, height, width))
    found = unmix(np.einsum("cj,jhw->chw", mix, light).astype(np.float32), Colours(mix))
    assert np.allclose(found, light, atol=2e-3 * np.linalg.cond(mix))


def test_noise_grows_as_the_inverse_says():
    rng = np.random.default_rng(0)
    seen = 100 + rng.normal(0, 2, (3, 200, 300))
    found = unmix(seen.astype(np.float32), Colours(colour.MIX))
    stated = [np.sqrt(model.constant_dn2) for model in noise_of_unmixed(Colours(colour.MIX), NoiseModel(4.0, 0.0))]
    assert np.allclose(found.std(axis=(1, 2)), stated, rtol=0.02)


def test_overlapping_and_read_only_channels_are_taken():
    base = np.arange(40, dtype=np.uint8).reshape(4, 10)
    overlapping = np.lib.stride_tricks.sliding_window_view(base, 3, axis=0).transpose(2, 0, 1)[:, :2]
    assert np.array_equal(unmix(overlapping, Colours(np.eye(3))), overlapping.astype(np.float32))


def test_wrong_shapes_and_matrices_are_refused():
    with pytest.raises(ValueError, match="expected"):
        unmix(np.zeros((2, 4, 4), np.uint8), Colours(np.eye(3)))
    with pytest.raises(ValueError, match="bars have shape"):
        measure_crosstalk(np.zeros((4, 3, 4, 4)), 255.0)
    for matrix in (np.ones((3, 3)), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="told apart"):
            checked_condition(matrix)


def test_contract_is_kept(plugin_contract):
    plugin_contract.processor(MeasureCrosstalk, {"frames": bars(), "calibration": truth.small_rig()})
    plugin_contract.encoder(ColourBarsEncoder)
    with pytest.raises(UsageError, match="make no fringes"):
        ColourBarsEncoder().encode(ColourBarsEncoder.Params(grey_low=100, grey_high=101), TARGET)
