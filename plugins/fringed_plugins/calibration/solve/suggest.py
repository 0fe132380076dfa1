"""Where to hold the board next: the pose after which points would be known best.

Owns the poses that are looked at, what each would tell, and the words; takes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.pixel.derivatives import point_derivatives
from fringed_plugins.calibration.pixel.uncertainty import grid_pixels
from fringed_plugins.calibration.reference import axes_crossing_mm
from fringed_plugins.calibration.rig import Pinhole
from fringed_plugins.calibration.solve.adjustment import Adjusted, inverse_of
from fringed_plugins.calibration.solve.observations import Observation, Rig
from fringed_plugins.calibration.solve.projection import POSE, SHARED, predicted

Float64Array = npt.NDArray[np.float64]

TILTS_DEG, FACINGS, TURNS_DEG = (0.0, 20.0, 35.0), 8, (0.0, 90.0)
DEPTHS = (0.93, 1.0, 1.07)
_PLACES = tuple((x, y) for y in (-1.0, 0.0, 1.0) for x in (-1.0, 0.0, 1.0))
_EDGE_PX = 12.0
_FITTING = 0.8  # of the points have to be in both pictures
_GRID = (5, 7)


class Suggestion(NamedTuple):
    """A pose T_camera_board (4, 4), how to hold the board, and the deviation of points (mm RMS) before and after."""

    T_camera_board: Float64Array
    words: str
    before_mm: float
    after_mm: float


class Held(NamedTuple):
    """How a board is held: a place in the picture (-1 to 1, right and down), a depth over the usual one, and angles.

    Tilted by `tilt_deg` it faces the direction `facing_deg`: 0 to the right in the picture, 90 down, 180 left.
    """

    x: float
    y: float
    depth: float
    tilt_deg: float
    facing_deg: float
    turn_deg: float


def next_pose(seen: Sequence[Observation], found: Adjusted, board_mm: Float64Array) -> Suggestion:
    """Return the pose of a board (points (n, 3) mm) that tells most of what is not yet known of points.

    Poses are compared by the variance of points over the picture and the depths of the poses so far, as the covariance
    would leave it with one pose more, its points as good as those seen (A-optimal).

    Raises
    ------
    ValueError
        no pose in which the board would be in both pictures.

    References
    ----------
    Fedorov 1972 (sequential design); Rojtberg & Kuijper 2018 (poses for calibration, one by one).
    """
    rig = found.rig
    noise = _noise(seen, found)
    weight = _points_weight(rig)
    usual = _working_mm(rig)
    before = float(np.sum(inverse_of(found.information, found.weights.free) * weight))
    best: tuple[float, Held, Float64Array] | None = None
    for held in candidates():
        pose = pose_of(held, rig.camera, board_mm, usual)
        told = information_of(pose, rig, board_mm, noise)
        if told is None:
            continue
        left = float(np.sum(inverse_of(found.information + told, found.weights.free) * weight))
        if best is None or left < best[0]:
            best = left, held, pose
    if best is None:
        raise ValueError(
            "no pose shows the board to camera and projector at once; take one farther away, or a smaller board"
        )
    return Suggestion(best[2], words(best[1]), float(np.sqrt(before)), float(np.sqrt(best[0])))


def candidates() -> list[Held]:
    """Return every way to hold a board that is looked at."""
    facings = [360.0 * k / FACINGS for k in range(FACINGS)]
    return [
        Held(x, y, depth, tilt, facing, turn)
        for x, y in _PLACES
        for depth in DEPTHS
        for tilt in TILTS_DEG
        for facing in (facings if tilt else facings[:1])
        for turn in TURNS_DEG
    ]


def pose_of(held: Held, camera: Pinhole, board_mm: Float64Array, usual_mm: float) -> Float64Array:
    """Return T_camera_board (4, 4): as far towards its side of the picture as the board stays inside."""
    facing, tilt, turn = np.deg2rad([held.facing_deg, held.tilt_deg, held.turn_deg])
    axis = np.array([np.sin(facing), -np.cos(facing), 0.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    tilted = np.eye(3) + np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross
    flat = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = tilted @ flat, usual_mm * held.depth
    points = board_mm @ pose[:3, :3].T + pose[:3, 3]
    rays = points[:, :2] / points[:, 2:]
    size = np.array([camera.width_px, camera.height_px])
    focal, centre = np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    least, most = (_EDGE_PX - centre) / focal, (size - 1 - _EDGE_PX - centre) / focal
    low, high = rays.min(axis=0), rays.max(axis=0)
    room = np.maximum((most - least) - (high - low), 0.0) / 2
    shift = (least + most - low - high) / 2 + np.array([held.x, held.y]) * room
    pose[:2, 3] = shift * pose[2, 3]
    return pose


def information_of(
    pose: Float64Array, rig: Rig, board_mm: Float64Array, noise_px: tuple[float, float]
) -> Float64Array | None:
    """Return what a pose would tell of the shared numbers (24, 24); None where too little of the board is seen."""
    camera, projector = noise_px
    none, count = np.zeros((len(board_mm), 2)), len(board_mm)
    empty = Observation("", board_mm, none, none, np.ones(count), none + 1, np.zeros((count, 2, 2)), np.zeros(count))
    now = predicted(empty, rig, pose, none)
    seen, lit = (
        np.all((-px > 0) & (-px < (lens.width_px - 1, lens.height_px - 1)), axis=1)
        for px, lens in ((now.camera, rig.camera), (now.projector, rig.projector))
    )
    both = seen & lit & ((board_mm @ pose[:3, :3].T + pose[:3, 3])[:, 2] > 0)
    if both.mean() < _FITTING:
        return None
    rows = np.concatenate([now.by_camera[both] / camera, now.by_projector[both] / projector]).reshape(-1, 30)
    whole = rows.T @ rows
    across, own = whole[:SHARED, POSE], whole[POSE, POSE]
    return np.asarray(whole[:SHARED, :SHARED] - across @ np.linalg.solve(own, across.T))


def words(held: Held) -> str:
    """Return what a person has to do.

    Examples
    --------
    >>> words(Held(-1.0, -1.0, 0.93, 35.0, 90.0, 90.0))
    'at the upper left of the picture, nearer by 7 %, turned by 90 degrees, tilted by 35 degrees to face down'
    """
    across = "left" if held.x < 0 else "right" if held.x > 0 else ""
    down = "upper" if held.y < 0 else "lower" if held.y > 0 else ""
    sides = {"upper": "top", "lower": "bottom", "": f"{across} side" if across else "middle"}
    parts = [f"at the {f'{down} {across}' if down and across else sides[down]} of the picture"]
    if held.depth != 1:
        parts.append(f"{'farther' if held.depth > 1 else 'nearer'} by {abs(held.depth - 1) * 100:.0f} %")
    if held.turn_deg:
        parts.append(f"turned by {held.turn_deg:.0f} degrees")
    facing = ("right", "down and right", "down", "down and left", "left", "up and left", "up", "up and right")
    towards = facing[round(held.facing_deg / 45) % 8]
    parts.append(f"tilted by {held.tilt_deg:.0f} degrees to face {towards}" if held.tilt_deg else "facing the camera")
    return ", ".join(parts)


def _noise(seen: Sequence[Observation], found: Adjusted) -> tuple[float, float]:
    """Return the usual deviation of a point in both pictures."""
    camera = float(np.median(np.concatenate([one.camera_sigma_px for one in seen])))
    projector = float(np.median(np.concatenate([one.projector_sigma_px[one.lit].ravel() for one in seen])))
    return camera * found.weights.camera_factor, projector * found.weights.projector_factor


def _working_mm(rig: Rig) -> float:
    """Return the depth where both lenses aim, as far as poses were near it; else theirs, so that none drifts away."""
    nearest, farthest = rig.poses[:, 2, 3].min(), rig.poses[:, 2, 3].max()
    try:
        aim = axes_crossing_mm(rig.T_projector_camera)
    except ValueError:
        aim = float(np.median(rig.poses[:, 2, 3]))
    return float(np.clip(aim, nearest, farthest))


def _points_weight(rig: Rig) -> Float64Array:
    """Return W (24, 24) such that the sum of W times a covariance is the mean variance of points (mm^2)."""
    pixels = grid_pixels(rig.camera, _GRID)
    total, count = np.zeros((SHARED, SHARED)), 0
    for depth in (rig.poses[:, 2, 3].min(), rig.poses[:, 2, 3].max()):
        moved, lit = point_derivatives(rig.camera, rig.projector, rig.T_projector_camera, pixels, float(depth))
        inside = np.all((lit > -0.5) & (lit < (rig.projector.width_px, rig.projector.height_px)), axis=-1)
        rows = moved[inside].reshape(-1, SHARED)
        total, count = total + rows.T @ rows, count + int(inside.sum())
    return total / max(count, 1)
