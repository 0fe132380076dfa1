"""Zhang's limit, Tukey's weights, and the feet of points on a full grid."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_relief import pose, see

from fringed_plugins.registration.footpoints import build_grid, feet, fit_projection
from fringed_plugins.registration.plane import jacobian, step
from fringed_plugins.registration.rejection import mad_scale, tukey_weights, zhang_limit
from fringed_plugins.registration.surface import prepare


@pytest.mark.parametrize(("resolution", "sigmas"), [(3.0, 3), (1.0, 2), (0.4, 1)])
def test_zhang_limit_tightens_as_the_frames_are_farther_apart(resolution, sigmas):
    d = np.random.default_rng(0).uniform(1, 3, 5000)
    assert zhang_limit(d, resolution) == pytest.approx(d.mean() + sigmas * d.std())


def test_zhang_limit_of_far_frames_is_the_valley():
    rng = np.random.default_rng(0)
    d = np.concatenate([rng.normal(10, 1, 4000), rng.normal(30, 2, 2000)])
    assert 13 < zhang_limit(d, 0.1) < 25


def test_scale_of_normal_noise_is_its_standard_deviation():
    r = np.random.default_rng(0).normal(0, 0.2, 20000)
    assert mad_scale(r) == pytest.approx(0.2, rel=0.03)
    assert (tukey_weights(np.array([-9.0, 9.0]), 1.0) == 0).all()


def test_step_leaves_undetermined_directions_alone():
    x = np.random.default_rng(0).uniform(-50, 50, (500, 3)) * [1, 1, 0]
    n = np.tile([0.0, 0, 1], (500, 1))
    small, _ = step(jacobian(x, n), np.full(500, 0.3), np.ones(500))
    assert small == pytest.approx([0, 0, 0, 0, 0, -0.3], abs=1e-9)


def test_projection_is_found_in_the_range_image():
    surface = prepare(see().xyz_mm)
    P = fit_projection(surface)
    v, u = np.nonzero(surface.valid)
    image = surface.xyz[v, u] @ P[:, :3].T + P[:, 3]
    assert np.abs(image[:, :2] / image[:, 2:] - np.c_[u, v]).max() < 0.02  # pixels; a pinhole is fitted exactly


def test_feet_are_the_closest_points_and_the_signed_distance():
    surface = prepare(see(T=pose((0, 20, 0))).xyz_mm)
    grid = build_grid(surface)
    v, u = np.nonzero(grid.usable)
    chosen = np.linspace(0, len(u) - 1, 3000).astype(int)
    x, n = surface.xyz[v[chosen], u[chosen]], grid.normals[v[chosen], u[chosen]]
    found = feet(grid, x + 0.8 * n)
    assert found.found.mean() > 0.98
    assert np.abs(found.residual_mm[found.found] - 0.8).max() < 0.08  # curvature over the rounding to a pixel
    far = feet(grid, x + np.array([400.0, 0, 0]))
    assert not far.found.any()
