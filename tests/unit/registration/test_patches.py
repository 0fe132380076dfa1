"""Smooth patches and the last stage: derivatives of known surfaces, feet, the bound of the motion, its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_relief import hand, head, pose, see

from fringed_plugins.registration.invariant import curved, draw_near, principal
from fringed_plugins.registration.patch_kernels import walk
from fringed_plugins.registration.patches import curvature_noise, patches, quadratic, sharp
from fringed_plugins.registration.projective import refine
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import rigid, rotation, rotation_angle, translation

RADIUS = 60.0


def ball(n=121, pitch=0.5):
    """A sphere's cap whose bulge faces a sensor far down the z axis."""
    x, y = np.meshgrid(*(np.arange(n) * pitch - (n - 1) * pitch / 2,) * 2)
    return np.dstack([x, y, 1000 - np.sqrt(RADIUS**2 - x**2 - y**2)])


@pytest.mark.parametrize("window", [3, 5, 7])
def test_patches_of_a_sphere_have_its_point_normal_and_curvature(window):
    points = ball()
    found = patches(prepare(points), window)
    assert found.window_px == window and found.usable.sum() == (121 - window + 1) ** 2
    rows, columns = np.nonzero(found.usable)
    t = found.table[rows, columns].astype(np.float64)
    middle = np.array([0.0, 0.0, 1000.0]) - found.surface.origin
    out = (points[rows, columns] - [0, 0, 1000]) / RADIUS
    # outwards, towards the sensor; third derivatives of a slope of 48 degrees lean into windows of 3.5 mm
    assert np.abs(t[:, 9:12] - out).max() < 1e-3
    assert np.abs(np.linalg.norm(t[:, :3] - middle, axis=1) - RADIUS).max() < 2e-4
    assert principal(t) == pytest.approx(np.full((len(t), 2), 1 / RADIUS), rel=1e-2)


def test_saddle_has_curvatures_of_both_signs():
    x, y = np.meshgrid(*(np.arange(61) * 0.5 - 15,) * 2)
    found = patches(prepare(np.dstack([x, y, 1000 - x**2 / 80 + y**2 / 120])), 7)
    k = principal(found.table[30, 30][None].astype(np.float64))[0]
    assert k == pytest.approx([1 / 60, -1 / 40], rel=0.02)


def test_window_follows_the_noise():
    """Noise asks for seven pixels; without any, bumps of a few pixels are kept by three."""
    x, y = np.meshgrid(*(np.arange(90) * 0.5,) * 2)
    z = 500 + 0.4 * np.sin(x) * np.cos(y)
    noisy = z + np.random.default_rng(1).normal(0, 0.2, z.shape)
    assert patches(prepare(np.dstack([x, y, noisy]).astype(np.float32))).window_px == 7
    assert patches(prepare(np.dstack([x, y, z]))).window_px < 7


def test_noise_of_points_and_curvatures_is_what_repetition_scatters():
    rng, points, noise = np.random.default_rng(2), ball(), 0.02
    heights, curvatures = [], []
    for _ in range(60):
        found = patches(prepare(points + rng.normal(0, noise, points.shape[:2])[..., None] * [0, 0, 1.0]), 7)
        t = found.table[20:100:9, 20:100:9].reshape(-1, 15).astype(np.float64)
        heights.append(t[:, 2] + found.surface.origin[2])
        curvatures.append(principal(t).mean(axis=1))
    gain = np.std(heights, axis=0).mean() / noise
    assert gain**2 == pytest.approx(quadratic(7)[1], rel=0.1)
    # H is the mean of two curvatures of which each has the stated deviation: their noise is nearly independent
    stated = curvature_noise(t, noise, 7).mean() / np.sqrt(2)
    assert np.std(curvatures, axis=0).mean() == pytest.approx(stated, rel=0.25)


def test_feet_are_at_the_distance_that_was_given():
    points = ball()
    found = patches(prepare(points), 7)
    rows, columns = np.nonzero(found.usable[20:-20:5, 20:-20:5])
    rows, columns = rows * 5 + 20, columns * 5 + 20
    out = (points[rows, columns] - [0, 0, 1000]) / RADIUS
    rng = np.random.default_rng(3)
    off = rng.uniform(-1.5, 1.5, len(rows))
    away = points[rows, columns] + off[:, None] * out - found.surface.origin
    index, made = np.full(len(rows), -1), np.empty((len(rows), 8))
    walk(
        np.hstack([away, out, np.ones((len(rows), 1))]),
        np.vstack([np.eye(4), found.projection]),
        found.table,
        found.usable,
        index,
        made,
    )
    assert (index == rows * 121 + columns).all()
    assert made[:, 6] == pytest.approx(off, abs=3e-4)
    assert np.abs(made[:, 3:6] - out).max() < 1e-3


def test_points_beside_the_surface_have_no_foot():
    found = patches(prepare(ball()), 7)
    beside = np.array([[100.0, 0, 0, 0, 0, -1], [0, 0, 5000.0, 0, 0, -1], [0, 0, 0, 0, 0, 1.0]])
    index, made = np.full(3, -1), np.empty((3, 8))
    walk(beside, np.vstack([np.eye(4), found.projection]), found.table, found.usable, index, made)
    assert index[0] == -1 and index[2] == -1  # outside; facing away


def test_too_torn_a_view_has_no_patches():
    points = ball()
    points[::3] = np.nan
    points[:, ::3] = np.nan
    surface = prepare(points)
    with pytest.raises(ValueError, match="no complete window of 3"):
        patches(surface)


@pytest.fixture(scope="module")
def clean():
    T = pose((3, 15, -2))
    return see(head), see(head, T), T


def noisy(view, seed, noise_mm=0.08):
    rays = view.clean_mm / np.linalg.norm(view.clean_mm, axis=2, keepdims=True)
    noise = np.random.default_rng(seed).normal(0, noise_mm, rays.shape[:2])
    return (view.clean_mm + rays * noise[..., None]).astype(np.float32)


def test_last_stage_converges_quadratically_from_two_resolutions(clean):
    reference, model, T = clean
    sides = [sharp(prepare(view.xyz_mm)) for view in (reference, model)]
    truth = reference.T_camera_object @ np.linalg.inv(T)
    exact = translation(-sides[0].surface.origin) @ truth @ translation(sides[1].surface.origin)
    made = refine(sides[0], sides[1], rigid(rotation([0.01, -0.01, 0.02]), [1.5, -1.0, 2.0]) @ exact, lambda _: None)
    steps = [one.rotation_rad for one in made.history]
    assert made.settled and steps[1] < 0.05 * steps[0] and steps[2] < 0.1 * steps[1]
    assert np.degrees(rotation_angle(np.linalg.inv(exact) @ made.T_reference_model)) < 2e-3  # sampled at 1.2 mm


@pytest.mark.parametrize("shape", [head, hand])
def test_pixels_that_meet_in_their_corners_do_not_swing(shape):
    """Turned by 90 degrees about the axis: every foot lies on the edge of two patches, with noise of its own each."""
    seen = see(shape, noise_mm=0.1, seed=1), see(shape, pose((0, 0, 90)), noise_mm=0.1, seed=2)
    sides = [sharp(prepare(view.xyz_mm)) for view in seen]
    truth = seen[0].T_camera_object @ np.linalg.inv(seen[1].T_camera_object)
    start = translation(-sides[0].surface.origin) @ truth @ translation(sides[1].surface.origin)
    made = refine(sides[0], sides[1], start, lambda _: None)
    assert made.settled and len(made.history) < 8


def test_views_that_do_not_meet_settle_nowhere(clean):
    sides = [sharp(prepare(view.xyz_mm)) for view in clean[:2]]
    made = refine(sides[0], sides[1], translation([500.0, 0, 0]), lambda _: None)
    assert not made.settled and made.covariance is None and "have a foot" in made.stopped


def test_curvatures_bring_views_near_that_closest_points_do_not():
    """45 degrees about an oblique axis; curvatures decide while the views are apart."""
    reference, model = (prepare(see(head, T, noise_mm=0.05).xyz_mm) for T in (pose(), pose((0, 0, 45))))
    heard = []
    start = translation(model.origin - reference.origin)
    T = draw_near(curved(reference, 2500), curved(model, 2500), start, 40, heard.append)
    truth = pose() @ np.linalg.inv(pose((0, 0, 45)))
    exact = translation(-reference.origin) @ truth @ translation(model.origin)
    # half of the window-widened rim is lost: what is left is within the reach of closest points
    assert np.degrees(rotation_angle(np.linalg.inv(exact) @ T)) < 15
    assert heard[0].stage == "coarse" and heard[-1].rms_mm < heard[0].rms_mm
