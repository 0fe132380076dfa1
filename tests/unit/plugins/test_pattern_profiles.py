"""The shapes of fringes have the Fourier series that textbooks give them."""

from __future__ import annotations

import numpy as np
import pytest

from fringed_plugins.phase.projection import profiles


def series(style, order):
    """Return the amplitude of an ideal shape's harmonic, from its Fourier integral written out by hand."""
    k, odd = order, order % 2
    if style == "sinusoidal":
        return 0.5 * (k == 1)
    if style == "sawtooth":  # frac(x) = 1/2 - sum sin(2 pi k x) / (pi k)
        return 1 / (np.pi * k)
    if style == "triangular":  # 1 - 2|x|: 1/2 + sum 4 / (pi k)^2 cos, k odd
        return odd * 4 / (np.pi * k) ** 2
    if style == "trapezoidal":  # a box of half a period, averaged over ramps of a sixth
        return odd * 2 / (np.pi * k) * abs(np.sinc(k / 6))
    return odd * 2 / (np.pi * k)  # a box of half a period


def spectrum(style, period, count=1):
    """Return amplitudes and phases of one period's samples, relative to the period's own start."""
    u = np.arange(period * count)
    offset = profiles.offset_rad(style, float(period))
    light = profiles.profile(style, 2 * np.pi * u / period + offset, float(period))
    found = np.fft.rfft(light) / light.size * np.where(np.arange(light.size // 2 + 1) == 0, 1, 2)
    return light, np.abs(found[::count]), np.angle(found[count]) - offset


@pytest.mark.parametrize("style", ["sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary"])
def test_harmonics_are_those_of_the_fourier_series(style):
    # Sampling 3600 points adds to harmonic k its aliases 3600 - k, 3600 + k, ...: less than 1e-3 of a box's.
    light, amplitude, phase = spectrum(style, 3600)
    assert light.min() >= 0 and light.max() <= 1
    assert amplitude[0] == pytest.approx(0.5, abs=1e-9)
    assert phase == pytest.approx(0, abs=1e-6)
    for order in range(1, 12):
        assert amplitude[order] == pytest.approx(series(style, order), abs=1e-3)
        assert profiles.harmonic(style, order) == pytest.approx(series(style, order), abs=1e-12)


@pytest.mark.parametrize("style", [s for s in profiles.STYLES if s != "binary-dithered"])
@pytest.mark.parametrize("period", [18, 20, 30, 45, 64])
def test_fundamental_keeps_its_phase_on_whole_pixels(style, period):
    # Two-level shapes put their edges between pixels, sloped ones average over a pixel: what is left is the alias of
    # harmonic period - 1, its phase turned by rounding of the edges only where a quarter period is no whole number.
    _, amplitude, phase = spectrum(style, period, 4)
    assert abs(phase) < (1e-9 if period % 2 == 0 and "binary" in style else 2 / period**2)
    assert amplitude[1] == pytest.approx(profiles.fundamental(style, float(period)), rel=4 / period)


@pytest.mark.parametrize(("period", "gone"), [(18, (3,)), (30, (3, 9)), (3600, (3, 5, 7)), (36001, (3, 5, 7))])
def test_pulse_width_removes_its_low_harmonics(period, gone):
    # An edge that is off by d rad adds at most 4 d / pi to b_k. Three edges are off by half a pixel where they are
    # only rounded (odd periods), by 2.5 where places around are compared, and by nothing where they fall on pixels.
    _, amplitude, _ = spectrum("binary-pulse-width", period)
    off_rad = 2 * np.pi / period * (0.0 if period < 40 else 0.5 if period % 2 else 2.5)
    for order in gone:
        assert amplitude[order] <= 3 * 4 / np.pi * off_rad + 1e-9
    assert set(np.unique(profiles.profile("binary-pulse-width", np.linspace(0, 7, 999), float(period)))) == {0.0, 1.0}


def test_continuous_edges_solve_the_equations_of_harmonic_elimination():
    for count, edges in enumerate(profiles._NOTCHES, start=1):
        for order in (3, 5, 7)[:count]:
            assert 1 + 2 * sum((-1) ** (i + 1) * np.cos(order * e) for i, e in enumerate(edges)) == pytest.approx(0)
        assert list(edges) == sorted(edges) and edges[-1] < np.pi / 2


@pytest.mark.parametrize("style", ["sawtooth", "triangular", "trapezoidal"])
def test_sloped_shapes_are_averaged_over_a_pixel(style):
    period = 12.5
    phase = np.linspace(-9, 9, 41)
    within = (np.arange(2000) + 0.5) / 2000 - 0.5
    turns = np.mod((phase[:, None] + 2 * np.pi * within / period) / (2 * np.pi), 1)
    if style == "sawtooth":
        ideal = np.mod(turns - 0.25, 1)
    elif style == "triangular":
        ideal = np.abs(1 - 2 * turns)
    else:
        ideal = np.clip(2 - 6 * np.minimum(turns, 1 - turns), 0, 1)
    assert np.abs(profiles.profile(style, phase, period) - ideal.mean(axis=1)).max() < 1e-3
