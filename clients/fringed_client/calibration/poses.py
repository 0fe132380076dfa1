"""Poses of a board that determine a rig well: spread over the picture, over tilt and over depth.

Owns the plan, its words for a person who holds a board, and its scenes for a simulated rig; takes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import degrees
from typing import Any

import msgspec
import numpy as np

from fringed.boards import Board, points_mm
from fringed.data import Float64Array

_EDGE = 0.93  # of the half picture; beyond, circles and the ground beside them are cut


@dataclass(frozen=True)
class Pose:
    """One planned pose.

    The board, turned in its own plane by `turn_deg`, is tilted by `tilt_deg` so that it faces the direction
    `facing_deg`: 0 to the right in the picture, 90 down, 180 left. `x` and `y` (-1 to 1) say where in the picture it
    stands, right and down; `depth` is its distance over the working distance.
    """

    name: str
    tilt_deg: float
    facing_deg: float
    turn_deg: float
    x: float
    y: float
    depth: float

    @property
    def rotation(self) -> Float64Array:
        """The board's rotation (3, 3) in the camera's frame: x right, y down, z away."""
        facing, turn, tilt = np.deg2rad([self.facing_deg, self.turn_deg, self.tilt_deg])
        axis = np.array([np.sin(facing), -np.cos(facing), 0.0])  # facing right is a turn about "up"
        cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        tilted = np.eye(3) + np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross
        flat = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        return np.asarray(tilted @ flat)


# Tilt, facing, turn, x, y, depth. Neighbours in the list differ most, so that five of them serve too. What faces left
# turns away from a projector on the right: it is tilted less.
_PLAN = (
    (25, 0, 0, 0.0, 0.0, 1.00), (30, 90, 0, -1.0, -1.0, 0.94), (25, 180, 0, 1.0, 1.0, 0.94),
    (30, 270, 90, 1.0, -1.0, 1.06), (35, 45, 0, -1.0, 1.0, 1.06), (25, 225, 0, 1.0, 0.0, 0.94),
    (40, 315, 180, 0.0, -1.0, 1.06), (35, 135, 90, -1.0, 0.0, 1.06), (40, 0, 0, 0.0, 1.0, 0.94),
    (35, 270, 0, -1.0, 1.0, 0.94), (35, 60, 0, 1.0, -1.0, 1.06), (20, 160, 90, 0.5, 0.5, 1.08),
)  # fmt: skip
POSES = len(_PLAN)
_ROUND_DEG = 23.0  # how much further the board faces in each further round of the plan


def plan(count: int = POSES) -> tuple[Pose, ...]:
    """Return `count` poses, the most different ones first; beyond 12 the same places with other tilts."""
    return tuple(_planned(number) for number in range(count))


def _planned(number: int) -> Pose:
    turn, place = divmod(number, POSES)
    pose = Pose(f"pose-{number + 1:02d}", *map(float, _PLAN[place]))
    mirrored = -1.0 if turn % 2 else 1.0
    return replace(pose, facing_deg=(pose.facing_deg + _ROUND_DEG * turn) % 360, x=pose.x * mirrored)


def words(pose: Pose) -> str:
    """Return what a person has to do with the board.

    >>> words(plan(2)[1])
    'upper left of the picture, nearer by 6 %, tilted by 30 degrees to face down'
    """
    where = _place(pose.x, pose.y)
    far = (
        f", {'farther' if pose.depth > 1 else 'nearer'} by {abs(pose.depth - 1) * 100:.0f} %" if pose.depth != 1 else ""
    )
    turned = {0: "", 90: ", on its side", 180: ", upside down"}.get(round(pose.turn_deg), f", turned {pose.turn_deg:g}")
    facing = ("right", "down and right", "down", "down and left", "left", "up and left", "up", "up and right")
    towards = facing[round(pose.facing_deg / 45) % 8]
    return f"{where} of the picture{far}{turned}, tilted by {pose.tilt_deg:.0f} degrees to face {towards}"


def _place(x: float, y: float) -> str:
    across = "left" if x < -0.7 else "right" if x > 0.7 else ""
    down = "upper" if y < -0.7 else "lower" if y > 0.7 else ""
    if down and across:
        return f"{down} {across}"
    return {"upper": "top", "lower": "bottom", "": f"{across} side" if across else "middle"}[down]


def scene_of(pose: Pose, board: Board, geometry: Mapping[str, Any], aspect: float) -> dict[str, Any]:
    """Return the simulated scene that shows the board in this pose.

    `geometry` is the configuration's `simulation.geometry`, `aspect` the camera's height over its width.
    """
    working = float(geometry["working_distance_mm"])
    half = np.array([1.0, aspect]) * float(geometry["field_mm"]) / 2 / working
    corners = _corners(board) @ pose.rotation.T + [0.0, 0.0, working * pose.depth]
    seen = corners[:, :2] / corners[:, 2:]
    low, high = seen.min(axis=0), seen.max(axis=0)
    room = np.maximum(_EDGE * half - (high - low) / 2, 0.0)
    shift = (np.array([pose.x, pose.y]) * room - (low + high) / 2) * working * pose.depth
    return {
        "object": "board",
        "options": msgspec.to_builtins(board),
        "rotation_deg": [round(angle, 9) for angle in _angles_deg(pose.rotation)],
        "translation_mm": [float(shift[0]), float(shift[1]), working * (pose.depth - 1)],
    }


def _corners(board: Board) -> Float64Array:
    points = points_mm(board)
    (x0, y0, _), (x1, y1, _) = points.min(axis=0), points.max(axis=0)
    return np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]], np.float64)


def _angles_deg(rotation: Float64Array) -> tuple[float, float, float]:
    """Return the angles about x, then y, then z of a rotation (3, 3)."""
    about_x = np.arctan2(rotation[2, 1], rotation[2, 2])
    about_y = np.arcsin(np.clip(-rotation[2, 0], -1, 1))
    about_z = np.arctan2(rotation[1, 0], rotation[0, 0])
    return degrees(about_x), degrees(about_y), degrees(about_z)
