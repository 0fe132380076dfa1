"""Designs of frequencies: their promises hold in simulation, and no other set of small numbers is better."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest

from fringed_plugins.phase.projection import frequency_errors as errors
from fringed_plugins.phase.projection.frequencies import design_heterodyne, design_hierarchical, design_number_theoretic

DESIGNS = (design_hierarchical, design_heterodyne, design_number_theoretic)


def wrapped_phases(periods, steps, snr, count=200_000, seed=1):
    """Return columns (0 to 1) and noisy wrapped phases in turns, as N frames of that noise give them."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.05, 0.95, count)  # away from the borders, where the first period wraps
    sigma = np.sqrt(2 / np.asarray(steps, float)) / snr / (2 * np.pi)
    noisy = [n * x + s * rng.standard_normal(count) for n, s in zip(periods, sigma, strict=True)]
    return x, [turns - np.rint(turns) for turns in noisy]


@pytest.mark.parametrize(("periods", "steps", "snr"), [([1, 5], [3, 4], 3.5), ([1, 4, 24], [5, 3, 6], 3.5)])
def test_hierarchical_failures_are_as_frequent_as_promised(periods, steps, snr):
    x, phases = wrapped_phases(periods, steps, snr)
    turns = phases[0] + np.rint(x * periods[0] - phases[0])
    wrong = np.zeros(x.size, bool)
    for (coarse, fine), phase in zip(pairwise(periods), phases[1:], strict=True):
        order = np.rint(turns * fine / coarse - phase)
        wrong |= order != np.rint(x * fine - phase)  # noise of the phase itself is no wrong order
        turns = phase + np.rint(x * fine - phase)
    expected = errors.hierarchical_failure(periods, steps, snr)
    assert 1e-3 < expected < 0.1
    assert wrong.mean() <= expected + 5 * np.sqrt(expected / x.size)
    assert wrong.mean() >= 0.9 * expected  # the sum over levels counts twice what fails twice


@pytest.mark.parametrize(("periods", "steps", "snr"), [([7, 8], [4, 4], 6.0), ([25, 29, 30], [3, 3, 4], 6.0)])
def test_heterodyne_failures_are_as_frequent_as_promised(periods, steps, snr):
    x, phases = wrapped_phases(periods, steps, snr)
    finest = periods[-1]
    beats = sorted((finest - n, phases[-1] - phase) for n, phase in zip(periods[:-1], phases[:-1], strict=True))
    beats.append((finest, phases[-1]))
    assert beats[0][0] == 1
    turns, wrong = beats[0][1], np.zeros(x.size, bool)
    turns = turns + np.rint(x - turns)
    for (coarse, _), (fine, phase) in pairwise(beats):
        wrong |= np.rint(turns * fine / coarse - phase) != np.rint(x * fine - phase)
        turns = phase + np.rint(x * fine - phase)
    expected = errors.heterodyne_failure(periods, steps, snr)
    assert 1e-4 < expected < 0.1
    assert 0.85 * expected - 5e-4 <= wrong.mean() <= expected + 5 * np.sqrt(expected / x.size)


@pytest.mark.parametrize(
    ("periods", "steps", "snr"), [([7, 8], [4, 4], 5.0), ([1, 8], [3, 3], 4.0), ([11, 13, 16], [3, 4, 4], 3.5)]
)
def test_number_theoretic_failures_are_as_frequent_as_promised(periods, steps, snr):
    count = 10_000
    x, phases = wrapped_phases(periods, steps, snr, count)
    weight = 1 / (2 / np.asarray(steps, float))
    grid = (np.arange(1500) + 0.5) / 1500  # the most likely column, by looking at all of them
    misfit = np.zeros((count, grid.size), np.float32)
    for n, w, phase in zip(periods, weight, phases, strict=True):
        off = (phase[:, None] - n * grid[None, :]).astype(np.float32)
        misfit += np.float32(w) * (off - np.rint(off)) ** 2
    found = grid[misfit.argmin(axis=1)]
    wrong = np.abs(found - x) > 0.5 / periods[-1]
    expected = errors.number_theoretic_failure(periods, steps, snr)
    assert 1e-3 < expected < 0.2
    # Only the nearest column of each turn is counted, and turns that fail together are counted twice.
    assert 0.6 * expected <= wrong.mean() <= 1.3 * expected + 5 * np.sqrt(expected / count)


def test_deviation_of_the_combined_column_is_that_of_weighted_least_squares():
    periods, steps, snr, length = [49, 57, 64], [3, 4, 5], 10.0, 1024
    x, phases = wrapped_phases(periods, steps, snr)
    turns = [phase + np.rint(x * n - phase) for n, phase in zip(periods, phases, strict=True)]
    weight = np.asarray(periods, float) ** 2 * np.asarray(steps, float)
    column = sum(w * t / n for w, t, n in zip(weight, turns, periods, strict=True)) / weight.sum()
    both = (errors.combined_position_noise, column), (errors.position_noise, turns[-1] / periods[-1])
    for formula, found in both:
        assert length * np.std(found - x) == pytest.approx(formula(length, periods, steps, snr), rel=0.01)


def compositions(total, parts, least=3):
    if parts == 1:
        yield (total,)
        return
    for first in range(least, total - least * (parts - 1) + 1):
        for rest in compositions(total - first, parts - 1, least):
            yield (first, *rest)


@pytest.mark.parametrize(("frames", "snr"), [(9, 5.0), (12, 3.0), (12, 8.0)])
def test_no_hierarchical_set_is_better(frames, snr):
    most = 24
    best = design_hierarchical(most * 12.0, frames, snr)
    assert best.frames == frames
    for count in range(1, frames // 3 + 1):
        for steps in compositions(frames, count):
            for periods in combinations(range(2, most + 1), count - 1):
                if errors.position_noise(288.0, (1, *periods), steps, snr) < best.sigma_px * (1 - 1e-9):
                    assert errors.hierarchical_failure((1, *periods), steps, snr) > 1e-6


@pytest.mark.parametrize(("frames", "snr"), [(6, 12.0), (9, 6.0), (10, 20.0)])
def test_no_number_theoretic_set_is_better(frames, snr):
    most = 20
    best = design_number_theoretic(most * 12.0, frames, snr)
    for count in (2, 3):
        each, more = divmod(frames, count)
        steps = (*[each] * (count - more), *[each + 1] * more)
        for periods in combinations(range(1, most + 1), count) if each >= 3 else ():
            if errors.combined_position_noise(240.0, periods, steps, snr) < best.combined_sigma_px * (1 - 1e-9):
                assert errors.number_theoretic_failure(periods, steps, snr) > 1e-6


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("length", [768, 1024, 1920])
@pytest.mark.parametrize(("frames", "snr"), [(9, 20.0), (12, 10.0), (16, 5.0), (24, 60.0)])
def test_designs_keep_what_they_are_asked(design, length, frames, snr):
    best = design(length, frames, snr, min_period_px=14.0)
    assert best.frames == frames
    assert min(best.steps) >= 3
    assert list(best.periods) == sorted(set(best.periods))
    assert length / best.periods[-1] >= 14.0
    assert best.failure <= 1e-6
    better = design(length, frames + 3, snr, min_period_px=14.0)
    assert better.combined_sigma_px < best.combined_sigma_px * 1.001  # three frames more are never worse


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize(
    ("numbers", "reason"),
    [
        ((1024, 2, 20.0), "are needed"),
        ((1024, 12, 0.0), "above 0"),
        ((1024, 12, float("nan")), "above 0"),
        ((1024, 12, 20.0, 800.0), "allow shorter"),
        ((1024, 12, 20.0, 12.0, 0.7), "below 0.5"),
    ],
)
def test_numbers_without_a_design_are_refused(design, numbers, reason):
    with pytest.raises(ValueError, match=reason):
        design(*numbers)


@pytest.mark.parametrize("design", DESIGNS[1:])
def test_too_much_noise_is_refused_with_a_way_out(design):
    with pytest.raises(ValueError, match="take more frames, more light, or the hierarchical method"):
        design(1024, 6, 2.0)


def test_sets_with_a_common_divisor_are_no_sets():
    assert errors.number_theoretic_failure([32, 64], [8, 8], 100.0) > 0.4
    assert errors.number_theoretic_failure([33, 64], [8, 8], 100.0) < 1e-6
