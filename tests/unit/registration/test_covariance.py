"""What the last stage states of its error, against repetitions on surfaces of known truth, coarse and fine."""

from __future__ import annotations

import analytic_relief
import closed_head
import numpy as np
import pytest

from fringed_plugins.registration.patches import sharp
from fringed_plugins.registration.projective import refine
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import translation

DRAWS = 24


def heads(pitch_mm, turn_deg):
    """Two views of the closed head."""
    size = int(265 / pitch_mm), int(230 / pitch_mm)
    return [closed_head.see(closed_head.pose(*turn), pitch_mm, size) for turn in ((0.0,), (turn_deg, 5.0))]


def reliefs(shape, pitch_mm):
    """Two views of a relief, 15 degrees apart."""
    size = int(250 / pitch_mm), int(235 / pitch_mm)
    poses = analytic_relief.pose(), analytic_relief.pose((3, 15, -2))
    return [analytic_relief.see(shape, T, pitch_mm, size) for T in poses]


def noisy(view, noise_mm, seed):
    """Return a view's points (h, w, 3) with noise along their rays."""
    rays = view.clean_mm / np.linalg.norm(view.clean_mm, axis=2, keepdims=True)
    noise = np.random.default_rng(seed).normal(0, noise_mm, rays.shape[:2])
    return (view.clean_mm + rays * noise[..., None]).astype(np.float32)


def repeated(views, noise_mm):
    """Return the errors of some draws (n, 6) and the covariances stated (n, 6, 6)."""
    truth = views[0].T_camera_object @ np.linalg.inv(views[1].T_camera_object)
    errors, stated = [], []
    for draw in range(DRAWS):
        sides = [sharp(prepare(noisy(view, noise_mm, 2 * draw + k))) for k, view in enumerate(views)]
        start = translation(-sides[0].surface.origin) @ truth @ translation(sides[1].surface.origin)
        made = refine(sides[0], sides[1], start, lambda _: None)
        assert made.settled and made.covariance is not None
        off = made.T_reference_model @ np.linalg.inv(start)
        errors.append([off[2, 1], off[0, 2], off[1, 0], *off[:3, 3]])
        stated.append(made.covariance)
    return np.array(errors), np.array(stated)


CASES = {
    "face at 1.2 mm": (lambda: reliefs(analytic_relief.head, 1.2), 0.08),
    "face at 1.2 mm, much noise": (lambda: reliefs(analytic_relief.head, 1.2), 0.3),
    "hand at 1.2 mm, little noise": (lambda: reliefs(analytic_relief.hand, 1.2), 0.02),
    "face at 3 mm": (lambda: reliefs(analytic_relief.head, 3.0), 0.08),
    "head at 1.5 mm, 45 degrees": (lambda: heads(1.5, 45.0), 0.05),
    "head at 2 mm": (lambda: heads(2.0, 15.0), 0.05),
    "head at 2 mm, 45 degrees, little noise": (lambda: heads(2.0, 45.0), 0.02),
    "head at 3 mm": (lambda: heads(3.0, 15.0), 0.02),
    "head at 3 mm, 45 degrees": (lambda: heads(3.0, 45.0), 0.1),
}


@pytest.mark.parametrize("case", CASES)
def test_last_stage_errs_by_the_covariance_that_it_states(case):
    """Normalised error squared has mean 6: of 24 draws, 144 degrees of freedom, 0.65 to 1.35 of it at 3 deviations.

    Left is what windows cut off, less than the noise makes.
    """
    views, noise_mm = CASES[case]
    errors, stated = repeated(views(), noise_mm)
    squared = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(stated), errors)
    assert 0.6 < squared.mean() / 6 < 1.6


def test_views_without_noise_state_what_windows_cut_off():
    """What remains is of the size that is stated: not ten times less or more."""
    views = heads(3.0, 30.0)
    truth = views[0].T_camera_object @ np.linalg.inv(views[1].T_camera_object)
    sides = [sharp(prepare(view.xyz_mm)) for view in views]
    start = translation(-sides[0].surface.origin) @ truth @ translation(sides[1].surface.origin)
    made = refine(sides[0], sides[1], start, lambda _: None)
    off = made.T_reference_model @ np.linalg.inv(start)
    error = np.array([off[2, 1], off[0, 2], off[1, 0], *off[:3, 3]])
    assert made.settled and made.covariance is not None
    assert error @ np.linalg.solve(made.covariance, error) < 3 * 6
    assert np.sqrt(np.trace(made.covariance[3:, 3:])) < 0.02  # mm, of points 3 mm apart


@pytest.mark.parametrize(("noise_mm", "window_px"), [(0.02, 3), (0.3, 5), (0.8, 7)])
def test_window_is_the_smallest_whose_slopes_are_steady(noise_mm, window_px):
    (view, _) = reliefs(analytic_relief.head, 1.2)
    assert sharp(prepare(noisy(view, noise_mm, 1))).window_px == window_px


def test_bumps_of_some_pixels_are_not_averaged_away_though_slopes_shake():
    x, y = np.meshgrid(*(np.arange(120) * 0.5,) * 2)
    z = 500 + 1.5 * np.sin(2.2 * x) * np.cos(2.2 * y) + np.random.default_rng(1).normal(0, 0.08, x.shape)
    found = sharp(prepare(np.dstack([x, y, z]).astype(np.float32), sigma_mm=np.full(x.shape, 0.08)))
    assert found.window_px == 3


def test_long_pixels_near_a_silhouette_keep_their_points():
    view, _ = heads(2.0, 15.0)
    found = sharp(prepare(noisy(view, 0.05, 1)))
    t = found.table[found.usable].astype(np.float64)
    own = (t[:, :3] == found.surface.xyz[found.usable]).all(axis=1)
    squares = (t[:, 3:9] ** 2).sum(1)
    assert (own == (squares > 5 * found.surface.spacing_mm**2)).mean() > 0.999
    assert 0.01 < own.mean() < 0.3


def test_truncation_is_what_patches_miss_between_pixels():
    """On a cubic surface the third derivatives are known; errors are meant over one pixel."""
    u, v = np.meshgrid(*(np.arange(-30.0, 31.0),) * 2)
    third = 1e-3
    x = np.dstack([u, v, 1000 + third * (u**3 / 6 + u**2 * v / 2)])
    found = sharp(prepare(x.astype(np.float64)))
    assert found.window_px == 3
    row, column = 30, 30
    t = found.table[row, column].astype(np.float64)
    du, dv = np.meshgrid(*((np.arange(40) + 0.5) / 40 - 0.5,) * 2)
    height = third * (du**3 / 6 + du**2 * dv / 2)
    # at the middle the slopes are nearly 0: heights are distances
    patch = t[2] + found.surface.origin[2] - 1000 + t[5] * du + t[8] * dv
    missed = np.mean((height - patch) ** 2)
    assert found.errors[row, column, 1] == pytest.approx(missed, rel=0.05)
