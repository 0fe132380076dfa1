"""Exposures for scenes whose light is known."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed_plugins.phase.exposure import exposures as ex
from fringed_plugins.phase.exposure.exposures import Brightness, SensorModel, Wanted, brightness, suggest_exposures

SENSOR = SensorModel(2.0, 255.0, 0.14, 1 / 51)


def frames(peak_per_us, exposure_us, steps=4, seed=0, ambient=0.05):
    """Frames of a scene whose brightest value is `peak_per_us` (h, w), with shot and read noise, 8 bits."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0, 60, peak_per_us.size).reshape(peak_per_us.shape)
    share = [ambient + (1 - ambient) * (0.5 + 0.5 * np.cos(phase + 2 * np.pi * k / steps)) for k in range(steps)]
    values = np.array([2 + peak_per_us * exposure_us * one for one in share])
    values = values + np.sqrt(0.06 + values / 51) * rng.standard_normal(values.shape)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def test_brightness_is_measured_from_the_longest_exposure_that_does_not_saturate():
    truth = np.geomspace(0.002, 0.24, 40 * 50).reshape(40, 50)
    taken = (1000.0, 8000.0, 64000.0)
    light = brightness([frames(truth, e, seed=i) for i, e in enumerate(taken)], taken, SENSOR)
    assert light.lit == 1.0 and light.dark == light.blinded == 0.0
    # A modulation of 5 sigma or more is right within 20 % at worst, and far better at the median.
    ratio = light.peak_per_us / truth.ravel()
    assert np.median(np.abs(ratio - 1)) < 0.02 and np.abs(ratio - 1).max() < 0.25
    assert light.modulation_per_us / light.peak_per_us == pytest.approx(0.475, rel=0.25)


def test_dark_lit_and_blinded_pixels_are_told_apart():
    truth = np.concatenate([np.zeros(100), np.full(200, 0.02), np.full(100, 3.0)]).reshape(20, 20)
    light = brightness([frames(truth, 1000.0), frames(truth, 8000.0)], (1000.0, 8000.0), SENSOR)
    assert (light.dark, light.lit, light.blinded) == (0.25, 0.5, 0.25)
    assert light.hidden_per_us == pytest.approx(0.253)


def lit(peaks, contrast=0.475):
    peaks = np.asarray(peaks, float)
    return Brightness(peaks, contrast * peaks, 1.0, 0.0, 0.0, 10.0)


def test_one_exposure_is_enough_for_even_light_and_fills_the_range():
    suggestion = suggest_exposures(lit(np.full(500, 0.02)), SENSOR)
    (exposure,) = suggestion.exposures_us
    assert 0.85 * 255 < 2 + 0.02 * exposure <= 0.92 * 255
    assert suggestion.served == 1.0 and suggestion.reason.startswith("one exposure is enough")


@pytest.mark.parametrize("span", [3, 30, 300, 3000])
def test_every_pixel_reaches_the_snr_unsaturated_with_the_fewest_exposures(span):
    peaks = np.geomspace(0.002, 0.002 * span, 800)
    wanted = Wanted(snr=20.0, share=0.999, dimmest=0.0, most=6)
    suggestion = suggest_exposures(lit(peaks), SENSOR, wanted)
    reached = np.zeros(len(peaks), bool)
    for exposure in suggestion.exposures_us:
        value = 2 + 0.525 * peaks * exposure
        snr = 0.475 * peaks * exposure / np.sqrt(0.14 + value / 51)
        reached |= (2 + peaks * exposure <= 0.92 * 255 * 1.001) & (snr >= 20 * 0.995)
    assert reached.mean() == pytest.approx(suggestion.served, abs=0.003)
    # One exposure serves a range of r = longest / shortest window; a span needs log(span) / log(r) of them.
    low, high = ex._windows(lit(peaks), SENSOR, wanted)
    fewest = int(np.ceil(np.log(span) / np.log(np.median(high / low)) - 0.05))
    assert suggestion.served > 0.99
    assert fewest <= len(suggestion.exposures_us) <= fewest + 1


def test_range_that_is_too_wide_says_what_is_lost():
    suggestion = suggest_exposures(lit(np.geomspace(1e-5, 10, 2000)), SENSOR, Wanted(dimmest=0.0, most=2))
    assert len(suggestion.exposures_us) == 2
    assert suggestion.reason.startswith("2 exposures do not cover the range")
    assert 0.3 < suggestion.served < 0.8
    assert suggestion.served + suggestion.too_bright + suggestion.too_dark == pytest.approx(1.0)


def test_backdrop_is_not_asked_for():
    peaks = np.concatenate([np.full(900, 0.02), np.full(100, 0.02 / 300)])
    suggestion = suggest_exposures(lit(peaks), SENSOR)
    assert len(suggestion.exposures_us) == 1 and suggestion.dimmer == pytest.approx(0.1)
    assert "10.0% are dimmer" in suggestion.reason
    assert len(suggest_exposures(lit(peaks), SENSOR, Wanted(dimmest=0.0)).exposures_us) == 2


def test_nothing_to_see_is_an_error_that_says_why():
    none = np.zeros(0)
    with pytest.raises(ValueError, match="shorten the exposure"):
        suggest_exposures(Brightness(none, none, 0.0, 0.1, 0.9, 1.0), SENSOR)
    with pytest.raises(ValueError, match="projector on"):
        suggest_exposures(Brightness(none, none, 0.0, 0.9, 0.1, 1.0), SENSOR)


def test_saturated_pixels_are_mentioned_because_their_light_is_unknown():
    light = lit(np.full(100, 0.02))
    suggestion = suggest_exposures(Brightness(light.peak_per_us, light.modulation_per_us, 0.8, 0.1, 0.1, 1.0), SENSOR)
    assert "10.0% of all pixels were saturated" in suggestion.reason


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), min_size=1, max_size=12), st.integers(1, 3))
def test_choice_is_the_best_of_all(intervals, points):
    counts = np.zeros((8, 8))
    kept = [(min(pair), max(pair)) for pair in intervals]
    for low, high in kept:
        counts[low, high] += 1
    chosen, served = ex._best(counts, points)
    hit = lambda places: sum(any(low <= x <= high for x in places) for low, high in kept)  # noqa: E731
    assert (
        hit(chosen) == served == max(hit(places) for n in range(1, points + 1) for places in combinations(range(8), n))
    )


@pytest.mark.parametrize(
    ("stacks", "exposures"),
    [([], []), ([np.zeros((2, 4, 4))], [1.0]), ([np.zeros((3, 4, 4))], [0.0]), ([np.zeros((3, 4, 4))], [1.0, 2.0])],
)
def test_frames_that_cannot_tell_are_refused(stacks, exposures):
    with pytest.raises(ValueError, match="stacks"):
        brightness(stacks, exposures, SENSOR)
