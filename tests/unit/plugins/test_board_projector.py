"""The projector's coordinate at a point: from a noisy map with ink, holes and wrong fringe orders."""

from __future__ import annotations

import numpy as np
import pytest

from fringed_plugins.calibration.detect.projector_points import projector_at, wrong_orders

SHAPE, RADIUS, PERIOD = (240, 320), 20.0, 16.0
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
GX, GY = np.meshgrid(np.arange(35.0, 300, 40), np.arange(35.0, 220, 40))
POINTS = np.stack([GX.ravel(), GY.ravel()], -1) + np.random.default_rng(1).uniform(-0.5, 0.5, (GX.size, 2))
AWAY = np.min([np.hypot(X - x, Y - y) for x, y in POINTS], axis=0)
SIGMA = np.where(AWAY < 9, 0.5, 0.08)  # ink reflects less
KEPT = np.zeros(SHAPE, np.uint16)


def coordinate(x, y):
    return 300 + 0.7 * x + 0.08 * y + 3e-4 * (x - 160) ** 2 - 1e-4 * (x - 160) * (y - 120)


def noisy(seed, sigma=SIGMA):
    return coordinate(X, Y) + sigma * np.random.default_rng(seed).normal(size=SHAPE)


def fitted(value, sigma=SIGMA, rejected=KEPT):
    got = projector_at(POINTS, np.full(len(POINTS), RADIUS), (value, sigma, rejected), threads=1)
    return got, got.value - coordinate(*POINTS.T)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_value_is_true_and_its_deviation_that_of_the_scatter(kind):
    ratios, off = [], []
    for seed in range(8):
        got, error = fitted(noisy(seed).astype(kind), SIGMA.astype(kind))
        ratios.append(np.mean((error / got.sigma) ** 2))
        off.append(error)
    assert np.sqrt(np.mean(np.square(off))) < 0.01
    # 280 squared normal values: 1 within 0.085 of a deviation.
    assert 0.75 < np.mean(ratios) < 1.3


def test_slope_is_that_of_the_surface():
    got, _ = fitted(noisy(3))
    x, y = POINTS.T
    true = np.stack([0.7 + 6e-4 * (x - 160) - 1e-4 * (y - 120), 0.08 - 1e-4 * (x - 160)], -1)
    assert np.abs(got.gradient - true).max() < 0.01


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_scattered_wrong_orders_move_nothing(share):
    rng = np.random.default_rng(7)
    wrong = rng.random(SHAPE) < share
    got, error = fitted(noisy(1) + PERIOD * wrong * rng.choice([-1, 1], SHAPE))
    assert np.isfinite(got.value).all()
    assert np.sqrt(np.mean(error**2)) < 0.012


def test_half_of_the_orders_wrong_is_no_value_or_a_true_one():
    _, error = fitted(noisy(1) + PERIOD * (np.random.default_rng(7).random(SHAPE) < 0.45))
    assert not np.nanmax(np.abs(error), initial=0.0) > 0.1


def test_window_across_a_border_of_orders_is_left_out_and_a_whole_window_off_is_known_by_its_neighbours():
    value = noisy(2)
    across, whole = np.arange(0, len(POINTS), 6), np.arange(2, len(POINTS), 9)
    for x, y in POINTS[across]:
        value[(np.hypot(X - x, Y - y) <= RADIUS + 1) & (x + 8 < X)] += PERIOD
    for x, y in POINTS[whole]:
        value[np.hypot(X - x, Y - y) <= RADIUS + 1] -= PERIOD
    got, error = fitted(value)
    flagged = ~np.isfinite(got.value) | wrong_orders(POINTS, got.value, coordinate(POINTS[:, 1], POINTS[:, 0]))
    assert flagged[across].all()
    assert flagged[whole].all()
    assert flagged.sum() == len(set(across) | set(whole))
    assert np.abs(error[~flagged]).max() < 0.03


def test_ink_that_is_rejected_costs_only_precision():
    rejected = np.where(AWAY < 9, 2, 0).astype(np.uint16)
    got, error = fitted(np.where(rejected > 0, np.nan, noisy(4)), SIGMA, rejected)
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert np.isfinite(got.value).all()


def test_phase_that_the_ink_pulls_at_its_edge_moves_no_centre():
    # Blur mixes the brighter ground's phase into the ink: away from the centre on all sides alike.
    value = noisy(5)
    for x, y in POINTS:
        away = np.maximum(np.hypot(X - x, Y - y), 1e-9)
        value += np.where(away < 16, 0.3 * np.exp(-((away - 9) ** 2) / 2) * (X - x) / away, 0)
    got, error = fitted(value)
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert np.mean((error / got.sigma) ** 2) < 1.5


def test_too_few_pixels_are_no_value():
    rejected = np.where(AWAY < 4, 0, 1).astype(np.uint16)
    got, _ = fitted(noisy(1), SIGMA, rejected)
    assert not np.isfinite(got.value).any()
    assert not np.isfinite(got.sigma).any()
    for value in (np.full(SHAPE, np.nan), np.full(SHAPE, np.inf)):
        assert not np.isfinite(fitted(value)[0].value).any()


def test_few_or_no_points_are_judged_by_nobody():
    assert wrong_orders(np.zeros((0, 2)), np.zeros(0), np.zeros(0)).shape == (0,)
    assert not wrong_orders(POINTS[:5], np.array([0.0, 16, 0, 16, 0]), np.zeros(5)).any()
