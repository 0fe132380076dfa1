"""What becomes of a pattern on its way to a surface."""

import numpy as np
import pytest

from fringed.config import SimulationConfig
from fringed.simulation.light import LINE_SAMPLES, blend, channel_mix, light_of, widened

GREEN = np.array([0.0, 1.0, 0.0])
LINEAR = np.arange(256) / 255.0
SIGMAS = np.array([0.65, 1.5, 3.0])
STILL = (0.0, 0.0)


def fringes(period=16.0, axis=1, shift=0.0):
    u = np.arange(1024 if axis == 1 else 768)
    values = np.rint(127.5 + 127.5 * np.cos(2 * np.pi * u / period + shift)).astype(np.uint8)
    return values[None, :, None] if axis == 1 else values[:, None, None]


@pytest.mark.parametrize("axis", [0, 1])
def test_blur_and_aperture_take_the_amplitude_that_theory_says_and_no_phase(axis):
    light = light_of(fringes(axis=axis), GREEN, LINEAR, (SIGMAS, STILL))
    table = light.columns if axis == 1 else light.rows
    assert (light.rows if axis == 1 else light.columns).size == 0
    position = np.arange(table.shape[1]) / LINE_SAMPLES - 0.5
    middle = (position >= 320) & (position < 320 + 16 * 20)
    for level, sigma in enumerate(SIGMAS):
        wave = (table[level, middle] * np.exp(-2j * np.pi * position[middle] / 16)).mean() * 2
        k = 2 * np.pi / 16
        expected = 0.5 * np.exp(-((k * sigma) ** 2) / 2) * np.sinc(1 / 16)
        assert abs(wave) == pytest.approx(expected, rel=2e-3)
        assert np.angle(wave) == pytest.approx(0, abs=2e-3)  # grey levels are rounded


def test_light_is_dark_beyond_the_panel():
    white = widened(np.full((1, 1, 1), 255, np.uint8), 1024)
    table = light_of(white, GREEN, LINEAR, (SIGMAS, STILL)).columns[0]
    assert table[0] == pytest.approx(0.5, abs=1e-6)  # the panel's edge
    assert table[LINE_SAMPLES * 512] == pytest.approx(1.0, abs=1e-6)


def test_a_whole_picture_gives_the_light_of_the_line_that_it_repeats():
    line = fringes()[:, :128]
    picture = np.repeat(line, 96, axis=0)
    table = light_of(line, GREEN, LINEAR, (SIGMAS, STILL)).columns
    stack = light_of(picture, GREEN, LINEAR, (SIGMAS, STILL)).picture
    # sample j of the picture is at pixel (j + 0.5) / 2 - 0.5; of the line at 8 (u + 0.5) = 4 j + 2
    expected = table[:, 2 : 128 * LINE_SAMPLES : 4]
    assert np.abs(stack[:, 96, 40:-40] - expected[:, 40:-40]).max() < 3e-3


def test_the_tone_curve_acts_on_grey_levels_before_the_blur():
    squared = LINEAR**2
    pattern = np.full((1, 64, 1), 128, np.uint8)
    table = light_of(pattern, GREEN, squared, (SIGMAS, STILL)).columns
    assert table[0, LINE_SAMPLES * 32] == pytest.approx((128 / 255) ** 2, abs=1e-6)


def test_a_colour_reaches_the_other_channels_by_crosstalk():
    crosstalk = SimulationConfig().sensor.crosstalk
    red = np.zeros((1, 64, 3), np.uint8)
    red[..., 0] = 255
    for channel, share in (("red", 0.90), ("green", 0.07), ("blue", 0.01)):
        table = light_of(red, channel_mix(crosstalk, channel), LINEAR, (SIGMAS, STILL)).columns
        assert table[0, LINE_SAMPLES * 32] == pytest.approx(share, abs=1e-6)
    assert channel_mix(crosstalk, "white").sum() == pytest.approx(1.0)


def test_misconvergence_moves_red_and_blue_but_not_green():
    phases = {}
    for c, name in enumerate(("red", "green", "blue")):
        mix = np.eye(3)[c]
        table = light_of(fringes(), mix, LINEAR, (SIGMAS, (0.5, -0.25))).columns[0]
        position = np.arange(len(table)) / LINE_SAMPLES - 0.5
        middle = (position >= 320) & (position < 320 + 16 * 20)
        phases[name] = -np.angle((table[middle] * np.exp(-2j * np.pi * position[middle] / 16)).mean()) * 16 / 2 / np.pi
    assert phases["red"] == pytest.approx(0.5, abs=0.01)
    assert phases["green"] == pytest.approx(0.0, abs=0.01)
    assert phases["blue"] == pytest.approx(-0.25, abs=0.01)


def test_lights_of_different_orientation_blend():
    columns = light_of(fringes(axis=1), GREEN, LINEAR, (SIGMAS, STILL))
    rows = light_of(fringes(axis=0), GREEN, LINEAR, (SIGMAS, STILL))
    mixed = blend([(0.25, columns), (0.75, rows)])
    np.testing.assert_allclose(mixed.columns, 0.25 * columns.columns, rtol=1e-6)
    np.testing.assert_allclose(mixed.rows, 0.75 * rows.rows, rtol=1e-6)
    assert mixed.picture.size == 0
    assert blend([(1.0, columns)]) is columns
