"""Normals, boundaries, jumps, noise and decimation of one view against formulas."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_relief import DISTANCE_MM, see

from fringed_plugins.registration.normals import complete, healed, normals
from fringed_plugins.registration.surface import prepare

RADIUS = 60.0


def sphere(n=121, pitch=0.8, dtype=np.float64):
    y, x = np.mgrid[0:n, 0:n] * pitch - (n - 1) * pitch / 2
    inside = x**2 + y**2 < 45**2
    z = 1000 - np.sqrt(np.where(inside, RADIUS**2 - x**2 - y**2, 1))
    return np.where(inside[..., None], np.dstack([x, y, z]), 0).astype(dtype), inside


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_normals_of_a_sphere_point_from_its_centre(dtype):
    xyz, inside = sphere(dtype=dtype)
    n, ok = normals(xyz - [0, 0, 1000], inside, 5)
    truth = (xyz - [0, 0, 1000]) / RADIUS
    error = np.arccos(np.clip((n * truth).sum(2)[ok], -1, 1))
    # the least squares derivative errs by h^2 z''' / 6 x 3.4 (5 samples); steepest at 45 mm: 3 mrad
    assert error.max() < 4e-3
    assert ok.sum() > 0.8 * inside.sum()


def test_normals_are_valid_only_where_the_whole_window_is():
    valid = np.ones((20, 20), bool)
    valid[10, 10] = False
    expected = np.zeros_like(valid)
    expected[2:-2, 2:-2] = True
    expected[8:13, 8:13] = False
    assert (complete(valid, 5) == expected).all()


def test_lone_missing_pixels_are_healed_but_no_gap():
    v, u = np.mgrid[0:20.0, 0:20.0]
    xyz, valid = np.dstack([u, v, 3 * u + 2 * v]), np.ones((20, 20), bool)
    valid[5, 5] = valid[12:14, :] = False
    out, ok = healed(np.where(valid[..., None], xyz, 0), valid)
    assert ok[5, 5] and np.allclose(out[5, 5], xyz[5, 5])
    assert not ok[12:14, 2:-2].any()


def test_window_must_be_odd():
    with pytest.raises(ValueError, match="odd"):
        normals(np.zeros((9, 9, 3)), np.ones((9, 9), bool), 4)


def test_noise_is_estimated_from_the_points_alone():
    for noise in (0.05, 0.2):
        assert prepare(see(noise_mm=noise, seed=3).xyz_mm).noise_mm == pytest.approx(noise, rel=0.05)


def test_decimation_averages_noise_and_keeps_the_surface():
    v, u = np.mgrid[0:300.0, 0:400.0]
    z = 1000 + 0.2 * u + np.random.default_rng(1).normal(0, 0.1, u.shape)
    level = prepare(np.dstack([u, v, z]).astype(np.float32)).level(8000)
    points = level.points - level.points.mean(0)
    off = (points[:, 2] - 0.2 * points[:, 0])[level.interior]
    assert level.sigma_mm[level.interior].mean() == pytest.approx(0.1 / 4 / np.hypot(1, 0.2), rel=0.1)  # 4 x 4 blocks
    assert off.std() == pytest.approx(0.1 / 4, rel=0.05)
    assert np.degrees(np.arccos(np.abs(level.normals[level.interior] @ [-0.2, 0, 1] / np.hypot(1, 0.2)))).max() < 1.0


def test_depth_jump_leaves_boundary_on_both_sides():
    v, u = np.mgrid[0:60.0, 0:60.0]
    z = np.where(u < 30, 1000.0, 1030.0)
    surface = prepare(np.dstack([u, v, z]).astype(np.float32))
    assert not surface.valid[:, 29:31].any() and surface.valid[:, :29].all()
    level = surface.level(10**6)
    near = np.abs(level.points[:, 0] + surface.origin[0] - 29.5) < 2.4
    assert near.any() and not level.interior[near].any()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda x: x[:, :, :2], "organised grid"),
        (lambda x: x.reshape(-1, 3), "organised grid"),
        (lambda x: x.astype(int), "floats"),
        (lambda x: x * np.nan, "0 valid points"),
        (lambda x: np.where(np.arange(x.shape[0])[:, None, None] == 50, x, np.nan), "at least 200"),
        (lambda x: x * [1, 0, 0], "one line"),
        (lambda x: np.full_like(x, 5), "coincide"),
    ],
)
def test_what_is_no_surface_is_refused(make, says):
    v, u = np.mgrid[0:60.0, 0:80.0]
    with pytest.raises(ValueError, match=says):
        prepare(make(np.dstack([u, v, u * 0 + DISTANCE_MM])))


def test_mask_of_another_size_is_refused():
    xyz = see().xyz_mm
    with pytest.raises(ValueError, match="rejected"):
        prepare(xyz, np.zeros((3, 3), np.uint8))
    with pytest.raises(ValueError, match="sigma_mm"):
        prepare(xyz, None, np.ones((3, 3)))


def test_infinite_points_and_rejected_ones_do_not_count():
    xyz = see().xyz_mm.copy()
    before = prepare(xyz).valid.sum()
    rejected = np.zeros(xyz.shape[:2], np.uint8)
    rejected[100, 80:90] = 4
    xyz[90, 80:90, 1] = np.inf
    assert prepare(xyz, rejected).valid.sum() == before - 20
