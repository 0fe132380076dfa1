"""A range image seen coarsely: the surface's place and normal in cells of some pixels, with hardly any noise.

Owns the size of the cells; nothing is measured on them, they only tell what is where.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter

Array = npt.NDArray[Any]
_SIDES = (2, 3, 4, 6, 8, 12, 16)
_CELLS_ACROSS = 200
_NORMAL_NOISE = 0.01  # rad
_FILLED = 0.75
_STEEPEST = 4.0  # depth over width between neighbours; beyond, two surfaces


@dataclass(frozen=True)
class Cells:
    """Cells of `side` x `side` pixels: `points_mm` and `normals` (h, w, 3), towards the camera, and `valid` (h, w).

    `spacing_mm` is what lies between two cells, `noise_mm` what their points scatter by, `field_mm` the width of the
    whole picture at the depth of the points.
    """

    points_mm: Array
    normals: Array
    valid: Array
    side: int
    spacing_mm: float
    noise_mm: float
    field_mm: float

    @property
    def normal_noise(self) -> float:
        """What the normals scatter by, rad."""
        return float(self.noise_mm / (np.sqrt(2) * self.spacing_mm))

    def pixels(self, chosen: Array, shape: tuple[int, int]) -> Array:
        """Return the pixels (height, width) of the chosen cells (h, w)."""
        found = np.zeros(shape, bool)
        whole = np.repeat(np.repeat(chosen, self.side, axis=0), self.side, axis=1)
        found[: whole.shape[0], : whole.shape[1]] = whole
        return found


def cells_of(xyz_mm: Array, valid: Array) -> Cells:
    """Return the cells of a range image (height, width, 3), valid where `valid` (height, width).

    A cell is at the median depth of its pixels, so that a stray point does not move it.

    Raises
    ------
    ValueError
        hardly any points.
    """
    count = int(np.count_nonzero(valid))
    if count < 100:
        raise ValueError(
            f"the range image has {count} points of {valid.size} pixels; a measurement needs hundreds: light the "
            "artefact, bring it into the field, or expose longer"
        )
    noise = depth_noise_mm(xyz_mm, valid)
    field, pitch = _field_mm(xyz_mm, valid)
    least = max(1, -(-max(valid.shape) // _CELLS_ACROSS))
    side = next((s for s in _SIDES if s >= least and noise / (s * np.sqrt(2) * pitch * s) < _NORMAL_NOISE), _SIDES[-1])
    points, filled = _medians(xyz_mm, valid, side)
    normals, smooth = _normals(points, filled)
    return Cells(points, normals, smooth, side, side * pitch, 1.25 * noise / side, field)


def depth_noise_mm(xyz_mm: Array, valid: Array) -> float:
    """Return by how much depths scatter from one pixel to the next, whatever the surface's shape.

    Second differences along rows are free of slope; their median absolute value is free of edges.
    """
    z = xyz_mm[..., 2]
    whole = valid[:, 1:-1] & valid[:, 2:] & valid[:, :-2]
    bend = (z[:, 2:] + z[:, :-2] - 2 * z[:, 1:-1])[whole]
    if not len(bend):
        return 0.0
    return float(np.median(np.abs(bend)) / (0.6745 * np.sqrt(6)))


def _field_mm(xyz_mm: Array, valid: Array) -> tuple[float, float]:
    """Return the width of the picture at the points' median depth, and what one pixel of it is."""
    rows, columns = np.nonzero(valid)
    some = slice(None, None, max(1, len(rows) // 20_000))
    points = xyz_mm[rows[some], columns[some]].astype(np.float64)
    aim = points[:, :2] / points[:, 2:]
    grid = np.column_stack([columns[some], rows[some], np.ones(len(points))]).astype(np.float64)
    slope = np.linalg.lstsq(grid, aim, rcond=None)[0]
    pitch = float(np.sqrt(abs(np.linalg.det(slope[:2]))) * np.median(points[:, 2]))
    if not pitch > 0:
        raise ValueError("all points lie on one line; a measurement needs a surface")
    return pitch * valid.shape[1], pitch


def _medians(xyz_mm: Array, valid: Array, side: int) -> tuple[Array, Array]:
    height, width = (length // side * side for length in valid.shape)
    inside = valid[:height, :width]
    points = np.where(inside[..., None], xyz_mm[:height, :width].astype(np.float64), np.nan)
    shape = (height // side, side, width // side, side)
    blocks = points.reshape(*shape, 3).transpose(0, 2, 4, 1, 3).reshape(shape[0], shape[2], 3, side * side)
    filled = inside.reshape(shape).mean(axis=(1, 3)) >= _FILLED
    medians = np.full((*filled.shape, 3), np.nan)
    z = np.nanmedian(blocks[filled][:, 2], axis=1)
    aim = np.nanmean(blocks[filled][:, :2] / blocks[filled][:, 2:], axis=2)
    medians[filled] = np.column_stack([aim * z[:, None], z])
    return medians, filled


def _normals(points: Array, filled: Array) -> tuple[Array, Array]:
    """Return normals towards the camera by central differences, and where all four neighbours continue the surface."""
    normals, smooth = np.full(points.shape, np.nan), np.zeros(filled.shape, bool)
    if min(filled.shape) < 3:
        return normals, smooth
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    n = np.cross(across, down)
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-300)
    n *= -np.sign(np.einsum("...i,...i", n, points[1:-1, 1:-1]))[..., None]
    star = filled[1:-1, 1:-1] & filled[1:-1, 2:] & filled[1:-1, :-2] & filled[2:, 1:-1] & filled[:-2, 1:-1]
    steps = [np.abs(d[..., 2]) <= _STEEPEST * np.linalg.norm(d[..., :2], axis=-1) for d in (across, down)]
    normals[1:-1, 1:-1], smooth[1:-1, 1:-1] = n, star & steps[0] & steps[1]
    normals[~smooth] = np.nan
    return normals, smooth


def box_mean(values: Array, inside: Array, side: int, least: float = 0.5) -> Array:
    """Return means of `values` over windows of `side` x `side`, of what is `inside`; NaN where less than `least` is.

    Examples
    --------
    >>> values = np.arange(9.0).reshape(3, 3)
    >>> float(box_mean(values, values != 8, 3)[1, 1])
    3.5
    """
    if side <= 1:
        return np.where(inside, values, np.nan)
    window = float(side * side)
    total = uniform_filter(np.where(inside, values, 0.0), side, mode="constant") * window
    number = uniform_filter(inside.astype(np.float64), side, mode="constant") * window
    known = inside & (number >= least * window)
    return np.where(known, total / np.maximum(number, 1.0), np.nan)
