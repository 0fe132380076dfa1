"""Quality-guided unwrapping joins the most reliable pairs first, whatever short cuts it takes."""

from __future__ import annotations

import numpy as np
import pytest
from fringe_truth import wrapped
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed_plugins.unwrap import reliability
from fringed_plugins.unwrap.spatial import unwrap


def costs(phase):
    """Return the cost of each pixel, as the module computes it."""
    out, largest = np.empty_like(phase), np.empty(phase.shape[0], np.float32)
    none = (np.empty((0, phase.shape[1]), np.float32), np.float32(1))
    reliability.cost_rows(0, phase.shape[0], phase, none, out, largest)
    return out


def sorted_joins(phase, cost):
    """Return the turns of each pixel over the first of its group, by sorting all pairs and joining one by one."""
    height, width = phase.shape
    pairs = []
    for y in range(height):
        for x in range(width):
            for dy, dx in ((0, 1), (1, 0)):
                if y + dy < height and x + dx < width:
                    price = cost[y, x] + cost[y + dy, x + dx]
                    if np.isfinite(price):
                        pairs.append((price, (y, x), (y + dy, x + dx)))
    group = {(y, x): [(y, x)] for y in range(height) for x in range(width)}
    turns = np.zeros(phase.shape, int)
    for _, p, q in sorted(pairs):
        if group[p] is not group[q]:
            shift = turns[p] + round(float(phase[p] - phase[q]) / (2 * np.pi)) - turns[q]
            for pixel in group[q]:
                turns[pixel] += shift
            group[p].extend(group[q])
            for pixel in group[q]:
                group[pixel] = group[p]
    return turns, group


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([0.1, 0.6, 1.0, 3.0]), holes=st.booleans())
def test_same_turns_as_joining_one_by_one_in_sorted_order(seed, noise, holes):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:14, 0:17]
    phase = wrapped(0.5 * x + 0.05 * y * y + rng.normal(0, noise, x.shape)).astype(np.float32)
    if holes:
        phase[rng.random(phase.shape) < 0.2] = np.nan
    want, group = sorted_joins(phase, costs(phase))
    result = unwrap(phase, threads=1)
    with np.errstate(invalid="ignore"):
        got = np.round((result.phase_rad - phase) / (2 * np.pi))
    for pixels in {id(members): members for members in group.values()}.values():
        where = tuple(np.array(pixels).T)
        shift = got[where] - want[where]
        assert np.isnan(shift).all() or (shift == shift[0]).all()


def plain_cost(phase, y, x):
    """Return the documented cost of an inner pixel: 2 s + D / 2."""

    def gap(p, q):
        return float(wrapped(phase[q] - phase[p]))

    def bend(dy, dx):
        return gap((y - dy, x - dx), (y, x)) - gap((y, x), (y + dy, x + dx))

    rows = [gap((r, c), (r, c + 1)) for r in (y - 1, y, y + 1) for c in (x - 1, x)]
    columns = [gap((r, c), (r + 1, c)) for c in (x - 1, x, x + 1) for r in (y - 1, y)]
    bends = [bend(*step) for step in ((0, 1), (1, 0), (1, 1), (1, -1))]
    return 2 * np.sqrt(np.var(rows) + np.var(columns)) + np.sqrt(np.sum(np.square(bends))) / 2


def test_cost_is_what_the_docstring_says():
    phase = np.random.default_rng(5).uniform(-np.pi, np.pi, (12, 9)).astype(np.float32)
    got = costs(phase)
    want = [[plain_cost(phase.astype(float), y, x) for x in range(1, 8)] for y in range(1, 11)]
    assert got[1:-1, 1:-1] == pytest.approx(np.array(want), abs=2e-5)  # squares of 6 float32 values up to 3.1


def test_cost_is_the_same_in_any_band_of_rows():
    phase = np.random.default_rng(6).uniform(-np.pi, np.pi, (40, 30)).astype(np.float32)
    phase[7:12, 4:9] = np.nan
    whole, parts, largest = costs(phase), np.empty_like(phase), np.empty(40, np.float32)
    none = (np.empty((0, 30), np.float32), np.float32(1))
    for start, stop in ((0, 7), (7, 8), (8, 39), (39, 40)):
        reliability.cost_rows(start, stop, phase, none, parts, largest)
    assert np.array_equal(parts, whole, equal_nan=True)


def test_noise_of_half_a_radian_changes_no_order():
    y, x = np.mgrid[0:300, 0:400]
    truth = 20 * np.exp(-(((x - 200) / 90) ** 2 + ((y - 150) / 70) ** 2)) + x / 10
    for seed in range(5):
        noisy = truth + np.random.default_rng(seed).normal(0, 0.5, truth.shape)
        turns = np.round((unwrap(wrapped(noisy)).phase_rad - noisy) / (2 * np.pi))
        assert (turns == turns[0, 0]).all()


def test_noise_in_an_unlit_part_does_not_spread():
    y, x = np.mgrid[0:200, 0:260]
    truth = 0.1 * x + 8 * np.exp(-((x - 130) ** 2 + (y - 100) ** 2) / 3000)
    shadow = (np.abs(x - 80) < 25) & (np.abs(y - 100) < 70)
    phase = np.where(shadow, np.random.default_rng(1).uniform(-np.pi, np.pi, x.shape), wrapped(truth))
    turns = np.round((unwrap(phase).phase_rad - truth) / (2 * np.pi))[~shadow]
    assert (turns == np.median(turns)).all()


@pytest.mark.parametrize(("dim", "step"), [(slice(5, 10), 0.2), (slice(50, 55), 2 * np.pi + 0.2)])
def test_low_quality_path_is_taken_last(dim, step):
    """Two equally rough bridges contradict each other, one level and one a ramp of a period: the lit one counts."""
    rough = np.random.default_rng(7).normal(0, 0.3, (5, 20))
    phase = np.full((60, 60), np.nan)
    phase[:, :20], phase[:, 40:] = 0.0, 0.2
    phase[5:10, 20:40] = wrapped(np.linspace(0, 2 * np.pi + 0.2, 20) + rough)
    phase[50:55, 20:40] = np.linspace(0, 0.2, 20) + rough
    quality = np.full(phase.shape, 100.0)
    quality[dim, 20:40] = 1.0
    result = unwrap(phase, quality).phase_rad
    assert result[30, 50] - result[30, 10] == pytest.approx(step, abs=1e-5)


@pytest.mark.parametrize("value", [0.0, np.nan, -1.0, np.inf])
def test_useless_quality_is_as_none(value):
    phase = wrapped(np.random.default_rng(2).normal(0, 1.0, (30, 40)) + np.arange(40) / 5)
    want = unwrap(phase).phase_rad
    assert np.array_equal(unwrap(phase, np.full(phase.shape, value)).phase_rad, want)


def test_quality_of_any_type_is_taken():
    phase = wrapped(np.random.default_rng(2).normal(0, 1.0, (30, 40)) + np.arange(40) / 5)
    quality = np.random.default_rng(3).integers(1, 200, phase.shape)
    want = unwrap(phase, quality.astype(np.float32)).phase_rad
    for same in (quality.astype(np.uint8), quality.astype(np.float64), np.asfortranarray(quality)):
        assert np.array_equal(unwrap(phase, same).phase_rad, want)
