"""Planes, spheres and steps against arithmetic: values, stated uncertainties, what is found, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from artefact_truth import plane_depth, points, rays, sphere_depth, stairs_depth

from fringed_plugins.calibration.artefacts.cells import box_mean, cells_of, depth_noise_mm
from fringed_plugins.calibration.artefacts.plane import plane_of
from fringed_plugins.calibration.artefacts.scatter import form_of
from fringed_plugins.calibration.artefacts.sphere import Cap, measure_sphere
from fringed_plugins.calibration.artefacts.spheres import find_spheres
from fringed_plugins.calibration.artefacts.step import steps_of

RAY = rays()
NORMAL = np.array([0.2, -0.1, -1.0]) / np.linalg.norm([0.2, -0.1, -1.0])
CENTRE = np.array([15.0, -10.0, 980.0])


def tilted(seed=0, noise_mm=0.06, **more):
    return points(RAY, plane_depth(RAY, NORMAL, (0, 0, 1000.0)), noise_mm, seed, **more)


def ball(seed=0, noise_mm=0.06, radius=60.0, centre=CENTRE):
    return points(RAY, sphere_depth(RAY, centre, radius), noise_mm, seed)


def within_15_percent(scatter, stated):
    """200 repetitions know a standard deviation to 5 %; blocks know their own to some more."""
    assert 0.85 < np.std(scatter) / np.mean(stated) < 1.15


def test_noise_is_told_from_shape():
    assert depth_noise_mm(*tilted(noise_mm=0.05)) == pytest.approx(0.05, rel=0.02)
    # the curvature's part: 1.15^2 / 60 / sqrt(6) = 9 um and more at the limb, where the noise is 50
    assert depth_noise_mm(*ball(noise_mm=0.05)) == pytest.approx(0.05, rel=0.3)


def test_field_is_told_from_the_points_alone():
    assert cells_of(*tilted(noise_mm=0.0)).field_mm == pytest.approx(400, rel=0.02)


def test_plane_is_where_it_is_and_its_flatness_is_that_of_the_noise_means():
    plane = plane_of(*tilted())
    assert np.degrees(np.arccos(min(plane.normal @ NORMAL, 1.0))) < 0.002
    assert plane.offset_mm == pytest.approx(NORMAL @ [0, 0, 1000.0], abs=0.003)
    assert plane.form.raw_rms_mm == pytest.approx(0.06 * abs(NORMAL[2]), rel=0.02)
    # 3 per mille left out of normal means over 49 points: 2 x 2.97 deviations, fewer at the border count less
    assert plane.form.range_mm == pytest.approx(2 * 2.97 * 0.06 / 7, rel=0.12)
    assert plane.form.strays < 0.001


def test_a_bent_plane_is_measured_and_not_cut_down_to_a_flat_piece():
    bend = 0.4 * (RAY[..., 0] / 0.2) ** 2  # 0.4 mm at the borders
    plane = plane_of(*tilted(sideways_mm=bend))
    assert np.count_nonzero(plane.inside) > 0.95 * RAY[..., 0].size
    assert 0.35 < plane.form.range_mm < 0.5


def test_stray_points_move_nothing_and_count_for_the_form_beyond_3_per_mille():
    xyz, valid = tilted()
    stray = np.random.default_rng(5).random(valid.shape) < 0.02
    xyz = np.where(stray[..., None], xyz * 1.004, xyz)
    plane = plane_of(xyz, valid)
    assert plane.offset_mm == pytest.approx(NORMAL @ [0, 0, 1000.0], abs=0.003)
    assert plane.form.strays == pytest.approx(0.02, abs=0.003)
    assert plane.form.range_mm > 0.15


def test_a_backdrop_farther_off_is_not_the_plane():
    z = np.where(np.hypot(RAY[..., 0], RAY[..., 1]) < 0.12, 1000.0, np.nan)
    away = np.isnan(z) & (np.abs(RAY[..., 1]) > 0.125)
    xyz, valid = points(RAY, np.where(away, 1250.0, z))
    plane = plane_of(xyz, valid & (xyz[..., 2] < 1100))
    assert plane.offset_mm == pytest.approx(-1000, abs=0.005)


def test_sphere_is_found_and_measured_without_a_hint():
    found = find_spheres(*ball())[0]
    u = np.sqrt(np.diag(found.covariance))
    assert abs(found.radius_mm - 60) < min(3.5 * u[3], 0.015)
    assert (np.abs(found.centre_mm - CENTRE) < 3.5 * u[:3]).all()
    assert found.covered == 1.0 and 50 < found.cap_deg < 60
    assert found.form.range_mm < 0.06


def test_radius_has_no_bias_from_the_limb():
    radii = [find_spheres(*ball(seed, noise_mm=0.3))[0].radius_mm for seed in range(12)]
    stated = np.sqrt(find_spheres(*ball(0, noise_mm=0.3))[0].covariance[3, 3])
    assert abs(np.mean(radii) - 60) < 3.5 * stated / np.sqrt(12)


def test_sphere_beside_a_wall_and_a_table_is_told_from_them():
    z = sphere_depth(RAY, CENTRE, 60.0)
    wall = np.where(np.abs(RAY[..., 0]) > 0.1, 1000.0, np.nan)
    xyz, valid = points(RAY, np.where(np.isnan(z), wall, z))
    assert find_spheres(xyz, valid)[0].radius_mm == pytest.approx(60, abs=0.02)


def test_ball_bar_spacing():
    a, b = np.array([-100.0, 5.0, 990.0]), np.array([90.0, -20.0, 1010.0])
    z = np.fmin(sphere_depth(RAY, a, 25.0), sphere_depth(RAY, b, 25.0))
    first, second = find_spheres(*points(RAY, z), count=2, cap=Cap(nominal_mm=25.0))
    apart = second.fixed_centre_mm - first.fixed_centre_mm
    along = apart / np.linalg.norm(apart)
    u = np.sqrt(along @ (first.fixed_covariance + second.fixed_covariance) @ along)
    assert abs(np.linalg.norm(apart) - np.linalg.norm(b - a)) < min(3.5 * u, 0.01)


def test_sphere_cut_by_the_picture_is_measured_where_enough_is_left_and_refused_where_not():
    assert find_spheres(*ball(centre=np.array([165.0, 0.0, 1000.0])))[0].radius_mm == pytest.approx(60, abs=0.03)
    with pytest.raises(ValueError, match="a sphere should be in view, and none is"):
        find_spheres(*ball(centre=np.array([240.0, 0.0, 1000.0])))


def test_steps_have_their_heights():
    found = steps_of(*points(RAY, stairs_depth(RAY, (0.0, 10.0, 20.0, 40.0))), [10.0, 20.0, 40.0])
    u = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.heights_mm - [10, 20, 40]) < np.minimum(3.5 * u, 0.03)).all()


def test_a_small_step_is_still_two_planes():
    found = steps_of(*points(RAY, stairs_depth(RAY, (0.0, 1.0)), 0.02), [1.0])
    assert found.heights_mm[0] == pytest.approx(1.0, abs=0.01)


def test_heights_above_a_base_out_of_view_are_counted_from_the_lowest_plane():
    found = steps_of(*points(RAY, stairs_depth(RAY, (10.0, 25.0, 30.0))), [10.0, 25.0, 30.0])
    assert found.nominal_mm.tolist() == [15.0, 20.0]
    assert found.heights_mm == pytest.approx([15, 20], abs=0.02)


@pytest.mark.slow
def test_stated_uncertainties_are_the_scatter_of_repetitions():
    size = rays(160, 120)
    z = sphere_depth(size, CENTRE, 60.0)
    around = (CENTRE, 60.0)
    runs = [measure_sphere(*points(size, z, seed=seed), None, around) for seed in range(200)]
    within_15_percent([r.radius_mm for r in runs], [np.sqrt(r.covariance[3, 3]) for r in runs])
    for axis in range(3):
        within_15_percent([r.centre_mm[axis] for r in runs], [np.sqrt(r.covariance[axis, axis]) for r in runs])


@pytest.mark.slow
def test_stated_uncertainties_of_planes_are_the_scatter_of_repetitions():
    size = rays(160, 120)
    flat = plane_depth(size, NORMAL, (0, 0, 1000.0))
    planes = [plane_of(*points(size, flat, seed=seed)) for seed in range(200)]
    at_centre = [float(p.normal @ (p.centre_mm - [0, 0, 1000.0])) for p in planes]
    within_15_percent(at_centre, [p.offset_u_mm for p in planes])
    within_15_percent([p.form.range_mm for p in planes], [p.form.range_u_mm for p in planes])


@pytest.mark.slow
def test_stated_uncertainties_of_steps_are_the_scatter_of_repetitions():
    size = rays(160, 120)
    stairs = stairs_depth(size, (0.0, 10.0, 30.0))
    steps = [steps_of(*points(size, stairs, seed=seed), [10.0, 30.0]) for seed in range(200)]
    for i in (0, 1):
        within_15_percent([s.heights_mm[i] for s in steps], [np.sqrt(s.covariance[i, i]) for s in steps])


def test_errors_shared_by_neighbours_count_once():
    """Noise with a length of 8 px is far worse for a mean than white noise; the blocks see it."""
    rng = np.random.default_rng(2)
    coarse = rng.normal(0, 0.06, (260 // 4, 348 // 4))
    shared = np.kron(coarse, np.ones((4, 4)))
    white, patches = plane_of(*tilted()), plane_of(*tilted(noise_mm=0.0, sideways_mm=shared))
    assert 2.5 < patches.offset_u_mm / white.offset_u_mm < 6


def test_half_filled_windows_give_no_means():
    inside = np.ones((20, 20), bool)
    inside[:, :10] = False
    mean = box_mean(np.ones((20, 20)), inside, 5)
    assert np.isnan(mean[:, :10]).all() and np.isnan(mean[0, 10]) and mean[10, 10] == pytest.approx(1)


def test_means_of_many_more_points_have_no_larger_range():
    rng = np.random.default_rng(0)
    few, many = (form_of(rng.normal(0, 1, s), np.ones(s, bool), 7).range_mm for s in ((150, 150), (900, 900)))
    assert many == pytest.approx(few, rel=0.15)


def two_planes():
    z = np.where(RAY[..., 0] < 0.0, 1000.0, 960.0 + 0.5 * 1000 * RAY[..., 0])
    return points(RAY, np.where(np.abs(RAY[..., 0]) < 0.002, np.nan, z))


@pytest.mark.parametrize(
    ("measure", "said"),
    [
        (lambda: plane_of(*two_planes()), "two surfaces of like size"),
        (lambda: plane_of(*ball(radius=120.0)), "no plane"),
        (lambda: find_spheres(*tilted()), "a sphere should be in view, and none is"),
        (lambda: find_spheres(*ball(), count=2), "2 spheres should be in view, and 1 is"),
        (lambda: steps_of(*tilted(), [10.0]), "parallel"),
        (lambda: steps_of(*points(RAY, stairs_depth(RAY, (0.0, 10.0))), [0.010]), "0.01 mm; measured above"),
        (lambda: steps_of(*ball(), [10.0]), "parallel"),
        (lambda: steps_of(*ball(), []), "nominal heights"),
        (lambda: steps_of(*ball(), [5.0, 5.0]), "nominal heights"),
        (lambda: plane_of(np.full((*RAY.shape,), np.nan, np.float32), np.zeros(RAY.shape[:2], bool)), "has 0 points"),
        (lambda: find_spheres(np.ones((9, 9, 3), np.float32), np.eye(9, dtype=bool) & (np.arange(9) < 3)), "3 points"),
        (lambda: plane_of(*points(rays(20, 15), np.full((15, 20), 1000.0))), "has 2|has 1"),
    ],
)  # fmt: skip
def test_what_is_no_measurement_is_refused_with_the_reason(measure, said):
    with pytest.raises(ValueError, match=said):
        measure()
