"""Two calibrations of one rig: which numbers differ, and how far apart they put the same point.

Owns the displacement at equal pixels of camera and projector: what a scan would show, whatever the numbers trade.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.pixel.derivatives import lens_derivatives, undistorted
from fringed_plugins.calibration.pixel.uncertainty import grid_pixels
from fringed_plugins.calibration.rig import Pinhole

Float64Array = npt.NDArray[np.float64]

_GRID = (11, 15)
_STEPS = 30


class Geometry(NamedTuple):
    """What turns a pixel and a projector column into a point: camera, projector, T_projector_camera (4, 4)."""

    camera: Pinhole
    projector: Pinhole
    T_projector_camera: Float64Array


def displacement_mm(a: Geometry, b: Geometry, depths_mm: Float64Array) -> Float64Array:
    """Return how far `b` puts points from where `a` has them (depths, rows, columns, 3) mm.

    The points of `a` lie at `depths_mm` on rays of a grid of pixels that spans the picture; `b` sees the same pixels
    and the same projector columns. NaN beyond the projector's picture.

    Raises
    ------
    ValueError
        cameras or projectors of another size.

    Examples
    --------
    >>> matrix = np.array([[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]])
    >>> lens, pose = Pinhole(641, 481, matrix, np.zeros(5)), np.eye(4)
    >>> pose[0, 3] = -100.0
    >>> longer = pose.copy()
    >>> longer[0, 3] = -101.0
    >>> off = displacement_mm(Geometry(lens, lens, pose), Geometry(lens, lens, longer), np.array([800.0]))
    >>> off[0, 5, 7].round(3).tolist()
    [0.0, 0.0, 8.0]
    """
    for name in ("camera", "projector"):
        one, other = getattr(a, name), getattr(b, name)
        if (one.width_px, one.height_px) != (other.width_px, other.height_px):
            raise ValueError(
                f"the {name}s are {one.width_px} x {one.height_px} and {other.width_px} x {other.height_px} px; only "
                "calibrations of one rig can be compared"
            )
    pixels = grid_pixels(a.camera, _GRID)
    rays = [
        np.concatenate([xy, np.ones_like(xy[..., :1])], -1) for xy in (undistorted(g.camera, pixels) for g in (a, b))
    ]
    found = np.empty((len(depths_mm), *_GRID, 3))
    for place, depth in enumerate(depths_mm):
        column, seen = _column(a, rays[0], np.full(_GRID, float(depth)))
        points = rays[1] * _depth(b, rays[1], column, float(depth))[..., None]
        found[place] = np.where(seen[..., None], points - rays[0] * depth, np.nan)
    return found


def _column(rig: Geometry, rays: Float64Array, depth: Float64Array) -> tuple[Float64Array, npt.NDArray[np.bool_]]:
    """Return the projector's column of points on rays, and whether it lies in the projector's picture."""
    points = (rays * depth[..., None]) @ rig.T_projector_camera[:3, :3].T + rig.T_projector_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels, _, _ = lens_derivatives(rig.projector, points[..., :2] / points[..., 2:])
    size = np.array([rig.projector.width_px, rig.projector.height_px])
    return pixels[..., 0], np.asarray((points[..., 2] > 0) & ((pixels > -0.5) & (pixels < size - 0.5)).all(axis=-1))


def _depth(rig: Geometry, rays: Float64Array, column: Float64Array, guess_mm: float) -> Float64Array:
    """Return the depths at which rays show the projector's columns, by secants."""
    before, now = np.full(column.shape, guess_mm * 1.001), np.full(column.shape, guess_mm)
    off_before = _column(rig, rays, before)[0] - column
    for _ in range(_STEPS):
        off = _column(rig, rays, now)[0] - column
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.where(off != off_before, off * (now - before) / (off - off_before), 0.0)
        before, off_before = now, off
        now = now - np.clip(step, -0.2 * guess_mm, 0.2 * guess_mm)
        if np.nanmax(np.abs(step)) < 1e-9 * guess_mm:
            break
    return now


def normalised(
    a: tuple[Float64Array, Float64Array], b: tuple[Float64Array, Float64Array]
) -> tuple[Float64Array, Float64Array]:
    """Return differences of numbers, b minus a, and the same in their joint deviations; each is (numbers, deviations).

    A difference of numbers that are held in both is 0 deviations, or infinitely many.
    """
    difference = b[0] - a[0]
    joint = np.hypot(a[1], b[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(joint > 0, difference / joint, np.where(difference == 0, 0.0, np.inf * np.sign(difference)))
    return difference, ratio
