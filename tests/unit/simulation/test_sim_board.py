"""The board's print, as the camera sees it: against samples of each pixel, taken by code of its own."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from fringed.boards import Board, ink, points_mm
from fringed.config.simulated import SimulationConfig
from fringed.errors import ConfigurationError
from fringed.simulation import optics
from fringed.simulation.printing import apply_print
from fringed.simulation.rig import SimulatedRig
from fringed.simulation.shapes.board import T_OBJECT_BOARD

SAMPLES = 40


def rig_of(options, rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)):
    scene = {"object": "board", "options": options, "rotation_deg": rotation, "translation_mm": translation}
    table = {
        "real_time": False, "noise": False, "scene": scene,
        "sensor": {"width_px": 696, "height_px": 520}, "projector": {"width_px": 512, "height_px": 384},
    }  # fmt: skip
    return SimulatedRig(msgspec.convert(table, SimulationConfig))


def albedo_of(rig):
    """Return the print's albedo at each pixel, NaN where the sheet is not seen."""
    geometry = rig._geometry(rig._scene, 0.0)
    blank = np.ones_like(geometry.gain)
    bare = replace(geometry, gain=blank.copy(), base=blank.copy())
    apply_print(bare, rig._scene.shape.printed, optics.packed(optics.camera_lens(rig.config)))
    return np.where(geometry.flags & 4 > 0, bare.base, np.nan)


def undistorted(lens, pixels):
    xy = (pixels - lens.matrix[:2, 2]) / np.diag(lens.matrix)[:2]
    place = xy.copy()
    for _ in range(60):
        moved = np.stack(optics.distort(lens, place[..., 0], place[..., 1]), -1)
        place += xy - moved
    return place


def sampled(rig, board, column, row):
    """Return the mean albedo over one pixel from 40 x 40 rays, each followed to the sheet by itself."""
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    u, v = np.meshgrid(column + offsets, row + offsets)
    lens = optics.camera_lens(rig.config)
    rays = undistorted(lens, np.stack([u, v], -1))
    rays = np.concatenate([rays, np.ones_like(rays[..., :1])], -1)
    pose = rig.truth().T_camera_object @ T_OBJECT_BOARD
    depth = (pose[:3, 2] @ pose[:3, 3]) / (rays @ pose[:3, 2])
    seen = (rays * depth[..., None] - pose[:3, 3]) @ pose[:3, :3]
    marks = ink(board)
    dark = np.zeros(seen.shape[:2], bool)
    for x, y, radius in marks.discs:
        dark |= (seen[..., 0] - x) ** 2 + (seen[..., 1] - y) ** 2 < radius**2
    for x0, y0, x1, y1 in marks.boxes:
        dark |= (x0 <= seen[..., 0]) & (seen[..., 0] < x1) & (y0 <= seen[..., 1]) & (seen[..., 1] < y1)
    return float(np.where(dark, 0.08, 1.0).mean())


@pytest.mark.parametrize("kind", ["circles-five", "charuco"])
@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (40.0, -35.0, 20.0)])
def test_print_is_averaged_over_each_pixel(kind, rotation):
    table = {"kind": kind, "columns": 7, "rows": 5, "pitch_mm": 20.0}
    rig = rig_of(table, rotation)
    albedo = albedo_of(rig)
    partly = np.argwhere((albedo > 0.1) & (albedo < 0.98))
    assert len(partly) > 300
    chosen = partly[:: len(partly) // 60]
    off = np.array([albedo[r, c] - sampled(rig, Board(**table), c, r) for r, c in chosen])
    # 40 x 40 samples of an edge along the pixels are themselves good to half a sample, and at a corner to twice that.
    assert np.abs(off).max() < 2 / SAMPLES / 2 + 1 / 32 and np.sqrt(np.mean(off**2)) < 0.5 / SAMPLES
    assert abs(off.mean()) < 0.003


def test_upright_board_is_upright_and_not_mirrored_in_the_picture():
    board = {"columns": 7, "rows": 5}
    rig = rig_of(board)
    albedo = albedo_of(rig)
    pose = rig.truth().T_camera_object @ T_OBJECT_BOARD
    assert np.allclose(pose[:3, :3], np.eye(3), atol=1e-12)
    points = points_mm(Board(**board)) + pose[:3, 3]
    pixels = optics.project(optics.camera_lens(rig.config), points)
    assert pixels[0, 0] < pixels[6, 0] and pixels[0, 1] < pixels[-1, 1]
    middle = np.rint(pixels).astype(int)
    assert np.allclose(albedo[middle[:, 1], middle[:, 0]], 0.08)


def test_back_of_the_sheet_is_blank_and_light_marks_are_light():
    assert np.nanmin(albedo_of(rig_of({"columns": 7, "rows": 5}, (0.0, 180.0, 0.0)))) == 1.0
    light = albedo_of(rig_of({"columns": 7, "rows": 5, "polarity": "light-on-dark"}))
    assert np.nanmedian(light) == pytest.approx(0.08, abs=1e-6) and np.nanmax(light) == 1.0


def test_stretched_print_is_stretched_along_x_only():
    boards = [albedo_of(rig_of({"columns": 7, "rows": 5, "scale_x": s})) < 0.5 for s in (1.0, 1.1)]
    spans = [[np.ptp(np.nonzero(dark.any(axis=axis))[0]) for axis in (0, 1)] for dark in boards]
    assert spans[1][0] / spans[0][0] == pytest.approx(1.1, abs=0.01) and abs(spans[1][1] - spans[0][1]) <= 1


@pytest.mark.parametrize(("table", "told"), [
    ({"columns": 4}, "no room for the five"), ({"colums": 9}, "colums"), ({"scale_x": 9.0}, "scale_x"),
])  # fmt: skip
def test_boards_that_cannot_be_are_refused(table, told):
    with pytest.raises(ConfigurationError, match=told):
        rig_of(table)
