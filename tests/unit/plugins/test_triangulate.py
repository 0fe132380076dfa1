"""Triangulation and the reference plane against points that are projected by the plain formulas."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import points, projector_pixels, rays, run, small_rig

from fringed.data import Lens, PhaseMap, Reject
from fringed.errors import DataError
from fringed.testing import RecordingContext
from fringed_plugins.calibration.reference import (
    axes_crossing_mm,
    height_from_difference,
    phase_at_depth,
    plane_depth,
)
from fringed_plugins.calibration.rig import Pinhole, camera_rays, projector_axis
from fringed_plugins.calibration.stereo import newton_steps
from fringed_plugins.triangulation_plugin import ReferencePlane, Triangulate

PERIOD = 16.0


def relief(height=120, width=160):
    y, x = np.mgrid[0:height, 0:width]
    return 1000 - 40 * np.exp(-(((x - 80) / 40) ** 2 + ((y - 60) / 30) ** 2)) + 0.05 * x


def phase_map(calibration, xyz, orientation="columns", initial=0.0, **fields):
    pixel = projector_pixels(calibration, xyz)[..., 0 if orientation == "columns" else 1]
    phase = (2 * np.pi * pixel / PERIOD + initial).astype(np.float32)
    shape = phase.shape
    size = calibration.projector.width_px if orientation == "columns" else calibration.projector.height_px
    values = {
        "phase_rad": phase,
        "modulation": np.full(shape, 80, np.float32),
        "background": np.full(shape, 100, np.float32),
        "rejected": np.where(np.isnan(phase), Reject.LOW_MODULATION, 0).astype(np.uint16),
        "kind": "absolute",
        "period_px": PERIOD,
        "orientation": orientation,
        "initial_phase_rad": initial,
        "sigma_rad": np.full(shape, 0.01, np.float32),
        "projector_px": size,
    }
    return PhaseMap(**(values | fields))


def pinhole(lens):
    return Pinhole(lens.width_px, lens.height_px, lens.matrix, lens.distortion)


def turned(calibration):
    """Return the rig with the projector above the camera instead of beside it."""
    quarter = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return replace(calibration, T_projector_camera=quarter @ calibration.T_projector_camera @ quarter.T)


@pytest.mark.parametrize("distortion", [False, True])
@pytest.mark.parametrize("initial", [0.0, 0.7])
def test_points_are_exact_with_both_lenses_distorted(distortion, initial):
    calibration = small_rig(distortion=distortion)
    xyz = points(calibration, relief())
    result = run(Triangulate, {"phase": phase_map(calibration, xyz, initial=initial), "calibration": calibration})
    assert not result.rejected.any()
    # float32 phase of up to 100 rad: 4e-6 rad, times 16 px / 2 pi and 7 mm a pixel of this coarse projector.
    assert np.abs(result.xyz_mm - xyz).max() < 2e-4
    assert result.calibration == calibration.hash
    assert result.provenance.simulated


def test_strong_distortion_is_solved_to_rounding():
    calibration = small_rig()
    strong = np.array([-0.25, 0.12, 2e-3, -1e-3, 0.02])
    calibration = replace(calibration, projector=replace(calibration.projector, distortion=strong))
    xyz = points(calibration, relief())
    result = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": calibration})
    assert np.nanmax(np.abs(result.xyz_mm - xyz)) < 3e-4
    assert (result.rejected == 0).mean() > 0.999


def test_distortion_that_two_steps_of_newton_leave_is_solved_with_more():
    calibration = small_rig(projector=(256, 256))
    extreme = np.array([-0.55, 0.35, 0.02, -0.02, -0.1])
    calibration = replace(calibration, projector=replace(calibration.projector, distortion=extreme))
    camera = pinhole(calibration.camera)
    for rig, orientation in ((calibration, "columns"), (turned(calibration), "rows")):
        axis = projector_axis(pinhole(rig.projector), rig.T_projector_camera, orientation)
        assert newton_steps(camera, axis) > 2
        xyz = points(rig, relief())
        result = run(Triangulate, {"phase": phase_map(rig, xyz, orientation), "calibration": rig})
        good = result.rejected == 0
        # The lens folds the phase less than it stretches it: as exact as others where it does not.
        assert good.mean() > 0.97
        assert np.abs(result.xyz_mm - xyz)[good].max() < 1e-3
    plain = small_rig(distortion=False)
    assert newton_steps(camera, projector_axis(pinhole(plain.projector), plain.T_projector_camera, "columns")) == 1


@pytest.mark.parametrize("size", [(5, 5), (4, 3), (3, 9), (9, 3)])
def test_small_pictures_are_judged_by_the_neighbours_that_they_have(size):
    calibration = small_rig(*size)
    xyz = points(calibration, np.full(size[::-1], 1000.0))
    result = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": calibration})
    sides = [np.zeros(n, bool) for n in size]
    for kept, n in zip(sides, size, strict=True):
        kept[: max(n - 2, 0)] = kept[2:] = True  # two neighbours on one side
    assert ((result.rejected == 0) == (sides[1][:, None] & sides[0])).all()


def test_rows_measure_when_the_projector_stands_above():
    calibration = turned(small_rig(projector=(256, 256)))
    xyz = points(calibration, relief())
    result = run(Triangulate, {"phase": phase_map(calibration, xyz, "rows", 0.2), "calibration": calibration})
    assert np.abs(result.xyz_mm - xyz)[result.rejected == 0].max() < 3e-4
    assert (result.rejected == 0).mean() > 0.99


def test_deviation_is_the_phases_times_the_geometrys_sensitivity():
    calibration = small_rig()
    xyz = points(calibration, relief())
    exact = phase_map(calibration, xyz)
    rng = np.random.default_rng(5)
    noisy = replace(exact, phase_rad=(exact.phase_rad + rng.normal(0, 0.01, xyz.shape[:2])).astype(np.float32))
    result = run(Triangulate, {"phase": noisy, "calibration": calibration}, keep_flyers=True)
    along = np.linalg.norm(result.xyz_mm - xyz, axis=2)
    assert np.sqrt(np.mean((along / result.sigma_mm) ** 2)) == pytest.approx(1.0, rel=0.03)  # 19,200 samples: 0.5 %


def test_flyers_between_two_surfaces_are_dropped_and_the_surfaces_stay():
    calibration = small_rig()
    depth = np.where(np.arange(160) < 80, 1000.0, 960.0) + np.zeros((120, 1))
    depth[:, 80] = 985.0  # mixed
    depth[40, 20] = 950.0
    xyz = points(calibration, depth)
    result = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": calibration})
    assert (result.rejected[:, 80] == Reject.DISCONTINUITY).all()
    assert result.rejected[40, 20] == Reject.DISCONTINUITY
    rest = np.ones(depth.shape, bool)
    rest[:, 80] = rest[40, 20] = False
    assert (result.rejected[rest] == 0).mean() > 0.999
    kept = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": calibration}, keep_flyers=True)
    assert not kept.rejected.any()


def test_steep_surfaces_are_kept():
    calibration = small_rig()
    depth = 1000 - 2.5 * 4.0 * np.abs(np.arange(160) - 80.0) / 2 + np.zeros((120, 1))  # 63 degrees, 2.5 mm a pixel
    result = run(Triangulate, {"phase": phase_map(calibration, points(calibration, depth)), "calibration": calibration})
    assert (result.rejected == 0).mean() > 0.97  # the ridge itself bends


def test_depths_outside_the_range_are_dropped():
    calibration = small_rig()
    xyz = points(calibration, relief())
    result = run(
        Triangulate, {"phase": phase_map(calibration, xyz), "calibration": calibration},
        min_depth_mm=980.0, max_depth_mm=1003.0,
    )  # fmt: skip
    outside = (xyz[..., 2] < 980) | (xyz[..., 2] > 1003)
    assert outside.any()
    assert (result.rejected[outside] & Reject.OUT_OF_RANGE).all()
    assert np.isnan(result.xyz_mm[outside]).all()


def test_masks_are_carried_and_intensity_is_scaled_to_white():
    calibration = small_rig()
    xyz = points(calibration, relief())
    phase = phase_map(calibration, xyz)
    rejected, values = np.zeros(xyz.shape[:2], np.uint16), phase.phase_rad.copy()
    rejected[10:20, 10:20], values[10:20, 10:20] = Reject.SATURATED, np.nan
    light = np.full(xyz.shape[:2], 40, np.float32)
    light[:, 80:] = 80
    result = run(
        Triangulate,
        {"phase": replace(phase, rejected=rejected, phase_rad=values, background=light), "calibration": calibration},
    )
    assert (result.rejected[10:20, 10:20] == Reject.SATURATED).all()
    assert np.isnan(result.xyz_mm[10:20, 10:20]).all() and np.isnan(result.sigma_mm[10:20, 10:20]).all()
    assert result.intensity[50, 20] == 128 and result.intensity[50, 100] == 255


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "wrapped"}, "takes an absolute phase; this one is wrapped"),
        ({"projector_px": 1024}, "a projector of 1024 columns"),
    ],
)
def test_phases_of_another_kind_or_projector_are_refused(change, message):
    calibration = small_rig()
    phase = phase_map(calibration, points(calibration, relief()), **change)
    with pytest.raises(DataError, match=message):
        run(Triangulate, {"phase": phase, "calibration": calibration})


def test_calibration_of_another_camera_is_refused():
    calibration = small_rig()
    phase = phase_map(calibration, points(calibration, relief()))
    with pytest.raises(DataError, match="160 x 120 px, the calibration's camera 200 x 150"):
        run(Triangulate, {"phase": phase, "calibration": small_rig(200, 150)})


def renamed(phase, rig, **provenance):
    return replace(phase, provenance=replace(phase.provenance, rig=rig, **provenance))


def test_phase_of_another_rig_is_refused_unless_both_names_are_said_to_mean_one():
    calibration = small_rig()
    phase = renamed(phase_map(calibration, points(calibration, relief())), "bench 7")
    inputs = {"phase": phase, "calibration": calibration}
    with pytest.raises(DataError, match=r"taken by the rig 'bench 7', the calibration [0-9a-f]+ is of 'test'"):
        run(Triangulate, inputs)
    assert not run(Triangulate, inputs, any_rig=True).rejected.any()
    assert not run(Triangulate, inputs | {"phase": renamed(phase, "test")}).rejected.any()
    for unnamed in ({"phase": renamed(phase, "")}, {"calibration": replace(calibration, rig="")}):
        assert not run(Triangulate, inputs | unnamed).rejected.any()
    plane = replace(difference_map(calibration, points(calibration, relief())), provenance=phase.provenance)
    with pytest.raises(DataError, match="bench 7"):
        run(ReferencePlane, inputs | {"phase": plane})


def test_replayed_phase_of_another_rig_is_taken_with_a_warning():
    calibration, context = small_rig(), RecordingContext()
    phase = renamed(phase_map(calibration, points(calibration, relief())), "bench 7", replayed=True)
    Triangulate().run({"phase": phase, "calibration": calibration}, Triangulate.Params(), context)
    [(level, text)] = context.logged
    assert level == "warning" and "'bench 7'" in text and "'test'" in text


def test_fringes_along_the_baseline_are_refused():
    calibration = small_rig()
    phase = phase_map(calibration, points(calibration, relief()), "rows")
    with pytest.raises(DataError, match="project fringes along columns"):
        run(Triangulate, {"phase": phase, "calibration": calibration})


def test_impossible_calibrations_are_refused():
    calibration = small_rig()
    phase = phase_map(calibration, points(calibration, relief()))
    with pytest.raises(DataError, match="no rotation"):
        run(Triangulate, {"phase": phase, "calibration": replace(calibration, T_projector_camera=np.ones((4, 4)))})
    sheared = calibration.projector.matrix.copy()
    sheared[0, 1] = 5.0
    lens = Lens(256, 192, sheared, np.zeros(5))
    with pytest.raises(DataError, match="shear"):
        run(Triangulate, {"phase": phase, "calibration": replace(calibration, projector=lens)})


def test_everything_masked_gives_nothing_and_no_crash():
    calibration = small_rig()
    empty = np.full((120, 160), np.nan, np.float32)
    phase = phase_map(calibration, points(calibration, relief()), phase_rad=empty,
                      rejected=np.ones((120, 160), np.uint16))  # fmt: skip
    result = run(Triangulate, {"phase": phase, "calibration": calibration})
    assert np.isnan(result.xyz_mm).all()


def test_camera_rays_invert_the_distortion():
    lens = small_rig().camera
    assert np.abs(camera_rays(pinhole(lens)) - np.moveaxis(rays(lens), 2, 0)).max() < 3e-8  # float32 of 0.2


def difference_map(calibration, xyz, periods_off=0):
    plane = points(calibration, plane_depth(pinhole(calibration.camera), calibration.reference_plane))
    body, reference = phase_map(calibration, xyz), phase_map(calibration, plane)
    difference = body.phase_rad.astype(float) - reference.phase_rad + 2 * np.pi * periods_off
    return replace(body, phase_rad=difference.astype(np.float32), kind="relative")


@pytest.mark.parametrize("periods_off", [0, 3, -2])
def test_object_apart_from_its_plane_is_put_where_the_rig_is_aimed(periods_off):
    calibration = small_rig(plane_mm=1250.0)
    xyz = points(calibration, relief())
    result = run(ReferencePlane, {"phase": difference_map(calibration, xyz, periods_off), "calibration": calibration})
    assert np.abs(result.xyz_mm - xyz)[result.rejected == 0].max() < 1e-3
    assert (result.rejected == 0).all()


def test_plane_in_view_fixes_the_multiple_of_two_pi():
    calibration = small_rig(plane_mm=1040.0)
    y, x = np.mgrid[0:120, 0:160]
    depth = 1040 - 60 * np.clip(1 - ((x - 80) / 50) ** 2 - ((y - 60) / 40) ** 2, 0, 1)
    xyz = points(calibration, depth)
    result = run(
        ReferencePlane, {"phase": difference_map(calibration, xyz), "calibration": calibration}, expected_depth_mm=900.0
    )
    assert np.abs(result.xyz_mm - xyz)[result.rejected == 0].max() < 1e-3


def test_expected_depth_and_offset_choose_the_period():
    calibration = small_rig(plane_mm=1250.0)
    xyz = points(calibration, relief() - 200)
    phase = difference_map(calibration, xyz, 1)
    result = run(ReferencePlane, {"phase": phase, "calibration": calibration}, expected_depth_mm=800.0)
    assert np.abs(result.xyz_mm - xyz)[result.rejected == 0].max() < 1e-3
    moved = run(ReferencePlane, {"phase": phase, "calibration": calibration}, expected_depth_mm=800.0, offset_periods=1)
    assert np.nanmedian(np.abs(moved.xyz_mm[..., 2] - xyz[..., 2])) > 10


def logged(calibration, xyz, **params):
    context = RecordingContext()
    inputs = {"phase": difference_map(calibration, xyz), "calibration": calibration}
    return ReferencePlane().run(inputs, ReferencePlane.Params(**params), context), context.logged


def test_guessed_period_is_told_with_its_size_in_depth():
    calibration = small_rig(plane_mm=1250.0)
    xyz = points(calibration, relief())
    result, logs = logged(calibration, xyz)
    [(level, text)] = logs
    assert level == "warning" and "Set expected_depth_mm" in text and "100% of the pixels" in text
    step = float(re.search(r"multiples of ([0-9.]+) mm", text)[1])
    inputs = {"phase": difference_map(calibration, xyz), "calibration": calibration}
    moved = [run(ReferencePlane, inputs, offset_periods=n).xyz_mm[..., 2] for n in (-1, 1)]
    assert step == pytest.approx(abs(np.nanmedian(moved[1] - moved[0])) / 2, rel=0.05)
    assert np.isfinite(result.xyz_mm).all()


def test_period_that_the_user_or_the_plane_decides_is_no_warning():
    calibration = small_rig(plane_mm=1250.0)
    _, logs = logged(calibration, points(calibration, relief()), expected_depth_mm=1000.0)
    assert [level for level, _ in logs] == ["info"]
    calibration = small_rig(plane_mm=1040.0)
    y, x = np.mgrid[0:120, 0:160]
    bump = 1040 - 60 * np.clip(1 - ((x - 80) / 50) ** 2 - ((y - 60) / 40) ** 2, 0, 1)
    assert logged(calibration, points(calibration, bump))[1] == []


def test_reference_plane_needs_a_plane_and_a_difference():
    calibration = small_rig()
    xyz = points(calibration, relief())
    planeless = replace(calibration, reference_plane=None)
    with pytest.raises(DataError, match="no reference plane"):
        run(ReferencePlane, {"phase": difference_map(calibration, xyz), "calibration": planeless})
    with pytest.raises(DataError, match="takes a relative phase"):
        run(ReferencePlane, {"phase": phase_map(calibration, xyz), "calibration": calibration})


def test_textbook_formula_agrees_with_the_full_geometry_where_it_holds():
    # Pinholes side by side, both looking straight at the plane: fringes on the plane are evenly spaced.
    baseline, distance = 250.0, 1000.0
    calibration = small_rig(distortion=False, plane_mm=distance)
    transform = np.eye(4)
    transform[0, 3] = -baseline
    calibration = replace(calibration, T_projector_camera=transform)
    heights = 50 * np.exp(-(((np.arange(160) - 80.0) / 40) ** 2)) + np.zeros((120, 1))
    axis = projector_axis(pinhole(calibration.projector), transform, "columns")
    camera = pinhole(calibration.camera)
    body = phase_at_depth(camera, axis, (PERIOD, 0.0), distance - heights)
    plane = phase_at_depth(camera, axis, (PERIOD, 0.0), np.full((120, 160), distance))
    frequency = calibration.projector.matrix[0, 0] / distance / PERIOD
    # The projector stands at +x: nearer points lie at lower columns, so heights make the difference negative.
    got = height_from_difference(plane - body, distance, baseline, frequency)
    assert np.abs(got - heights).max() < 1e-6


def test_optical_axes_cross_where_the_rig_is_aimed():
    assert axes_crossing_mm(small_rig().T_projector_camera) == pytest.approx(1000.0)
    with pytest.raises(ValueError, match="parallel"):
        axes_crossing_mm(np.eye(4))


def test_points_that_deviate_much_more_than_most_are_dropped():
    calibration = small_rig()
    xyz = points(calibration, relief())
    sigma = np.full(xyz.shape[:2], 0.01, np.float32)
    sigma[30:40, 50:60] = 0.1
    inputs = {"phase": phase_map(calibration, xyz, sigma_rad=sigma), "calibration": calibration}
    result = run(Triangulate, inputs)
    assert (result.rejected[30:40, 50:60] == Reject.LOW_MODULATION).all()
    assert np.isnan(result.xyz_mm[30:40, 50:60]).all()
    assert (result.rejected > 0).sum() == 100
    assert not run(Triangulate, inputs, keep_flyers=True).rejected.any()
