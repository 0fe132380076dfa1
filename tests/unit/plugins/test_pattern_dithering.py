"""Dithered patterns: the mean light around a pixel is the wanted one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fringed_plugins.phase.projection import dithering

TWO = np.array([0.0, 1.0])
GAMMA = (np.arange(256) / 255) ** 2.2
METHODS = (dithering.diffuse, dithering.ordered)


def fringes(period, shape=(192, 384)):
    return np.broadcast_to((1 + np.cos(2 * np.pi * np.arange(shape[1]) / period)) / 2, shape)


def inner(image, border=32):
    return image[border:-border, border:-border]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("light", [TWO, GAMMA, np.array([0.0, 0.1, 0.7, 1.0])])
def test_mean_of_a_uniform_area_is_the_wanted_light(method, light):
    # Error diffusion hands every error on, so that a square's mean is off by what crosses its border: about
    # perimeter / area of half a gap, 64 px: 0.03. The thresholds of 4096 pixels are spread within 1e-2.
    gap = np.diff(light).max()
    for wanted in (0.0, 0.013, 0.25, 1 / 3, 0.5, 0.77, 1.0):
        shown = light[method(np.full((64, 64), wanted), light)]
        assert abs(shown.mean() - wanted) < 0.03 * gap


def test_no_pixel_is_further_from_its_light_than_the_widest_gap():
    # Each level is off by half a gap at most; the errors that come in, weights that add up to 1, are as large.
    wanted = fringes(40.0)
    assert np.abs(GAMMA[dithering.diffuse(wanted, GAMMA)] - wanted).max() <= np.diff(GAMMA).max()
    below = np.clip(np.searchsorted(GAMMA, wanted, side="right") - 1, 0, 254)
    assert set(np.unique(dithering.ordered(wanted, GAMMA).astype(int) - below)) <= {0, 1}


@pytest.mark.parametrize("period", [16.0, 24.5, 64.0])
def test_dots_blurred_are_fringes(period):
    wanted = fringes(period)
    blurred = gaussian_filter(TWO[dithering.diffuse(wanted, TWO)], 2.0)
    error = inner(blurred - gaussian_filter(wanted, 2.0))
    # A dot of full contrast in white noise would leave 0.5 / sqrt(4 pi 4) = 0.07; blue noise has less of it.
    assert np.sqrt((error**2).mean()) < 0.01
    assert abs(error.mean()) < 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_dithering_beats_the_nearest_level(method):
    wanted = fringes(64.0)
    above = np.clip(np.searchsorted(GAMMA, wanted), 1, 255)
    nearest = above - (wanted - GAMMA[above - 1] < GAMMA[above] - wanted)
    ideal = gaussian_filter(wanted, 2.0)
    plain, dithered = (
        np.sqrt((inner(gaussian_filter(GAMMA[index], 2.0) - ideal) ** 2).mean())
        for index in (nearest, method(wanted, GAMMA))
    )
    assert dithered < plain / 3


def test_columns_of_dots_have_no_low_harmonics():
    # What a camera sees after blur are the low harmonics of the columns' means; 3 and up are ripple on the phase.
    wanted = fringes(32.0, (512, 256))
    for method, bound in ((dithering.diffuse, 0.01), (dithering.ordered, 0.005)):
        means = TWO[method(wanted, TWO)].mean(axis=0)
        harmonics = 2 * np.abs(np.fft.rfft(means - wanted[0]))[[8, 16, 24, 32]] / 256
        assert harmonics.max() < bound


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (3, 5)])
def test_small_and_strange_arrays(method, shape):
    wanted = np.asfortranarray(np.full(shape, 0.5))
    wanted.flags.writeable = False
    shown = method(wanted, TWO)
    assert shown.shape == shape and shown.dtype == np.uint8 and shown.max() <= 1


@pytest.mark.parametrize("method", METHODS)
def test_flat_parts_of_a_curve_do_no_harm(method):
    light = np.array([0.0, 0.0, 0.5, 0.5, 0.5, 1.0])
    shown = light[method(np.full((64, 64), 0.6), light)]
    assert shown.mean() == pytest.approx(0.6, abs=0.01)
