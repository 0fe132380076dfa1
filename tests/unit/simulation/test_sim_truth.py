"""The simulator's truth against geometry worked out by hand, on a small sensor."""

import msgspec
import numpy as np
import pytest

from fringed.config import SimulationConfig
from fringed.config.simulated import SceneConfig
from fringed.data import CameraSettings, Mesh, PatternFrame, PatternSequence
from fringed.simulation import optics
from fringed.simulation.rig import SimulatedRig

SMALL = msgspec.convert(
    {"real_time": False, "sensor": {"width_px": 232, "height_px": 174}, "scene": {"object": "plane"}}, SimulationConfig
)
WHITE = PatternSequence("white", 1024, 768, (PatternFrame("flat"),), (np.full((1, 1, 1), 255, np.uint8),))


def rig_with(**scene):
    config = msgspec.structs.replace(SMALL, scene=msgspec.convert(scene, SceneConfig))
    return SimulatedRig(config)


def rays(truth):
    return truth.xyz_mm[..., :2].astype(float) / truth.xyz_mm[..., 2:].astype(float)


def test_a_turned_plane_is_where_the_ray_meets_it():
    truth = rig_with(object="plane", rotation_deg=[12.0, -20.0, 5.0], translation_mm=[3.0, -4.0, 25.0]).truth()
    T = truth.T_camera_object
    normal, through = T[:3, 2], T[:3, 3]
    distance = (truth.xyz_mm.astype(float) - through) @ normal
    assert truth.is_object.all()
    assert np.abs(distance).max() < 1e-3


def test_points_are_on_the_rays_of_their_pixels():
    rig = rig_with(object="plane", rotation_deg=[12.0, -20.0, 5.0])
    pixels = optics.project(rig.calibration().camera, rig.truth().xyz_mm)
    rows, columns = np.mgrid[:174, :232]
    assert np.abs(pixels - np.stack([columns, rows], axis=-1)).max() < 1e-3


def test_a_sphere_is_exact():
    rig = rig_with(object="sphere", options={"radius_mm": 60.0}, translation_mm=[10.0, 5.0, -20.0], backdrop="none")
    truth = rig.truth()
    seen = truth.visible == 1
    centre = truth.T_camera_object[:3, 3]
    radius = np.linalg.norm(truth.xyz_mm[seen].astype(float) - centre, axis=-1)
    assert np.abs(radius - 60).max() < 1e-3
    assert np.isnan(truth.xyz_mm[~seen]).all()
    # Which pixels see it: those whose ray passes the centre closer than the radius.
    lens = rig.calibration().camera
    directions = np.dstack([*_rays(lens), np.ones((174, 232))])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    miss = np.linalg.norm(np.cross(directions, centre), axis=-1)
    assert ((miss < 60) == seen).all()


def _rays(lens):
    """Let OpenCV invert the distortion."""
    import cv2

    rows, columns = np.mgrid[: lens.height_px, : lens.width_px].astype(float)
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    flat = cv2.undistortPoints(pixels, lens.matrix, lens.distortion, None, None, None, criteria)
    return flat[:, 0, 0].reshape(rows.shape), flat[:, 0, 1].reshape(rows.shape)


def test_steps_have_their_heights():
    heights = [5.0, 12.5, 30.0]
    options = {"heights_mm": heights, "tread_mm": 60.0, "depth_mm": 150.0}
    truth = rig_with(object="steps", options=options, backdrop="none").truth()
    seen = truth.is_object == 1
    height = 1000.0 - truth.xyz_mm[..., 2][seen].astype(float)
    x = truth.xyz_mm[..., 0][seen].astype(float)
    for index, wanted in enumerate(heights):
        on_tread = np.abs(x - (-60 + 60 * index)) < 29
        top = on_tread & (np.abs(height - wanted) < 1.0)
        assert top.sum() > 1000
        assert np.abs(height[top] - wanted).max() < 1e-3
        assert top.sum() == on_tread.sum()


def test_the_projector_pixel_is_the_projection_of_the_point():
    rig = rig_with(object="sphere", backdrop="grey")
    truth, calibration = rig.truth(), rig.calibration()
    T = calibration.T_projector_camera
    pixels = optics.project(calibration.projector, truth.xyz_mm.astype(float) @ T[:3, :3].T + T[:3, 3])
    seen = truth.visible == 1
    assert np.abs(pixels - truth.projector_px)[seen].max() < 2e-3


def test_a_sphere_throws_its_shadow_on_the_backdrop_away_from_the_projector():
    rig = rig_with(object="sphere", backdrop="grey", backdrop_distance_mm=1150.0)
    truth = rig.truth()
    centre, light = truth.T_camera_object[:3, 3], np.array([SMALL.geometry.baseline_mm, 0.0, 0.0])
    wall = (truth.is_object == 0) & (truth.visible == 1)
    points = truth.xyz_mm.astype(float)
    towards = points - light
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    miss = np.linalg.norm(np.cross(towards, centre - light), axis=-1)
    u, v = truth.projector_px[..., 0], truth.projector_px[..., 1]
    inside = (u >= 0) & (u <= 1023) & (v >= 0) & (v <= 767)
    clear = np.abs(miss - 60) > 1e-3
    assert ((truth.lit == 1) == (inside & (miss > 60)))[wall & clear].all()
    shadow = wall & inside & (truth.lit == 0)
    assert shadow.sum() > 500
    assert points[shadow][:, 0].mean() < -20  # the projector stands on the right


def test_the_far_side_of_a_sphere_is_dark():
    truth = rig_with(object="sphere", backdrop="none").truth()
    centre, light = truth.T_camera_object[:3, 3], np.array([SMALL.geometry.baseline_mm, 0.0, 0.0])
    seen = truth.visible == 1
    normal = (truth.xyz_mm[seen].astype(float) - centre) / 60
    facing = (normal * (light - truth.xyz_mm[seen])).sum(axis=-1) / 1000
    clear = np.abs(facing) > 1e-5
    assert ((truth.lit[seen] == 1) == (facing > 0))[clear].all()


def test_a_meshed_wall_shades_what_the_same_analytic_geometry_says():
    corners = np.array([[-30.0, -40, 60], [30, -40, 60], [30, 40, 60], [-30, 40, 60]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    rig = SimulatedRig(SMALL, None)
    rig.set_scene(SceneConfig(object="card", backdrop="grey", backdrop_distance_mm=1100.0), mesh)
    truth = rig.truth()
    light = np.array([SMALL.geometry.baseline_mm, 0.0, 0.0])
    wall = (truth.is_object == 0) & (truth.visible == 1)
    points = truth.xyz_mm.astype(float)
    at = light + (points - light) * ((940 - 0) / points[..., 2:])  # where the light's ray passes the card's plane
    behind = (np.abs(at[..., 0]) < 30) & (np.abs(at[..., 1]) < 40)
    edge = (np.abs(np.abs(at[..., 0]) - 30) < 1e-3) | (np.abs(np.abs(at[..., 1]) - 40) < 1e-3)
    u, v = truth.projector_px[..., 0], truth.projector_px[..., 1]
    inside = (u >= 0) & (u <= 1023) & (v >= 0) & (v <= 767)
    assert ((truth.lit == 1) == (inside & ~behind))[wall & ~edge].all()
    assert (wall & inside & behind).sum() > 200


def test_the_reference_role_shows_the_plane_that_the_calibration_names():
    rig = rig_with(object="face", backdrop="grey")
    rig.load(WHITE, "reference")
    truth = rig.truth()
    normal, distance = rig.calibration().reference_plane[:3], rig.calibration().reference_plane[3]
    assert np.abs(truth.xyz_mm @ normal - distance).max() < 1e-3
    assert truth.is_object.all()
    rig.load(WHITE, "object")
    wall = (rig.truth().is_object == 0) & (rig.truth().visible == 1)
    assert np.abs(rig.truth().xyz_mm @ normal - distance)[wall].max() < 1e-3
    assert wall.mean() > 0.3


def test_an_object_turns_about_the_cameras_axes_in_the_order_x_y_z_then_moves():
    angles = [30.0, -50.0, 70.0]
    truth = rig_with(object="sphere", rotation_deg=angles, translation_mm=[1, 2, 3]).truth()
    a, b, c = np.deg2rad(angles)
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    np.testing.assert_allclose(truth.T_camera_object[:3, :3], z @ y @ x @ np.diag([1, -1, -1]), atol=1e-12)
    assert truth.T_camera_object[:3, 3] == pytest.approx([1, 2, 1003])


def test_two_poses_of_a_mesh_are_one_body():
    """The truth of one view, moved by the known transform, lies on the surface of the other."""
    options = {"formula": "20*exp(-(x**2+y**2)/2000)", "width_mm": 150, "height_mm": 150, "pitch_mm": 2.0}
    first = rig_with(object="freeform", options=options, backdrop="none").truth()
    second = rig_with(object="freeform", options=options, backdrop="none", rotation_deg=[0, 25, 0]).truth()
    for truth in (first, second):
        seen = truth.visible == 1
        inverse = np.linalg.inv(truth.T_camera_object)
        own = truth.xyz_mm[seen] @ inverse[:3, :3].T + inverse[:3, 3]
        z = 20 * np.exp(-(own[:, 0] ** 2 + own[:, 1] ** 2) / 2000)
        # facets of 2 mm on a surface whose sharpest radius is 50 mm sag by 2^2 / (4 * 50) = 0.02 mm
        assert np.abs(own[:, 2] - z).max() < 0.025


def test_a_moving_object_moves_during_the_set_and_starts_from_its_place():
    rig = rig_with(object="sphere", velocity_mm_s=[100.0, 0.0, 0.0], backdrop="none", ambient=1.0)
    settings = rig.sensor.in_force(CameraSettings())
    rig.clock.sleep(50.0)
    rig.load(WHITE, "object")
    start = rig.clock.now()
    assert rig.truth().T_camera_object[0, 3] == 0.0
    centres = []
    for elapsed in (0.0, 0.5):
        image = rig.image(start + elapsed, start + elapsed + 0.008, settings, 0).astype(float)
        bright = image > 40
        centres.append(np.nonzero(bright)[1].mean())
    per_px = 400 / 232
    assert (centres[1] - centres[0]) * per_px == pytest.approx(50, abs=3)
