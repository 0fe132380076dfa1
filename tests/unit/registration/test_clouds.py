"""Points without a grid: levels, sides, units, and pairs that meet; against surfaces that are formulae."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_relief import errors, hand, head, pose, see

from fringed_plugins.registration.clouds import prepare_cloud
from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.surface import prepare


def bare(view, seed=0):
    """Return a view's points in no order."""
    points = view.xyz_mm[np.isfinite(view.xyz_mm[..., 0])]
    return points[np.random.default_rng(seed).permutation(len(points))]


def ball(count, radius, seed=0):
    x = np.random.default_rng(seed).normal(size=(count, 3))
    return radius * x / np.linalg.norm(x, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def pair():
    return see(head, noise_mm=0.05, seed=1), see(head, pose((0, 25, 10), (5, 3, 2)), noise_mm=0.05, seed=2)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 37.0])
def test_resolution_extent_and_normals_are_those_of_the_surface(unit):
    radius = 50.0 * unit
    cloud = prepare_cloud(ball(20_000, radius) + 7 * radius)
    level = cloud.level(4000)
    assert cloud.spacing_mm == pytest.approx(np.sqrt(4 * np.pi / 20_000) * radius, rel=0.15)
    assert level.spacing_mm == pytest.approx(np.sqrt(4 * np.pi / len(level.points)) * radius, rel=0.15)
    assert 3000 < len(level.points) < 5000
    out = level.points + cloud.origin - 7 * radius
    cosine = np.einsum("ij,ij->i", out, level.normals)[level.interior] / np.linalg.norm(out[level.interior], axis=1)
    assert cosine.min() > 0.99  # a closed surface's outside is found
    curved = cloud.curved(4000)
    assert np.median(curved.curvatures) * radius == pytest.approx(1.0, rel=0.05)


def test_viewpoint_and_given_normals_say_what_is_outside(pair):
    points = bare(pair[0])
    towards = prepare_cloud(points, viewpoint=np.zeros(3))
    assert towards.sided
    seen = towards.level(2000)
    assert (np.einsum("ij,ij->i", seen.points + towards.origin, seen.normals)[seen.interior] < 0).all()
    away = prepare_cloud(points, points).level(2000)  # normals along the rays
    assert (np.einsum("ij,ij->i", away.points + towards.origin, away.normals)[away.interior] > 0).all()
    assert not prepare_cloud(points, np.zeros_like(points)).sided


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_pair_without_grid_normals_or_a_guess_meets(pair, unit):
    clouds = [prepare_cloud(bare(view) * np.float32(unit), name=f"cloud {k}") for k, view in enumerate(pair)]
    found = register(*clouds)
    assert found.converged, found.reason
    T = found.T_reference_model.copy()
    T[:3, 3] /= unit
    degrees, millimetres = errors(T, *pair)
    assert degrees < 0.01 and millimetres < 0.015
    assert found.history[-1].stage == "fine"


def test_cloud_meets_a_range_image(pair):
    found = register(prepare(pair[0].xyz_mm), prepare_cloud(bare(pair[1])))
    assert found.converged and errors(found.T_reference_model, *pair)[1] < 0.015


def test_wrong_side_is_tried_too(pair):
    """What nobody has said of an open surface may be found wrong: turned inside out on purpose, it still meets."""
    clouds = [prepare_cloud(bare(view)) for view in pair]
    found = register(clouds[0].flipped(), clouds[1])
    assert found.converged and errors(found.T_reference_model, *pair)[1] < 0.015


def test_stated_covariance_is_that_of_repetitions():
    """Twelve draws of the noise: the squared Mahalanobis distance is 6 in the mean, within its own spread."""
    squares = []
    for draw in range(12):
        views = [see(hand, pose((0, 12 * k, 0)), noise_mm=0.1, seed=2 * draw + k) for k in range(2)]
        found = register(*(prepare_cloud(bare(view), viewpoint=np.zeros(3)) for view in views))
        true = views[0].T_camera_object @ np.linalg.inv(views[1].T_camera_object)
        off = found.T_reference_model @ np.linalg.inv(true)
        small = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
        error = np.concatenate([small, off[:3, 3]])
        squares.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.4 < np.mean(squares) / 6 < 2.5


def test_different_objects_are_refused(pair):
    other = prepare_cloud(bare(see(hand, noise_mm=0.05)))
    found = register(prepare_cloud(bare(pair[0])), other)
    assert not found.converged and found.reason


def test_different_units_are_noticed(pair):
    with pytest.raises(ValueError, match="different units"):
        register(prepare_cloud(bare(pair[0])), prepare_cloud(bare(pair[1]) / np.float32(1000)))


BAD = [
    (np.zeros((0, 3)), "0 points"),
    (np.full((500, 3), np.nan), "0 of them finite"),
    (np.ones((5000, 3)), "1 distinct"),
    (np.linspace(0, 1, 900)[:, None] * np.array([1.0, 2.0, 3.0]), "one line"),
    (np.zeros((900, 2)), r"\(n, 3\) of floats"),
    (np.zeros((900, 3), int), r"\(n, 3\) of floats"),
]


@pytest.mark.parametrize(("points", "match"), BAD)
def test_what_is_no_surface_is_refused(points, match):
    with pytest.raises(ValueError, match=match):
        prepare_cloud(points, name="thing").level(1000)


def test_scattered_points_are_no_surface():
    cloud = prepare_cloud(np.random.default_rng(0).normal(size=(3000, 3)))
    found = register(cloud, prepare_cloud(np.random.default_rng(1).normal(size=(3000, 3))), Options())
    assert not found.converged


def test_coincident_points_count_once(pair):
    points = bare(pair[0])[:3000]
    twice = prepare_cloud(np.vstack([points, points]))
    assert len(twice.points) == 3000 and twice.spacing_mm == pytest.approx(prepare_cloud(points).spacing_mm)
