"""The plan of poses: spread over picture, tilt and depth, and the same for a person and for a simulated rig."""

from __future__ import annotations

import numpy as np
import pytest

from fringed.boards import Board, points_mm
from fringed.simulation.scene import rotation
from fringed_client.calibration.poses import plan, scene_of, words

GEOMETRY = {"working_distance_mm": 1000.0, "field_mm": 400.0}
ASPECT = 1040 / 1392
BOARD = Board()


def seen(pose, board=BOARD):
    """Return the board's points (n, 3) in the camera's frame, by the simulator's own rule of rotations."""
    scene = scene_of(pose, board, GEOMETRY, ASPECT)
    return points_mm(board) @ rotation(tuple(scene["rotation_deg"])).T + np.add(scene["translation_mm"], (0, 0, 1000.0))


@pytest.mark.parametrize("count", [5, 12, 30])
def test_every_point_of_every_pose_is_in_the_picture(count):
    for pose in plan(count):
        at = seen(pose)
        assert np.abs(at[:, 0] / at[:, 2]).max() < 0.2 and np.abs(at[:, 1] / at[:, 2]).max() < 0.2 * ASPECT


def test_a_board_faces_where_its_words_say():
    for pose in plan():
        normal = pose.rotation @ (0, 0, -1)
        facing = np.rad2deg(np.arctan2(normal[1], normal[0])) % 360
        assert np.isclose(facing, pose.facing_deg % 360) or np.isclose(abs(facing - pose.facing_deg), 360)
        assert np.isclose(np.rad2deg(np.arccos(-normal[2])), pose.tilt_deg)
    assert "face right" in words(plan()[0]) and plan()[0].rotation[2, 0] > 0  # its right side is farther


def test_twelve_poses_reach_the_corners_of_the_picture_and_all_directions():
    reached = np.concatenate([seen(pose) for pose in plan()])
    x, y = reached[:, 0] / reached[:, 2] / 0.2, reached[:, 1] / reached[:, 2] / 0.2 / ASPECT
    for right in (-1, 1):
        for down in (-1, 1):
            assert ((x * right > 0.8) & (y * down > 0.8)).any()
    assert np.ptp(reached[:, 2]) > 150
    normals = np.array([pose.rotation[:, 2] for pose in plan()])
    spread = np.linalg.svd(normals - normals.mean(axis=0), compute_uv=False)
    assert spread[1] > 1.0  # both directions of tilt


def test_the_first_five_poses_differ_in_tilt_enough_for_a_calibration():
    angles = [np.rad2deg(np.arccos(np.clip(a.rotation[:, 2] @ b.rotation[:, 2], -1, 1)))
              for i, a in enumerate(plan(5)) for b in plan(5)[:i]]  # fmt: skip
    assert min(angles) > 15 and max(angles) > 45


def test_a_board_larger_than_the_field_stands_in_the_middle():
    at = seen(plan()[1], Board(pitch_mm=60.0))
    middle = (at[:, :2] / at[:, 2:]).min(axis=0) + (at[:, :2] / at[:, 2:]).max(axis=0)
    assert np.abs(middle).max() < 0.2
