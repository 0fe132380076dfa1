"""Curvatures, normals, boundaries and noise of clouds without a grid, against formulas."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_shapes import saddle, sphere, torus
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.features.cloud import cloud_features, cloud_level


def ball(n, seed=0, radius=60.0):
    directions = np.random.default_rng(seed).normal(size=(n, 3))
    return radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def ring(n, seed=0, large=50.0, small=20.0):
    """Points even over the area of a torus."""
    rng = np.random.default_rng(seed)
    around, tube = rng.uniform(0, 2 * np.pi, (2, 3 * n))
    keep = rng.uniform(0, large + small, 3 * n) < large + small * np.cos(tube)
    around, tube = around[keep][:n], tube[keep][:n]
    away = large + small * np.cos(tube)
    return np.stack([away * np.cos(around), away * np.sin(around), small * np.sin(tube)], axis=1)


def hollow(n, seed=0):
    """A saddle over a square of 60, seen from below."""
    x, y = np.random.default_rng(seed).uniform(-30, 30, (2, n))
    return np.stack([x, y, y**2 / 180 - x**2 / 120], axis=1)


BELOW = np.array([0.0, 0.0, -500.0])
CASES = {  # points, where from, truth, the greatest change of a curvature along the surface
    "sphere": (ball, None, sphere()[1], 0.0),
    "torus": (ring, None, torus()[1], 1 / 600),
    "saddle": (hollow, BELOW, saddle()[1], 1 / 3600),
}


@pytest.mark.parametrize("name", CASES)
def test_curvatures_are_those_of_the_formula(name):
    """A quadric misses what a neighbourhood of radius h has of third and fourth order: h dk / ds and h^2 k^3."""
    sample, viewpoint, formula, change = CASES[name]
    median = []
    for n in (6000, 24_000):
        points = sample(n)
        truth = formula(points)
        found = cloud_features(points, viewpoint=viewpoint)
        error = np.abs(np.stack([found.k1, found.k2], axis=1) - truth)[found.valid].max(axis=1)
        # 20 neighbours of random points, whose nearest is 0.5 / sqrt(density) away: h = sqrt(20 / pi) x 2 of that,
        # and up to twice as much where points are few
        h = 2 * np.sqrt(20 / np.pi) * found.resolution
        strongest = np.abs(truth).max()
        assert np.quantile(error, 0.99) < 2 * h * change + 2 * h**2 * strongest**3
        assert found.valid.mean() > 0.9
        median.append(np.median(error))
    assert median[0] / median[1] > 1.8  # of half the spacing, half the error at least


def test_turning_and_moving_changes_no_curvature_and_scaling_scales_it():
    points = ring(3000)
    found = cloud_features(points)
    R = Rotation.random(random_state=4).as_matrix()
    for scale in (1.0, 1e-3, 1e4):
        turned = cloud_features(scale * points @ R.T + scale * np.array([30.0, -5, 90]))
        assert (turned.valid == found.valid).all() and (turned.boundary == found.boundary).all()
        # the fit's condition is about 100, of numbers that are exact to 1e-14 of the extent
        assert turned.k1[found.valid] * scale == pytest.approx(found.k1[found.valid], abs=1e-9)
        assert np.abs(turned.normals - found.normals @ R.T).max() < 1e-9
        assert turned.resolution == pytest.approx(scale * found.resolution, rel=1e-9)


def test_stated_noise_is_what_repetition_scatters():
    points, noise = hollow(1500, seed=3), 0.02
    out = np.stack([-points[:, 0] / 60, points[:, 1] / 90, -np.ones(1500)], axis=1)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    clean, rng, draws, noises = cloud_features(points, 30, BELOW, sigma=noise), np.random.default_rng(6), [], []
    for _ in range(100):
        found = cloud_features(points + noise * rng.normal(size=(1500, 1)) * out, 30, BELOW)
        draws.append(np.stack([found.k1, found.k2]))
        noises.append(found.normals)
    steady = np.isfinite(draws).all(axis=(0, 1)) & clean.valid
    steady &= clean.k1 - clean.k2 > 8 * np.maximum(clean.sigma_k1, clean.sigma_k2)
    assert steady.sum() > 500
    ratio = np.std(draws, axis=0)[:, steady] / np.stack([clean.sigma_k1, clean.sigma_k2])[:, steady]
    # 100 draws know a deviation to 7 %; the median over points to far less
    assert np.median(ratio, axis=1) == pytest.approx([1, 1], abs=0.05)
    lean = np.sqrt(np.var(noises, axis=0).sum(axis=1)[steady] / 2)  # two directions
    assert np.median(lean) == pytest.approx(clean.slope_noise, rel=0.1)


def test_noise_and_resolution_are_estimated():
    x, y = (a.ravel() * 0.5 for a in np.mgrid[0:80.0, 0:60.0])
    z = 0.002 * (x - 20) ** 2 + 0.05 * np.random.default_rng(2).normal(size=x.size)
    found = cloud_features(np.stack([x, y, z], axis=1), 24, viewpoint=np.array([0, 0, 99.0]))
    assert found.noise == pytest.approx(0.05, rel=0.05)
    assert found.resolution == pytest.approx(0.5, rel=0.05)
    assert np.median(found.normals[:, 2]) > 0.99


def test_boundaries_are_the_rim_and_holes_and_not_the_inside():
    rng = np.random.default_rng(8)
    r, a = 10 * np.sqrt(rng.uniform(0.09, 1, 4000)), rng.uniform(0, 2 * np.pi, 4000)
    found = cloud_features(np.stack([r * np.cos(a), r * np.sin(a), 0 * r], axis=1))
    spacing = 2 * found.resolution
    rim = (r > 10 - 0.2 * spacing) | (r < 3 + 0.2 * spacing)
    inside = (r < 10 - 3 * spacing) & (r > 3 + 3 * spacing)
    assert found.boundary[rim].mean() > 0.9
    assert found.boundary[inside].mean() < 0.03  # 20 (2 / 3)^19 = 0.9 % of random points


def test_normals_agree_without_a_viewpoint_and_closed_parts_face_out():
    centres = np.array([[0, 0, 0], [300.0, 0, 0]])
    points = np.vstack([ball(1500, k) + centre for k, centre in enumerate(centres)])
    points += np.random.default_rng(3).normal(0, 0.3, points.shape)
    found = cloud_features(points)
    away = points - np.repeat(centres, 1500, axis=0)
    assert (np.einsum("ij,ij->i", away, found.normals) > 0).all()
    assert np.nanmedian(found.k2) > 0
    sheet = cloud_features(hollow(3000))
    assert abs(np.sign(sheet.normals[:, 2]).sum()) == 3000


def test_viewpoints_of_each_point_turn_its_normal():
    points = ball(1200)
    found = cloud_features(points, viewpoint=0.5 * points)
    assert (np.einsum("ij,ij->i", points, found.normals) < 0).all()
    assert (found.k1[found.valid] < 0).all() and (found.k1 >= found.k2)[found.valid].all()


def test_coincident_points_count_once_and_rows_that_are_not_finite_are_not_valid():
    points = ring(800)
    once = cloud_features(points)
    shuffled = np.random.default_rng(1).permutation(np.tile(np.arange(800), 30))
    again = cloud_features(np.vstack([[[np.nan, 0, 0]], points[shuffled], [[np.inf, 0, 0]]]))
    assert not again.valid[[0, -1]].any() and not again.normals[[0, -1]].any()
    assert (again.valid[1:-1] == once.valid[shuffled]).all()
    known = again.valid[1:-1]
    # the same sums in another order
    assert again.k1[1:-1][known] == pytest.approx(once.k1[shuffled][known], abs=1e-9)
    assert again.resolution == pytest.approx(once.resolution)


def test_points_on_lines_have_no_curvature():
    line = np.stack([np.arange(100.0), np.zeros(100), np.zeros(100)], axis=1)
    found = cloud_features(line)
    assert not found.valid.any() and found.boundary.all() and not found.normals.any()


def test_a_report_may_cancel():
    seen = []

    def stop(fraction, text):
        seen.append(fraction)
        if fraction > 0.3:
            raise InterruptedError(text)

    with pytest.raises(InterruptedError, match="neighbourhoods"):
        cloud_features(ball(30_000), report=stop)
    assert seen == sorted(seen) and len(seen) < 8


def test_level_has_the_inside_with_normals_and_noise():
    points = hollow(3000) + np.array([0, 0, 4.0])
    level = cloud_level(np.vstack([points, [[np.nan] * 3], points[:50]]), viewpoint=BELOW)
    assert len(level.points) == 3000 and level.interior.mean() > 0.85
    assert np.abs(np.linalg.norm(level.normals[level.interior], axis=1) - 1).max() < 1e-12
    assert not level.normals[~level.interior].any() and (level.normals[level.interior, 2] < 0).all()
    assert 0 < level.sigma_mm[0] < 1e-2 and 0 < level.slope_noise < 0.01
    assert level.spacing_mm == pytest.approx(0.5 * np.sqrt(60 * 60 / 3000), rel=0.1)
    assert level.tree.n == 3000


def test_level_takes_given_normals():
    points = ball(1000)
    given = np.where(points[:, :1] > 0, points, 0)
    level = cloud_level(points, normals=given)
    assert not level.interior[points[:, 0] <= 0].any() and level.interior[points[:, 0] > 0].mean() > 0.9
    assert np.abs(level.normals - np.where(level.interior[:, None], points / 60, 0)).max() < 1e-12
    inward = cloud_level(points, normals=given, viewpoint=np.zeros(3))
    assert inward.normals == pytest.approx(-level.normals)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 3)), "0 points"),
        (np.full((500, 3), np.nan), "0 of them finite"),
        (ball(199), "needs 200"),
        (np.full((1_000_000, 3), 7.5), "1 distinct"),
        (np.outer(np.arange(300.0), [1, 2, 3]), "one line"),
        (np.zeros((300, 2)), r"\(n, 3\)"),
        (np.zeros((300, 3), int), "floats"),
    ],
)
def test_level_refuses_what_is_no_surface(points, message):
    with pytest.raises(ValueError, match=message):
        cloud_level(points)


def test_level_refuses_normals_of_other_points_and_wires():
    with pytest.raises(ValueError, match="normals have shape"):
        cloud_level(ball(300), normals=np.zeros((299, 3)))
    t = np.linspace(0, 20, 400)
    with pytest.raises(ValueError, match="inside a surface"):
        cloud_level(np.stack([50 * np.cos(t), 50 * np.sin(t), 10 * t], axis=1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"neighbours": 7}, "8 to 200"),
        ({"neighbours": 60}, "need 61"),
        ({"sigma": -1.0}, "sigma"),
        ({"viewpoint": np.zeros(2)}, "viewpoint"),
        ({"viewpoint": np.array([0, 0, np.inf])}, "not finite"),
    ],
)
def test_wrong_input_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        cloud_features(**({"points": ball(50)} | change))
