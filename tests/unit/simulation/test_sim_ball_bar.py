"""The two spheres of a ball bar, their truth and their shadows, against geometry worked out by hand."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from fringed.config.simulated import SimulationConfig
from fringed.errors import ConfigurationError
from fringed.simulation.rig import SimulatedRig

RADIUS, SPACING = 25.0, 150.0


def rig_of(rotation=(0.0, 0.0, 0.0), **options):
    scene = {"object": "ball-bar", "options": options, "rotation_deg": rotation, "backdrop": "none"}
    table = {"real_time": False, "sensor": {"width_px": 348, "height_px": 260}, "scene": scene}
    return SimulatedRig(msgspec.convert(table, SimulationConfig))


def centres(truth):
    ends = np.array([[-SPACING / 2, 0, 0], [SPACING / 2, 0, 0]])
    return ends @ truth.T_camera_object[:3, :3].T + truth.T_camera_object[:3, 3]


def distances(truth):
    """Return how far each visible point (n, 3) is from both centres, (n, 2)."""
    points = truth.xyz_mm[truth.visible == 1].astype(float)
    return np.linalg.norm(points[:, None] - centres(truth), axis=-1), points


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (10.0, 35.0, 50.0)])
def test_both_spheres_are_exact_and_stand_where_the_pose_says(rotation):
    truth = rig_of(rotation).truth()
    far, points = distances(truth)
    assert np.abs(far.min(axis=1) - RADIUS).max() < 1e-3
    counts = np.bincount(far.argmin(axis=1), minlength=2)
    assert counts.min() > 500
    # What a camera sees of a sphere is the cap in front of the circle where its rays touch.
    middle = centres(truth)[far.argmin(axis=1)]
    assert (((points - middle) * points).sum(axis=1) < 1e-2).all()


def test_one_sphere_shades_the_other_and_none_shades_itself():
    rig = rig_of((0.0, 60.0, 0.0))
    truth = rig.truth()
    far, points = distances(truth)
    lit = truth.lit[truth.visible == 1] == 1
    T = rig.calibration().T_projector_camera
    light = -T[:3, :3].T @ T[:3, 3]
    near, behind = centres(truth)[::-1]
    assert near[2] < behind[2]
    own = np.where((far.argmin(axis=1) == 1)[:, None], near, behind)
    facing = ((points - own) * (light - points)).sum(axis=1)
    path = points - light
    along = np.clip(((near - light) * path).sum(axis=1) / (path**2).sum(axis=1), 0, 1)
    miss = np.linalg.norm(light + along[:, None] * path - near, axis=1)
    shaded = (far.argmin(axis=1) == 0) & (miss < RADIUS)
    on_near = far.argmin(axis=1) == 1
    clear = (np.abs(facing) > 1.0) & (on_near | (np.abs(miss - RADIUS) > 1e-2))  # a float32 point is no better
    assert (lit == ((facing > 0) & ~shaded))[clear].all()
    assert (shaded & (facing > 0)).sum() > 100 and (lit & ~on_near).sum() > 100


def test_spheres_that_overlap_are_refused():
    with pytest.raises(ConfigurationError, match="spacing_mm has to be at least 60"):
        rig_of(radius_mm=30.0, spacing_mm=59.0)
    with pytest.raises(ConfigurationError, match="radius_mm"):
        rig_of(radius_mm=-1.0)
