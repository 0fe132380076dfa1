"""Curvatures on the grid against formulas, and their stated noise against repetition."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_shapes import SHAPES, seen, sphere
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.features.grid import curvatures, in_units_of_noise, ray_noise, window

LEAST_COSINE = 0.7


def both(found):
    return np.stack([found.k1, found.k2], axis=-1)


def facing(points, normals):
    rays = points / np.linalg.norm(points, axis=2, keepdims=True)
    return -(rays * normals).sum(2)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("turn", [(0, 0, 0), (35, 20, 10), (50, -40, 70)])
@pytest.mark.parametrize("name", SHAPES)
def test_curvatures_are_those_of_the_formula_in_perspective_and_tilted(name, turn, dtype):
    points, valid, truth = seen(SHAPES[name], turn)
    found = curvatures(points.astype(dtype), valid, 7, sigma=0.0)
    cosine = facing(points, found.normals)
    steady = found.valid & (cosine > LEAST_COSINE)
    assert steady.sum() > 300
    # of the fourth derivative, 3 k^3 / cos^7 of a circle, the window of 7 leaves 0.8 p^2; p = 0.5. Rounding to float32
    # at 550 is noise of 6e-5 / sqrt(12), of which sqrt(4 / 588) / p^2 is left: 6e-6, of 10,000 the worst 4.5 times that
    strongest = np.abs(truth[valid]).max()
    rounding = 2.7e-5 if dtype == np.float32 else 0.0
    limit = 2.4 * 0.25 * strongest**3 / LEAST_COSINE**7 + rounding
    assert np.abs(both(found) - truth)[steady].max() < limit
    assert (cosine[found.valid] > 0).all()  # towards the camera


def test_error_falls_with_the_square_of_the_pitch():
    worst = []
    for n, pitch in ((101, 0.5), (201, 0.25)):
        points, valid, truth = seen(sphere(), n=n, pitch=pitch)
        found = curvatures(points, valid, 7, sigma=0.0)
        worst.append(np.abs(both(found) - truth)[found.valid].mean())
    assert worst[0] / worst[1] == pytest.approx(4.0, rel=0.1)


def test_mean_curvature_is_exact_on_quadratics_and_no_turn_changes_it():
    """On a sheared grid with x_uv in every component, in units of a thousandth and of a thousand."""
    v, u = np.mgrid[-10:11.0, -10:11.0]
    points = np.dstack([u + 0.3 * v, 0.8 * v - 0.1 * u, 40 + 0.02 * u**2 - 0.03 * u * v + 0.01 * v**2])
    valid = np.ones(u.shape, bool)
    found = curvatures(points, valid, 5, sigma=0.1)
    R = Rotation.random(random_state=3).as_matrix()
    # of the window of 5 a quadratic is exact: only rounding of 1e-14 x 40 / 1 is left, of k about 0.05
    turned = curvatures(points @ R.T + [3, -5, 7], valid, 5, sigma=0.1, viewpoint=[3, -5, 7])
    assert np.abs(turned.mean - found.mean)[found.valid].max() < 1e-12
    assert np.abs(turned.normals - found.normals @ R.T).max() < 1e-12
    assert np.abs(turned.sigma_k1 - found.sigma_k1)[found.valid].max() < 1e-12
    for scale in (1e-3, 1e3):
        other = curvatures(scale * points, valid, 5, sigma=0.1 * scale)
        assert both(other)[found.valid] * scale == pytest.approx(both(found)[found.valid], rel=1e-9, abs=1e-12)
        assert other.sigma_k2[found.valid] * scale == pytest.approx(found.sigma_k2[found.valid], rel=1e-9)


@pytest.mark.parametrize(
    ("name", "turn"), [("cylinder", (30, 20, 25)), ("saddle", (-30, 35, 50)), ("torus", (50, 0, 0))]
)
def test_stated_noise_is_what_repetition_scatters(name, turn):
    """Of 200 draws a deviation is known to 5 % in one pixel, so nine of ten lie within 8 %; the median to far less."""
    points, valid, _ = seen(SHAPES[name], turn, n=81, pitch=0.7)
    rays = points / np.linalg.norm(points, axis=2, keepdims=True)
    sigma = 0.01 * (1 + np.linspace(0, 1, 81))[None, :] * np.ones((81, 1))  # grows across the image
    clean = curvatures(points, valid, 9, sigma)
    # noise of a curvature well below k1 - k2, where they are smooth functions of the points
    steady = clean.valid & (facing(points, clean.normals) > 0.5)
    steady &= (clean.k1 - clean.k2) > 8 * np.maximum(clean.sigma_k1, clean.sigma_k2)
    assert steady.sum() > 100
    rng, draws = np.random.default_rng(5), []
    for _ in range(200):
        found = curvatures(points + rays * (sigma * rng.normal(size=sigma.shape))[..., None], valid, 9, sigma)
        draws.append(np.stack([found.k1, found.k2, found.mean, found.gaussian])[:, steady])
    scatter = np.std(draws, axis=0)
    stated = np.stack([clean.sigma_k1, clean.sigma_k2, clean.sigma_mean, clean.sigma_gaussian])[:, steady]
    assert np.median(scatter / stated, axis=1) == pytest.approx(np.ones(4), abs=0.02)
    assert (np.quantile(np.abs(scatter / stated - 1), 0.9, axis=1) < 0.1).all()


def test_noise_of_the_mean_curvature_holds_on_a_sphere_where_the_principal_ones_part():
    points, valid, _ = seen(sphere(), n=61)
    rays = points / np.linalg.norm(points, axis=2, keepdims=True)
    rng, noise = np.random.default_rng(7), 0.003
    draws = [curvatures(points + rays * rng.normal(0, noise, (*valid.shape, 1)), valid, 7, noise) for _ in range(150)]
    clean = curvatures(points, valid, 7, noise)
    # one pixel's scatter is known to 6 %, the median of 3000 that overlap in windows of 49 to 1 %
    scatter = np.std([one.mean for one in draws], axis=0)[clean.valid]
    assert np.median(scatter / clean.sigma_mean[clean.valid]) == pytest.approx(1, abs=0.03)
    apart = np.mean([one.k1 - one.k2 for one in draws], axis=0)[clean.valid]
    assert (apart > clean.sigma_k1[clean.valid]).all()


def test_gains_are_the_sums_of_squared_weights():
    v, u = np.mgrid[-3:4.0, -3:4.0]
    design = np.stack([np.ones(49), u.ravel(), v.ravel(), u.ravel() ** 2, (u * v).ravel(), v.ravel() ** 2], axis=1)
    covariance = np.linalg.inv(design.T @ design)
    factor = np.array([1, 1, 1, 2, 1, 2.0])
    assert window(7)[1] == pytest.approx((np.diag(covariance) * factor**2)[1:], rel=1e-12)


def test_only_whole_windows_are_valid_and_nothing_else_has_a_number():
    points, valid, _ = seen(sphere(), n=41)
    valid[20, 20] = False
    points[20, 20] = np.nan
    points[5, 30, 0] = np.inf
    found = curvatures(points, valid, 5)
    expected = np.zeros_like(valid)
    expected[2:-2, 2:-2] = True
    expected[18:23, 18:23] = expected[3:8, 28:33] = False
    assert (found.valid == expected).all()
    for array in (found.k1, found.k2, found.sigma_k1, found.sigma_gaussian):
        assert (np.isfinite(array) == expected).all()
    assert not found.normals[~expected].any()


def test_noise_is_estimated_where_none_is_given():
    points, valid, _ = seen(SHAPES["saddle"], (20, 10, 0))
    rays = points / np.linalg.norm(points, axis=2, keepdims=True)
    noisy = points + rays * np.random.default_rng(1).normal(0, 0.03, (*valid.shape, 1))
    # third differences of 10,000 samples: 1.3 % of scatter by the median
    assert ray_noise(noisy, valid) == pytest.approx(0.03, rel=0.05)
    given, estimated = curvatures(noisy, valid, 7, 0.03), curvatures(noisy, valid, 7)
    assert np.nanmedian(estimated.sigma_k1 / given.sigma_k1) == pytest.approx(1, rel=0.05)


def test_features_have_unit_noise_and_stay_finite_without_any():
    points, valid, _ = seen(SHAPES["torus"], (40, 0, 0))
    rays = points / np.linalg.norm(points, axis=2, keepdims=True)
    rng = np.random.default_rng(2)
    features = []
    for _ in range(20):
        noisy = points + rays * rng.normal(0, 0.05, (*valid.shape, 1))
        features.append(curvatures(noisy, valid, 9, 0.05).normalised())
    where = np.isfinite(features).all(axis=(0, 3))
    # one factor for the whole view: the median pixel has unit noise, to the scatter of 20 draws and of the limbs
    assert np.median(np.std(features, axis=0)[where], axis=0) == pytest.approx([1, 1], rel=0.15)
    flat = curvatures(np.dstack([*np.meshgrid(*(np.arange(9.0),) * 2), np.full((9, 9), 5.0)]), np.ones((9, 9)))
    assert np.abs(flat.normalised()[flat.valid]).max() < 1e-6
    nothing = in_units_of_noise(np.ones((4, 2)), np.ones((4, 2)), np.zeros(4, bool))
    assert np.isnan(nothing).all()


def test_coincident_points_have_no_tangent_plane():
    found = curvatures(np.full((9, 9, 3), 4.0), np.ones((9, 9), bool), 5)
    assert not found.valid.any() and np.isnan(found.k1).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"window_px": 4}, "odd"),
        ({"window_px": 1}, "odd"),
        ({"xyz": np.zeros((9, 9))}, "height, width, 3"),
        ({"xyz": np.zeros((9, 9, 3), int)}, "floats"),
        ({"valid": np.ones((9, 8))}, "valid has shape"),
        ({"sigma": -1.0}, "negative"),
        ({"sigma": np.ones((3, 3))}, "sigma has shape"),
        ({"viewpoint": [0, 0]}, "three finite numbers"),
    ],
)
def test_wrong_input_is_refused(change, message):
    given = {"xyz": np.zeros((9, 9, 3)), "valid": np.ones((9, 9), bool)} | change
    with pytest.raises(ValueError, match=message):
        curvatures(**given)
