"""The rig's geometry: the calibration that it hands out describes what its kernels do."""

import cv2
import msgspec
import numpy as np
import pytest

from fringed.config import SimulationConfig
from fringed.simulation import optics
from fringed.simulation.tone import response, tone_curve

CONFIG = SimulationConfig()


def test_both_axes_meet_at_the_working_distance():
    target = np.array([0.0, 0.0, CONFIG.geometry.working_distance_mm, 1.0])
    in_projector = optics.T_projector_camera(CONFIG) @ target
    assert in_projector[:2] == pytest.approx([0, 0], abs=1e-9)
    assert in_projector[2] == pytest.approx(optics.throw_mm(CONFIG))


def test_the_projector_stands_at_the_baseline():
    T = optics.T_projector_camera(CONFIG)
    assert -T[:3, :3].T @ T[:3, 3] == pytest.approx([CONFIG.geometry.baseline_mm, 0, 0], abs=1e-9)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_the_camera_sees_the_configured_field():
    lens = optics.camera_lens(CONFIG)
    width_mm = lens.width_px / lens.matrix[0, 0] * CONFIG.geometry.working_distance_mm
    assert width_mm == pytest.approx(CONFIG.geometry.field_mm)


@pytest.mark.parametrize("make", [optics.camera_lens, optics.projector_lens])
def test_projection_agrees_with_opencv(make):
    lens = make(CONFIG)
    points = np.random.default_rng(3).uniform([-150, -120, 700], [150, 120, 1300], (200, 3))
    ours = optics.project(lens, points)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.matrix, lens.distortion)
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-9)


def test_a_pixels_ray_is_the_exact_inverse_of_the_distortion():
    from fringed.simulation.lens_kernels import pixel_ray

    lens = optics.camera_lens(CONFIG)
    packed = optics.packed(lens)
    for column, row in [(0, 0), (1391, 0), (0, 1039), (1391, 1039), (700.25, 333.75)]:
        xd, yd = (column - packed[2]) / packed[0], (row - packed[3]) / packed[1]
        x, y = pixel_ray(xd, yd, (xd, yd), packed)
        assert optics.project(lens, np.array([x, y, 1.0])) == pytest.approx([column, row], abs=1e-8)


def test_the_calibrations_hash_depends_on_the_geometry_and_not_on_the_scene():
    a = optics.exact_calibration(CONFIG, "rig")
    moved = msgspec.structs.replace(CONFIG, geometry=msgspec.structs.replace(CONFIG.geometry, baseline_mm=281.0))
    other_face = msgspec.structs.replace(CONFIG, scene=msgspec.structs.replace(CONFIG.scene, object="plane"))
    assert a.source == "exact-simulated"
    assert a.hash != optics.exact_calibration(moved, "rig").hash
    assert a.hash == optics.exact_calibration(other_face, "rig").hash


@pytest.mark.parametrize("s_curve", [0.0, 0.03, 0.3])
@pytest.mark.parametrize("gamma", [1.0, 2.2, 2.6])
def test_the_tone_curve_can_be_inverted(gamma, s_curve):
    curve = tone_curve(msgspec.structs.replace(CONFIG.projector, gamma=gamma, s_curve=s_curve))
    assert curve.shape == (256,)
    assert curve[0] == 0.0
    assert curve[-1] == 1.0
    assert (np.diff(curve) > 0).all()


def test_the_s_curve_departs_from_gamma_by_what_is_configured():
    plain = (np.arange(256) / 255) ** 2.2
    curve = tone_curve(msgspec.structs.replace(CONFIG.projector, gamma=2.2, s_curve=0.03))
    assert np.abs(curve - plain).max() == pytest.approx(0.03, rel=0.1)


def test_black_is_not_dark():
    light = response(CONFIG.projector)
    assert light[0] == pytest.approx(1 / 400)
    assert light[255] == pytest.approx(1.0)
