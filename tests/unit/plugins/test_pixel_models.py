"""Models of each pixel, fitted to planes at known places, against the points of the plain formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fringe_truth import points, rays, run, small_rig
from test_triangulate import PERIOD, phase_map, pinhole, relief, renamed, turned

from fringed.data import Reject, ViewFit
from fringed.errors import DataError
from fringed.testing import RecordingContext
from fringed_plugins.calibration.pixel.fit import Planes, fit_rational
from fringed_plugins.calibrators.pixel_models import FitPixelModel
from fringed_plugins.triangulation_plugin import Triangulate

DEPTHS = tuple(np.linspace(930.0, 1040.0, 7))
FORMS = [
    ({"form": "rational"}, 0.01),
    ({"form": "polynomial", "degree": 4}, 0.01),
    ({"form": "height"}, 0.01),
]


def plane_points(calibration, plane):
    """Return the points (height, width, 3) of a plane n . X = d on every camera ray."""
    xy = rays(calibration.camera)
    return points(calibration, plane[3] / (xy @ np.array(plane[:2]) + plane[2]))


def taken(calibration, planes, orientation="columns", noise_rad=0.0, **fields):
    rng = np.random.default_rng(1)
    maps = []
    for plane in planes:
        phase = phase_map(calibration, plane_points(calibration, plane), orientation, **fields)
        noisy = phase.phase_rad + rng.normal(0, 1, phase.phase_rad.shape) * noise_rad
        maps.append(
            replace(phase, phase_rad=noisy.astype(np.float32), sigma_rad=np.full(noisy.shape, noise_rad, np.float32))
        )
    return tuple(maps)


def across(depths):
    return [(0.0, 0.0, 1.0, float(depth)) for depth in depths]


def fitted(calibration, maps=None, orientation="columns", **params):
    params = {"depths_mm": DEPTHS} | params if "planes" not in params and "poses" not in params else params
    maps = maps or taken(calibration, across(DEPTHS), orientation)
    return run(FitPixelModel, {"phases": maps, "calibration": calibration}, **params)


@pytest.mark.parametrize("orientation", ["columns", "rows"])
@pytest.mark.parametrize(("params", "most_mm"), FORMS)
def test_points_agree_with_the_truth_and_with_the_stereo_model_between_the_planes(params, most_mm, orientation):
    calibration = small_rig()
    if orientation == "rows":
        calibration = turned(small_rig(projector=(256, 256)))
    known = fitted(calibration, orientation=orientation, **params)
    assert known.model == "pixel" and known.hash != calibration.hash and known.pixel_model.form == params["form"]
    xyz = points(calibration, relief())
    phase = phase_map(calibration, xyz, orientation, 0.4)
    found = run(Triangulate, {"phase": phase, "calibration": known})
    stereo = run(Triangulate, {"phase": phase, "calibration": calibration})
    good = (found.rejected == 0) & (stereo.rejected == 0)
    assert good.mean() > 0.99
    assert np.abs(found.xyz_mm - xyz)[good].max() < most_mm
    assert np.abs(found.xyz_mm - stereo.xyz_mm)[good].max() < most_mm
    # The deviation by noise is that of the same geometry; the models are exact here, so that little is added.
    assert np.abs(found.sigma_mm / stereo.sigma_mm - 1)[good].max() < 0.01
    assert found.calibration == known.hash


def test_rational_model_is_exact_without_distortion_of_the_projector():
    calibration = small_rig()
    calibration = replace(calibration, projector=replace(calibration.projector, distortion=np.zeros(5)))
    known = fitted(calibration, taken(calibration, across((850.0, 1000.0, 1150.0))), depths_mm=(850.0, 1000.0, 1150.0))
    depth = 1000 + 100 * np.sin(np.arange(160) / 25) + np.zeros((120, 1))
    xyz = points(calibration, depth)
    found = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": known})
    assert (found.rejected == 0).all()
    # float32 phases of 100 rad in the planes and in the scene, 7 mm a pixel of this coarse projector.
    assert np.abs(found.xyz_mm - xyz).max() < 1e-3


def test_planes_may_be_tilted_and_given_by_the_boards_poses():
    calibration, rng = small_rig(), np.random.default_rng(2)
    views, planes = [], []
    for number, depth in enumerate(DEPTHS):
        tilt = np.radians(rng.uniform(-12, 12, 2))
        turn_x = np.array([[1, 0, 0], [0, np.cos(tilt[0]), -np.sin(tilt[0])], [0, np.sin(tilt[0]), np.cos(tilt[0])]])
        turn_y = np.array([[np.cos(tilt[1]), 0, np.sin(tilt[1])], [0, 1, 0], [-np.sin(tilt[1]), 0, np.cos(tilt[1])]])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn_x @ turn_y, (rng.uniform(-20, 20), rng.uniform(-20, 20), depth)
        none = np.zeros((0, 2))
        views.append(
            ViewFit(f"id-{number}", pose, none, none, none, none, np.zeros(0, np.uint8), name=f"pose {number}")
        )
        normal = pose[:3, :3] @ [0, 0, 1]
        planes.append((*normal, float(normal @ pose[:3, 3])))
    calibration = replace(calibration, views=tuple(views))
    maps = taken(calibration, planes)
    by_pose = fitted(calibration, maps, poses=tuple(f"pose {n}" for n in range(7)))
    by_equation = fitted(calibration, maps, planes=tuple(tuple(map(float, plane)) for plane in planes))
    assert np.array_equal(by_pose.pixel_model.coefficients, by_equation.pixel_model.coefficients)
    assert by_pose.views == calibration.views
    xyz = points(calibration, 985 + 10 * np.sin(np.arange(160) / 20) + np.zeros((120, 1)))
    found = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": by_pose})
    assert (found.rejected == 0).mean() > 0.95
    assert np.abs(found.xyz_mm - xyz)[found.rejected == 0].max() < 0.02  # some pixels look a little past their planes
    with pytest.raises(DataError, match="no view pose 7, pose 8, pose 9; its views are pose 0"):
        fitted(calibration, maps, poses=tuple(f"pose {n}" for n in range(3, 10)))


@pytest.mark.parametrize("whole_rig", [False, True])
def test_height_model_finds_the_constants_of_the_thesis_in_the_ideal_rig(whole_rig):
    calibration, transform = small_rig(distortion=False), np.eye(4)
    transform[0, 3] = -250.0
    calibration = replace(calibration, T_projector_camera=transform, reference_plane=None)
    calibration = replace(calibration, projector=replace(calibration.projector, width_px=512))
    known = fitted(calibration, form="height", whole_rig=whole_rig)
    assert known.reference_plane == pytest.approx([0, 0, -1, -1040.0])
    distance, product, _ = known.pixel_model.coefficients
    frequency = calibration.projector.matrix[0, 0] / 1040.0 / PERIOD
    expected = 2 * np.pi * frequency * 250.0
    # The projector stands at +x: heights make the difference negative, so that L d / (d + K) has a negative K.
    assert np.median(distance) == pytest.approx(1040.0, rel=1e-3)
    assert np.median(product) == pytest.approx(-expected, rel=1e-3)
    if whole_rig:
        facts = known.residuals
        assert facts["pixel_L_mm"] == pytest.approx(1040.0, rel=1e-4)
        assert facts["pixel_D_mm"] == pytest.approx(250.0, rel=1e-3)
        assert facts["pixel_f0_per_mm"] == pytest.approx(frequency, rel=1e-4)
        assert np.ptp(distance) == np.ptp(product) == 0
    xyz = points(calibration, relief())
    found = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": known})
    assert np.abs(found.xyz_mm - xyz)[found.rejected == 0].max() < 3e-3


def test_one_formula_for_all_pixels_of_a_crossed_rig_says_how_wrong_it_is():
    calibration = small_rig()
    known = fitted(calibration, form="height", whole_rig=True)
    everywhere = replace(known, pixel_model=replace(known.pixel_model, z_range_mm=(500.0, 1500.0)))
    offs = []
    for depth in DEPTHS:
        xyz = points(calibration, np.full((120, 160), depth))
        found = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": everywhere}, keep_flyers=True)
        offs.append((found.xyz_mm - xyz)[found.rejected == 0])
    wrong = np.sqrt(np.mean(np.sum(np.concatenate(offs) ** 2, axis=-1)))
    assert wrong > 0.5
    assert known.pixel_model.sigma_mm == pytest.approx(wrong, rel=0.02)


def test_stated_deviation_is_the_scatter_of_points_with_noise_in_planes_and_scene():
    calibration, rng = small_rig(), np.random.default_rng(4)
    maps = taken(calibration, across(DEPTHS), noise_rad=0.01)
    known = fitted(calibration, maps)
    xyz = points(calibration, np.full((120, 160), 985.0))
    exact = phase_map(calibration, xyz)
    noisy = replace(exact, phase_rad=(exact.phase_rad + rng.normal(0, 0.01, xyz.shape[:2])).astype(np.float32))
    found = run(Triangulate, {"phase": noisy, "calibration": known}, keep_flyers=True)
    along = np.linalg.norm(found.xyz_mm - xyz, axis=2)
    # In the middle of the planes a curve is better known than on average; 19,200 pixels leave 0.5 %.
    assert np.sqrt(np.mean((along / found.sigma_mm) ** 2)) == pytest.approx(1.0, abs=0.10)
    assert known.residuals["pixel_scatter_mm"] > known.residuals["pixel_sigma_mm"] > 0


def test_a_wrong_order_of_one_plane_is_left_out_at_its_pixels():
    calibration = small_rig()
    maps = list(taken(calibration, across(DEPTHS), noise_rad=0.002))
    wrong = maps[4].phase_rad.copy()
    wrong[20:60, 30:90] += np.float32(2 * np.pi)
    maps[4] = replace(maps[4], phase_rad=wrong)
    known = fitted(calibration, tuple(maps))
    xyz = points(calibration, relief())
    found = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": known})
    assert (found.rejected == 0).mean() > 0.99
    assert np.abs(found.xyz_mm - xyz)[found.rejected == 0].max() < 0.15  # noise of 0.002 rad is 0.035 mm here
    # Without planes to spare nobody can tell which one is wrong: those pixels become holes, and are no wrong points.
    few = run(
        FitPixelModel, {"phases": tuple(maps[1:5]), "calibration": calibration}, depths_mm=DEPTHS[1:5]
    )  # fmt: skip
    assert np.isnan(few.pixel_model.coefficients[:, 20:60, 30:90]).all()
    assert np.isfinite(few.pixel_model.coefficients[:, 70:, :]).all()


def test_pixels_that_saw_too_few_planes_are_holes_and_others_use_what_they_saw():
    calibration = small_rig()
    maps = list(taken(calibration, across(DEPTHS)))
    for number in range(5):
        rejected = maps[number].rejected.copy()
        rejected[:, :40] = Reject.LOW_MODULATION
        maps[number] = replace(maps[number], rejected=rejected)
    known = fitted(calibration, tuple(maps))
    assert np.isnan(known.pixel_model.coefficients[:, :, :40]).all()
    xyz = points(calibration, relief())
    found = run(Triangulate, {"phase": phase_map(calibration, xyz), "calibration": known})
    assert (found.rejected[:, :40] & Reject.OUT_OF_RANGE).all()
    assert np.abs(found.xyz_mm - xyz)[found.rejected == 0].max() < 0.01


def test_points_beyond_the_planes_are_not_made_up():
    calibration = small_rig()
    known = fitted(calibration)
    assert known.pixel_model.z_range_mm == pytest.approx((930.0, 1040.0))
    depth = np.where(np.arange(160) < 80, 985.0, 1060.0) + np.zeros((120, 1))
    found = run(Triangulate, {"phase": phase_map(calibration, points(calibration, depth)), "calibration": known})
    assert (found.rejected[:, 85:] == Reject.OUT_OF_RANGE).all()
    assert (found.rejected[:, 5:75] == 0).all()


def test_fringes_of_another_period_and_start_use_the_same_model():
    calibration = small_rig()
    known = fitted(calibration)
    xyz = points(calibration, relief())
    plain = phase_map(calibration, xyz)
    pixel = plain.phase_rad.astype(float) * PERIOD / (2 * np.pi)
    other = replace(
        plain, phase_rad=(pixel * 2 * np.pi / 24.0 - 1.3).astype(np.float32), period_px=24.0, initial_phase_rad=-1.3
    )
    found = run(Triangulate, {"phase": other, "calibration": known})
    assert np.abs(found.xyz_mm - xyz)[found.rejected == 0].max() < 0.01
    maps = list(taken(calibration, across(DEPTHS)))
    maps[2] = replace(
        maps[2],
        phase_rad=(maps[2].phase_rad * (PERIOD / 20.0) + 0.5).astype(np.float32),
        period_px=20.0,
        initial_phase_rad=0.5,
    )
    mixed = fitted(calibration, tuple(maps))
    found = run(Triangulate, {"phase": plain, "calibration": mixed})
    assert np.abs(found.xyz_mm - xyz)[found.rejected == 0].max() < 0.01


def test_fit_tells_how_good_it_is_or_that_nothing_tells():
    calibration, context = small_rig(), RecordingContext()
    inputs = {"phases": taken(calibration, across(DEPTHS)), "calibration": calibration}
    FitPixelModel().run(inputs, FitPixelModel.Params(depths_mm=DEPTHS), context)
    assert [level for level, _ in context.logged] == ["info"] and "100.0% of the pixels" in context.logged[0][1]
    context = RecordingContext()
    inputs = {"phases": taken(calibration, across((950.0, 1000.0, 1030.0))), "calibration": calibration}
    exact = FitPixelModel().run(inputs, FitPixelModel.Params(depths_mm=(950.0, 1000.0, 1030.0)), context)
    assert [level for level, _ in context.logged] == ["warning"]
    assert "pixel_scatter_mm" not in exact.residuals


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"depths_mm": ()}, "given by nothing; give one of"),
        ({"depths_mm": DEPTHS, "poses": ("a",)}, "given by depths_mm and poses"),
        ({"depths_mm": DEPTHS[:4]}, "7 phases, and 4 depths_mm"),
        ({"depths_mm": (1000.0,) * 7}, "stand at 1 different depths"),
        ({"depths_mm": DEPTHS[:2], "count": 2}, "2 planes; a rational model of each pixel takes 3"),
        (
            {"depths_mm": DEPTHS[:4], "count": 4, "form": "polynomial"},
            "polynomial of degree 4 model of each pixel takes 5",
        ),
    ],
)
def test_planes_that_are_missing_or_too_few_are_refused(params, message):
    calibration = small_rig()
    params = dict(params)
    maps = taken(calibration, across(DEPTHS))[: params.pop("count", 7)]
    with pytest.raises(DataError, match=message):
        run(FitPixelModel, {"phases": maps, "calibration": calibration}, **params)


def test_phases_that_are_not_alike_are_refused():
    calibration = small_rig()
    maps = taken(calibration, across(DEPTHS))
    for change, message in (
        ({"kind": "wrapped"}, "phase of plane 7 is wrapped"),
        ({"orientation": "rows", "projector_px": 192}, "plane 7 counts rows, that of the first one columns"),
    ):
        with pytest.raises(DataError, match=message):
            fitted(calibration, (*maps[:6], replace(maps[6], **change)))
    with pytest.raises(DataError, match="'bench 7'"):
        fitted(calibration, (*maps[:6], renamed(maps[6], "bench 7")))
    with pytest.raises(DataError, match="160 x 120 px, the calibration's camera 200 x 150"):
        fitted(small_rig(200, 150), maps)


def test_model_of_another_direction_or_picture_is_refused_by_triangulation():
    calibration = small_rig()
    known = fitted(calibration)
    phase = phase_map(calibration, points(calibration, relief()))
    rows = replace(phase, orientation="rows", projector_px=192)
    with pytest.raises(DataError, match="fringes that count columns, these count rows"):
        run(Triangulate, {"phase": rows, "calibration": known})
    cut = replace(known.pixel_model, coefficients=known.pixel_model.coefficients[:, :100])
    with pytest.raises(DataError, match="pixel model has 160 x 100 px, the phase map 160 x 120"):
        run(Triangulate, {"phase": phase, "calibration": replace(known, pixel_model=cut)})


def test_pictures_of_another_size_are_refused_by_the_fit():
    calibration = small_rig()
    with pytest.raises(ValueError, match=r"3 planes and phases of shape \(3, 5, 5\)"):
        fit_rational(Planes(np.zeros((3, 5, 5), np.float32), np.ones((3, 4))), pinhole(calibration.camera))
