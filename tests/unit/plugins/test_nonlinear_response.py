"""The tone curve from a ramp: what is removed, what is refused, and how well it is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed_plugins.phase.nonlinear.curve import monotone_curve
from fringed_plugins.phase.nonlinear.response import measure_response

GREYS = np.concatenate([[255, 0, 60, 200, 255, 0], np.linspace(0, 255, 33).round()[::-1], [255, 0]])
TRUTH = (np.arange(256) / 255) ** 2.2


def ramp(greys=GREYS, truth=TRUTH, shape=(60, 80), noise=1.0, lamp=None, seed=3):
    """Return frames (n, height, width) uint8 of a surface that is light and dark, with ambient light."""
    rng = np.random.default_rng(seed)
    surface = rng.uniform(60, 200, shape)
    light = truth[greys.astype(int)] * (np.ones(len(greys)) if lamp is None else lamp)
    frames = rng.uniform(2, 25, shape) + surface * (0.003 + light)[:, None, None]
    return np.clip(np.rint(frames + noise * rng.standard_normal(frames.shape)), 0, 255).astype(np.uint8)


def test_every_pixel_s_own_scale_and_offset_are_removed():
    found = measure_response(ramp(), GREYS, 255.0)
    # 4,800 pixels, noise of 1 in about 130: a frame's level is known to 1e-4 of the range.
    assert np.abs(found.curve - TRUTH).max() < 2e-3
    assert np.abs(found.curve - TRUTH).std() < 5e-4
    assert found.curve[0] == pytest.approx(0, abs=1e-12)
    assert found.curve[255] == pytest.approx(1, abs=1e-12)
    assert found.rms < 5e-4
    assert found.pixels > 4000


def test_a_lamp_that_drifts_does_not_look_like_tone():
    greys = np.concatenate([[255, 0] * 7, GREYS])
    order = np.random.default_rng(1).permutation(len(greys))
    greys = greys[order]
    lamp = np.linspace(1.0, 0.94, len(greys))
    found = measure_response(ramp(greys, lamp=lamp), greys, 255.0)
    assert np.abs(found.curve - TRUTH).max() < 4e-3
    assert found.drift == pytest.approx(-0.06, abs=0.01)
    assert found.flicker < 2e-3


def test_flicker_is_told_and_its_harm_is_stated():
    greys = np.concatenate([[255, 0] * 7, GREYS])
    lamp = 1 + 0.004 * np.random.default_rng(2).standard_normal(len(greys))
    found = measure_response(ramp(greys, lamp=lamp), greys, 255.0)
    assert 0.002 < found.flicker < 0.008
    error = np.abs(found.curve - TRUTH)
    assert error.max() < 0.012  # three times the flicker, without any averaging
    assert error.std() < 4 * found.deviation.mean()


def test_pixels_that_saturate_stay_dark_or_move_are_left_out():
    frames = ramp()
    frames[:, :10] = 255
    frames[:, 10:20] = 3
    frames[8:, 20:23] = frames[8:, 20:23][::-1]
    found = measure_response(frames, GREYS, 255.0)
    assert np.abs(found.curve - TRUTH).max() < 3e-3
    assert found.pixels <= 60 * 80 - 23 * 80


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("order", ["C", "F"])
def test_types_and_orders_of_frames_give_the_same_curve(dtype, order):
    frames = ramp()
    given_frames = np.asarray(frames.astype(dtype), order=order)
    given_frames.setflags(write=False)
    found = measure_response(given_frames, GREYS, 255.0)
    np.testing.assert_allclose(found.curve, measure_response(frames, GREYS, 255.0).curve, atol=1e-6)


@pytest.mark.parametrize(
    ("frames", "greys", "message"),
    [
        (np.zeros((4, 5, 6)), np.zeros(3), "one frame a level"),
        (np.zeros((4, 5, 6)), np.arange(4.0), "different grey levels"),
        (np.zeros((33, 5, 6)), np.linspace(0, 255, 33), "at least twice"),
        (np.zeros((len(GREYS), 5, 6)), GREYS, "pixels see the whole range"),
        (np.full((len(GREYS), 20, 20), 255, np.uint8), GREYS, "100% saturate"),
        (np.zeros((len(GREYS), 1, 1)), GREYS, "0 of 1 pixels"),
    ],
)
def test_what_gives_no_curve_is_refused_with_the_reason(frames, greys, message):
    with pytest.raises(ValueError, match=message):
        measure_response(frames, greys, 255.0)


def test_a_frame_that_came_late_is_refused():
    frames = ramp()
    frames[20] = frames[19 - 6]
    with pytest.raises(ValueError, match="take the ramp again"):
        measure_response(frames, GREYS, 255.0)


@settings(max_examples=25, deadline=None)
@given(gamma=st.floats(1.0, 3.0), bend=st.floats(0, 0.05), levels=st.integers(17, 64))
def test_curves_of_many_shapes_are_followed(gamma, bend, levels):
    x = np.arange(256) / 255
    truth = x**gamma + bend * np.sin(2 * np.pi * x) * x * (1 - x)
    grey = np.rint(np.linspace(0, 255, levels))
    curve, deviation = monotone_curve(grey, truth[grey.astype(int)], np.full(levels, 1e-4))
    assert np.all(np.diff(curve) >= -1e-12)
    assert np.abs(curve - truth).max() < 2e-3
    assert np.all(deviation > 0)


def test_a_curve_never_falls_whatever_the_noise():
    rng = np.random.default_rng(0)
    grey = np.linspace(0, 255, 33)
    light = (grey / 255) ** 2.2 + 0.03 * rng.standard_normal(33)
    curve, _ = monotone_curve(grey, light, np.full(33, 0.03))
    assert np.all(np.diff(curve) >= -1e-12)
    assert np.abs(curve - TRUTH).max() < 0.08
