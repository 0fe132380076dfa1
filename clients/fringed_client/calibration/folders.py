"""Poses of a board as a capture folder: images, `capture.toml`, and the poses' truth where the rig is simulated.

Owns the truth's file; images and description are `capture_write`'s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from fringed.boards import Board
from fringed.data import BoardView
from fringed.errors import NotFound
from fringed_client.calibration.poses import plan, scene_of
from fringed_client.files import make_folder, write_aside
from fringed_client.results import Lazy

if TYPE_CHECKING:
    from fringed_client.station import Station

TRUTH = "truth.json"


def write_poses(station: Station, board: Board, views: Sequence[BoardView], folder: Path) -> Path:
    """Write the images of simulated poses, one set in memory at a time; return the description's path.

    `truth.json` has T_camera_board (4, 4) of each pose by its name; `calibration-truth.json` is the rig's exact
    calibration, where that is the one in force.
    """
    from fringed_client.calibration_file import calibration_of, save_calibration
    from fringed_client.capture_write import write_capture

    make_folder(folder)
    sets = Lazy({view.name: _frames_of(station, view) for view in views}, station.get)
    written = write_capture(folder, sets, board=msgspec.to_builtins(board))
    simulation = station.config()["simulation"]
    poses = {view.name: true_pose(view.name, board, simulation).tolist() for view in views}
    write_aside(folder / TRUTH, json.dumps({"T_camera_board": poses}, indent=1).encode())
    exact = calibration_of(station)
    if exact.source == "exact-simulated":
        save_calibration(exact, folder / "calibration-truth.json")
    return written


def true_pose(name: str, board: Board, simulation: Mapping[str, Any]) -> Any:
    """Return T_camera_board (4, 4) of a planned pose as a simulated rig places it."""
    number = int(name.rpartition("-")[2])
    pose = plan(number)[-1]
    sensor = simulation["sensor"]
    scene = scene_of(pose, board, simulation["geometry"], sensor["height_px"] / sensor["width_px"])
    transform = np.eye(4)
    transform[:3, :3] = pose.rotation
    transform[:3, 3] = np.add(scene["translation_mm"], (0.0, 0.0, simulation["geometry"]["working_distance_mm"]))
    return transform


def _frames_of(station: Station, view: BoardView) -> str:
    """Return the id of the frames that a view was seen in."""
    rows = station.list(kind="FrameSet", scan=view.scan) if view.scan else []
    if not rows:
        raise NotFound(f"the frames of {view.name} ({view.id}) are not recorded any more, so they cannot be written")
    return str(rows[0]["id"])
