"""Moment and spherical-harmonics invariants: unchanged by motion, and different on a plane, an edge and a corner."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre, sph_harm_y

from fringed_plugins.registration.features.invariants import (
    Around,
    Invariants,
    _harmonics,
    harmonic_invariants,
    moment_invariants,
)

BOTH = pytest.mark.parametrize("invariants", [moment_invariants, harmonic_invariants])


def blob(n=400, seed=0):
    return np.random.default_rng(seed).normal(size=(n, 3)) * [3.0, 2.0, 1.0]


def walls(kind, n=4000, seed=0):
    """Points on one, two or three squares that meet at right angles, first the one where all meet."""
    rng = np.random.default_rng(seed)
    count = {"plane": 1, "edge": 2, "corner": 3}[kind]
    low = -1 if kind == "plane" else 0
    sides = []
    for k in range(count):
        u, v = rng.uniform(low, 1, n), rng.uniform(0 if kind == "corner" else -1, 1, n)
        first, second = [(0, 1), (2, 1), (0, 2)][k]
        side = np.zeros((n, 3))
        side[:, first], side[:, second] = u, v
        sides.append(side)
    return np.vstack([np.zeros((1, 3)), *sides])


def at_first(found: Invariants):
    assert found.valid[0]
    return found.values[0]


@BOTH
def test_no_motion_changes_them_and_no_unit(invariants):
    points = blob()
    found = invariants(points, 2.0)
    assert found.valid.sum() > 300 and np.isnan(found.values[~found.valid]).all()
    rng = np.random.default_rng(1)
    for scale in (1.0, 1e-3, 1e3):
        R, t = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-50, 50, 3)
        moved = invariants(scale * (points @ R.T + t), 2.0 * scale)
        assert (moved.neighbours == found.neighbours).all()
        # coordinates of 50 are exact to 7e-15, which the radius of 2 makes 4e-15; a mean of tens of such terms
        assert np.abs(moved.values - found.values)[found.valid].max() < 1e-12


def test_a_mirror_image_is_not_told_apart():
    points = blob()
    for invariants in (moment_invariants, harmonic_invariants):
        there, mirrored = invariants(points, 2.0), invariants(points * [-1, 1, 1], 2.0)
        assert np.nanmax(np.abs(there.values - mirrored.values)) < 1e-12


@BOTH
def test_plane_edge_and_corner_are_told_apart_beyond_their_sampling(invariants):
    first = Around(chosen=np.arange(12_001) == 0)
    kinds = {}
    for kind in ("plane", "edge", "corner"):
        draws = []
        for seed in range(8):
            points = walls(kind, seed=seed)
            around = Around(chosen=first.chosen[: len(points)])
            draws.append(at_first(invariants(points, 0.9, around=around)))
        kinds[kind] = np.mean(draws, axis=0), np.std(draws, axis=0)
    for one, other in (("plane", "edge"), ("edge", "corner"), ("plane", "corner")):
        apart = np.abs(kinds[one][0] - kinds[other][0])
        assert (apart / np.hypot(kinds[one][1], kinds[other][1])).max() > 15


def test_moments_of_an_even_disc_and_of_an_edge_are_those_of_the_formula():
    """Of about 2500 points in a disc of radius 1: variance of x is 1/4, of its estimate 1 / sqrt(n) of that."""
    chosen = np.arange(4001) == 0
    found = at_first(moment_invariants(walls("plane"), 1.0, Around(chosen=chosen)))
    assert found == pytest.approx([1 / 2, 1 / 16, 0], rel=0.08, abs=1e-15)
    # two half discs: means of x and z are 2 / (3 pi) each, second moments 1/8, 1/4, 1/8
    m = 2 / (3 * np.pi)
    covariance = np.array([[1 / 8 - m**2, 0, -(m**2)], [0, 1 / 4, 0], [-(m**2), 0, 1 / 8 - m**2]])
    least, middle, most = np.linalg.eigvalsh(covariance)
    truth = [least + middle + most, least * middle + middle * most + least * most, least * middle * most]
    found = at_first(moment_invariants(walls("edge"), 1.0, Around(chosen=np.arange(8001) == 0)))
    assert found == pytest.approx(truth, rel=0.08)


def test_moments_are_those_of_the_covariance_of_the_neighbours():
    points = blob()
    near = points[np.linalg.norm(points - points[7], axis=1) <= 2.0]
    least, middle, most = np.linalg.eigvalsh(np.cov(near.T, bias=True)) / 4
    truth = [least + middle + most, least * middle + middle * most + least * most, least * middle * most]
    found = moment_invariants(points, 2.0)
    assert found.values[7] == pytest.approx(truth, rel=1e-12)
    assert found.neighbours[7] == len(near)


def test_harmonics_are_those_of_scipy():
    offset = np.vstack([blob(50), [[0, 0, 2.0], [0, 0, -3.0], [0, 0, 0]]])
    made = _harmonics(offset, 5)
    length = np.linalg.norm(offset, axis=1)
    polar, azimuth = np.arctan2(np.hypot(*offset.T[:2]), offset[:, 2]), np.arctan2(offset[:, 1], offset[:, 0])
    at = 1
    for degree in range(1, 6):
        for order in range(degree + 1):
            truth = np.sqrt(4 * np.pi / (2 * degree + 1)) * sph_harm_y(degree, order, polar, azimuth) * length
            assert made[:, at] + 1j * made[:, at + 1] == pytest.approx(truth, abs=1e-13)
            at += 2
    assert at == made.shape[1]


def test_energies_are_the_mean_of_legendre_polynomials_between_directions():
    points = blob()
    found = harmonic_invariants(points, 2.0, degree=6)
    offset = points[np.linalg.norm(points - points[7], axis=1) <= 2.0] - points[7]
    length = np.linalg.norm(offset, axis=1)
    unit = offset[length > 0] / length[length > 0, None]
    share = np.outer(length, length)[np.ix_(length > 0, length > 0)] / length.sum() ** 2
    truth = [(share * eval_legendre(degree, unit @ unit.T)).sum() for degree in range(1, 7)]
    assert found.values[7] == pytest.approx(truth, rel=1e-10, abs=1e-13)


@BOTH
def test_stated_noise_is_how_other_samples_of_the_surface_differ(invariants):
    """Halves stand for two samples; squares of what is nothing but noise fall by 4, not by 2, with twice the points."""
    values, stated = [], []
    for seed in range(30):
        points = np.random.default_rng(seed).uniform(-3, 3, (1500, 3)) * [1, 1, 0]
        points[:, 2] = 0.15 * points[:, 0] ** 2 - 0.1 * points[:, 1] ** 2
        points[:25] = np.stack([*np.meshgrid(*(np.linspace(-1, 1, 5),) * 2), np.zeros((5, 5))], axis=2).reshape(-1, 3)
        points[:25, 2] = 0.15 * points[:25, 0] ** 2 - 0.1 * points[:25, 1] ** 2
        found = invariants(points, 0.9, around=Around(chosen=np.hypot(points[:, 0], points[:, 1]) < 1.5))
        values.append(found.values[:25])
        stated.append(found.sigma)
    scatter = np.median(np.std(values, axis=0), axis=0)
    ratio = np.mean(stated, axis=0) / scatter
    assert (ratio > 0.8).all() and (ratio < 1.2 * np.sqrt(2)).all()


@BOTH
def test_weights_make_up_for_density(invariants):
    """Half of a plane sampled four times as densely: with a quarter of the weight the plane is even again."""
    rng = np.random.default_rng(5)
    points = np.zeros((50_001, 3))
    points[1:, :2] = rng.uniform(-1, 1, (50_000, 2))
    points[10_001:, 0] = np.abs(points[10_001:, 0])
    dense = points[:, 0] > 0
    # right: 5,000 of the first 10,000 and 40,000 more
    weights = np.where(dense, 1 / 9, 1.0)
    chosen = np.arange(len(points)) == 0
    even = points[:10_001]
    truth = at_first(invariants(even, 0.9, around=Around(chosen=chosen[:10_001])))
    plain = at_first(invariants(points, 0.9, around=Around(chosen=chosen)))
    weighed = at_first(invariants(points, 0.9, around=Around(chosen=chosen, weights=weights)))
    assert np.abs(weighed - truth).max() < 0.3 * np.abs(plain - truth).max()


@BOTH
def test_cut_and_sparse_neighbourhoods_and_rows_that_are_not_finite_are_not_valid(invariants):
    v, u = np.mgrid[0:20.0, 0:20.0]
    points = np.stack([u.ravel(), v.ravel(), 0 * u.ravel()], axis=1)
    rim = ((u % 19 == 0) | (v % 19 == 0)).ravel()
    points = np.vstack([points, [[np.nan, 0, 0], [90.0, 90, 90]]])
    found = invariants(points, 3.0, around=Around(boundary=np.append(rim, [False, False])))
    expected = ((u > 3) & (u < 16) & (v > 3) & (v < 16)).ravel()
    assert (found.valid[:-2] == expected).all() and not found.valid[-2:].any()
    assert found.neighbours[-2:].tolist() == [0, 1]
    assert np.isfinite(found.normalised()[found.valid]).all() and np.isnan(found.normalised()[~found.valid]).all()


@BOTH
def test_chosen_points_have_the_same_values_as_all_have(invariants):
    points = blob()
    chosen = np.arange(400) % 3 == 0
    found, some = invariants(points, 2.0), invariants(points, 2.0, around=Around(chosen=chosen))
    assert not some.valid[~chosen].any() and (some.valid[chosen] == found.valid[chosen]).all()
    assert (some.values[some.valid] == found.values[some.valid]).all()
    nobody = invariants(points, 2.0, around=Around(chosen=np.zeros(400, bool)))
    assert not nobody.valid.any()


def test_a_report_may_cancel():
    def stop(fraction, text):
        if fraction > 0:
            raise InterruptedError(text)

    with pytest.raises(InterruptedError, match="invariants"):
        moment_invariants(blob(3000), 2.0, report=stop)


@pytest.mark.parametrize(
    ("points", "more", "message"),
    [
        (np.zeros((5, 2)), {}, r"\(n, 3\)"),
        (np.full((5, 3), np.nan), {}, "finite"),
        (np.zeros((5, 3)), {"radius": 0.0}, "radius"),
        (np.zeros((5, 3)), {"degree": 13}, "degree"),
        (np.zeros((5, 3)), {"around": Around(weights=np.ones(4))}, "weights"),
        (np.zeros((5, 3)), {"around": Around(weights=-np.ones(5))}, "negative"),
    ],
)
def test_wrong_input_is_refused(points, more, message):
    with pytest.raises(ValueError, match=message):
        harmonic_invariants(points, **({"radius": 1.0} | more))
