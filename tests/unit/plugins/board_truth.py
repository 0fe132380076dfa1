"""Pictures of boards whose points are known: drawn by brute force, with a projection of their own.

Shares no code with the simulator or the plug-ins; takes from the contract only where the marks are. Its blur is a
sampled Gaussian, which moves marks by up to 0.003 px RMS; figures below that are not its to give.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from fringed.boards import Board, charuco, diameters_mm, ink, is_big, points_mm, size_mm
from fringed_plugins.calibration.detect.board_spec import BoardSpec

_SUB = 16  # samples along a side of the pixels that an edge crosses


def spec_of(board: Board) -> BoardSpec:
    """Return what detection is told of a board."""
    return BoardSpec(
        board.kind, board.columns, board.rows, board.pitch_mm, points_mm(board), diameters_mm(board), is_big(board),
        board.polarity == "dark-on-light", charuco(board) if board.kind == "charuco" else None,
    )  # fmt: skip


@dataclass(frozen=True)
class Camera:
    """A pinhole with Brown's distortion (k1 k2 p1 p2 k3), pixels centred at whole numbers."""

    width: int = 640
    height: int = 480
    focal: float = 1500.0
    lens: tuple[float, float, float, float, float] = (-0.12, 0.08, 0.0006, -0.0004, 0.0)

    @property
    def matrix(self) -> Any:
        """Return the camera's matrix (3, 3)."""
        return np.array([[self.focal, 0, self.width / 2 - 3.3], [0, self.focal, self.height / 2 + 2.6], [0, 0, 1]])

    def project(self, points: Any) -> Any:
        """Return the pixels (..., 2) of points (..., 3) in the camera's frame."""
        x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
        K = self.matrix
        dx, dy = self._bent(x, y)
        return np.stack([K[0, 0] * dx + K[0, 2], K[1, 1] * dy + K[1, 2]], -1)

    def rays(self, px: Any) -> Any:
        """Return the directions (..., 3) that are seen at pixels (..., 2)."""
        K = self.matrix
        gx, gy = (px[..., 0] - K[0, 2]) / K[0, 0], (px[..., 1] - K[1, 2]) / K[1, 1]
        x, y = gx.copy(), gy.copy()
        for _ in range(40):
            bx, by = self._bent(x, y)
            bx, by = gx - bx, gy - by
            x += bx
            y += by
            if max(np.abs(bx).max(), np.abs(by).max()) < 1e-8:
                break
        return np.stack([x, y, np.ones_like(x)], -1)

    def _bent(self, x: Any, y: Any) -> tuple[Any, Any]:
        k1, k2, p1, p2, k3 = self.lens
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )


@dataclass(frozen=True)
class Scene:
    """A board before a camera, its light and the camera's faults; grey levels from 0 to 255."""

    board: Board
    camera: Camera = field(default_factory=Camera)
    tilt_deg: float = 0.0  # about `axis_deg` in the board's plane
    axis_deg: float = 0.0
    turn_deg: float = 0.0  # in the board's plane
    fill: float = 0.8  # of the picture's smaller side over the board's
    shift: tuple[float, float] = (0.0, 0.0)  # of the sheet's middle, in widths and heights of the picture
    blur_px: float = 0.7
    slope: tuple[float, float] = (0.0, 0.0)  # of the light, from the middle to an edge
    noise: float = 0.0
    light: float = 180.0
    seed: int = 1

    def pose(self) -> tuple[Any, Any]:
        """Return the board's rotation (3, 3) and its middle (3,) mm in the camera's frame."""
        from scipy.spatial.transform import Rotation

        axis = np.deg2rad(self.axis_deg)
        tilt = Rotation.from_rotvec(np.deg2rad(self.tilt_deg) * np.array([np.cos(axis), np.sin(axis), 0.0]))
        R = (tilt * Rotation.from_rotvec([0, 0, np.deg2rad(self.turn_deg)])).as_matrix()
        cam, (wide, high) = self.camera, size_mm(self.board)
        far = cam.focal / (self.fill * min(cam.width / wide, cam.height / high))
        K = cam.matrix
        at = np.array([cam.width * (0.5 + self.shift[0]) - K[0, 2], cam.height * (0.5 + self.shift[1]) - K[1, 2]])
        return R, np.array([*(at * far / cam.focal), far])

    def points(self) -> Any:
        """Return the board's points (n, 3) mm in the camera's frame."""
        R, middle = self.pose()
        return points_mm(self.board) @ R.T + middle

    def seen(self, index: Any) -> Any:
        """Return where the marks (n,) have their centres in the picture (n, 2) px: of circles that of their image.

        The centroid of 720 points around each, weighted by the area between them.
        """
        R, _ = self.pose()
        centres, radii = self.points()[index], diameters_mm(self.board)[index] / 2
        if not radii.any():
            return self.camera.project(centres)
        turn = np.arange(720) * (2 * np.pi / 720)
        rim = radii[:, None, None] * (np.cos(turn)[:, None] * R[:, 0] + np.sin(turn)[:, None] * R[:, 1])
        around = self.camera.project(centres[:, None] + rim)
        middle = around.mean(axis=1, keepdims=True)
        a, b = around - middle, np.roll(around, -1, axis=1) - middle
        area = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        return middle[:, 0] + ((a + b) * area[..., None]).sum(axis=1) / (3 * area.sum(axis=1)[:, None])

    def places(self, px: Any) -> Any:
        """Return where (..., 2) mm on the board the pixels (..., 2) look."""
        R, middle = self.pose()
        ray = self.camera.rays(px)
        distance = (R[:, 2] @ middle) / (ray @ R[:, 2])
        return ((ray * distance[..., None] - middle) @ R)[..., :2]

    def picture(self) -> Any:
        """Return the picture (height, width) float32."""
        cam = self.camera
        y, x = np.mgrid[: cam.height, : cam.width].astype(float)
        pixel = np.stack([x, y], -1)
        share = self._reflected(self.places(pixel))
        crossed = np.zeros(share.shape, bool)
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            other = np.roll(share, (dy, dx), (0, 1))
            crossed |= (share != other) | np.roll(share != other, (-dy, -dx), (0, 1))
        offset = (np.arange(_SUB) + 0.5) / _SUB - 0.5
        fine = np.stack(np.meshgrid(offset, offset, indexing="xy"), -1).reshape(-1, 2)
        for rows in np.array_split(np.argwhere(crossed), max(1, crossed.sum() // 8000)):
            at = rows[:, None, ::-1] + fine
            share[rows[:, 0], rows[:, 1]] = self._reflected(self.places(at)).mean(axis=1)
        seen = gaussian_filter(share, self.blur_px) if self.blur_px > 0 else share
        seen = seen * self._light(x, y) + 2.0
        seen = seen + self.noise * np.random.default_rng(self.seed).normal(size=seen.shape)
        return seen.astype(np.float32)

    def _light(self, x: Any, y: Any) -> Any:
        u, v = x / (self.camera.width / 2) - 1, y / (self.camera.height / 2) - 1
        return self.light * (1 + self.slope[0] * u + self.slope[1] * v)

    def _reflected(self, place: Any) -> Any:
        board, printed = self.board, ink(self.board)
        x, y = place[..., 0], place[..., 1]
        marked = np.zeros(x.shape, bool)
        if len(printed.discs):
            from scipy.spatial import cKDTree

            far, nearest = cKDTree(printed.discs[:, :2]).query(place)
            marked = far < printed.discs[nearest, 2]
        if len(printed.boxes):
            marked = _boxed(x, y, printed.boxes, board.pitch_mm)
        wide, high = size_mm(board)
        on = (np.abs(x) < wide / 2) & (np.abs(y) < high / 2)
        dark = board.polarity == "dark-on-light"
        return np.where(on, np.where(marked == dark, 0.06, 0.9), 0.2)


def _boxed(x: Any, y: Any, boxes: Any, cell: float) -> Any:
    """Return which places lie in a box; each is compared with those boxes alone that touch its cell."""
    low = boxes[:, :2].min(axis=0)
    columns, rows = np.floor((x - low[0]) / cell).astype(int), np.floor((y - low[1]) / cell).astype(int)
    wide = int(np.ceil((boxes[:, 2].max() - low[0]) / cell)) + 1
    of_place = np.where((columns >= 0) & (columns < wide) & (rows >= 0), rows * wide + columns, -1)
    middle = np.floor(((boxes[:, :2] + boxes[:, 2:]) / 2 - low) / cell).astype(int)  # no box is wider than a cell
    order = np.argsort(of_place, axis=None, kind="stable")
    flat_x, flat_y, sorted_of = x.ravel()[order], y.ravel()[order], of_place.ravel()[order]
    inside = np.zeros(x.size, bool)
    for box, of_box in zip(boxes, middle[:, 1] * wide + middle[:, 0], strict=True):
        a, b = np.searchsorted(sorted_of, [of_box, of_box + 1])
        px, py = flat_x[a:b], flat_y[a:b]
        inside[a:b] |= (px >= box[0]) & (px < box[2]) & (py >= box[1]) & (py < box[3])
    marked = np.empty(x.size, bool)
    marked[order] = inside
    return marked.reshape(x.shape)
