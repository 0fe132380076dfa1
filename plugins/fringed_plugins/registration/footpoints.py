"""Where points come to lie on the full grid of a view: projective association with a walk on the grid.

Owns the projection that is fitted to the range image itself, so that no camera model is needed, and the
walk that ends at the foot of the perpendicular. Knows nothing of merging.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.normals import BoolArray, healed, normals, tangents
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, turned

Array = npt.NDArray[Any]
WALKS = 2
LONGEST_WALK_PX = 12
_SAMPLES = 400  # more wake the threads of BLAS, which then take the cores from what comes next


@dataclass(frozen=True)
class Grid:
    """A surface with tangents, normals and its projection; `usable` (height, width) has a normal."""

    surface: Surface
    along_columns: Array
    along_rows: Array
    normals: Array
    usable: BoolArray
    projection: FloatArray


@dataclass(frozen=True)
class Feet:
    """Feet of n points: flat pixel `index`, `found`, and the signed distance along the grid's normal."""

    index: npt.NDArray[np.intp]
    found: BoolArray
    residual_mm: Array


def build_grid(surface: Surface, window_px: int = 7) -> Grid:
    """Return the grid of a surface, differentiated in windows of `window_px`.

    Raises
    ------
    ValueError
        no window is complete anywhere.
    """
    whole, filled = healed(surface.xyz, surface.valid)
    n, ok = normals(whole, filled, window_px)
    usable = ok & surface.valid
    if not usable.any():
        raise ValueError(
            f"the {surface.name} has no complete window of {window_px} pixels; take a smaller one or a fuller mask"
        )
    along_columns, along_rows = tangents(whole, window_px)
    return Grid(surface, along_columns, along_rows, n, usable, fit_projection(surface))


def fit_projection(surface: Surface) -> FloatArray:
    """Return P (3, 4) with (column, row, 1) ~ P (x, y, z, 1), least squares on the range image.

    P[2, 3] is 1. Of planar points the shortest solution: it holds on the plane.
    """
    rows, columns = np.nonzero(surface.valid)
    chosen = np.linspace(0, len(rows) - 1, min(_SAMPLES, len(rows))).astype(np.intp)
    v, u = rows[chosen].astype(np.float64), columns[chosen].astype(np.float64)
    x = surface.xyz[rows[chosen], columns[chosen]].astype(np.float64) / surface.diagonal_mm
    one, none = np.ones((len(x), 1)), np.zeros((len(x), 4))
    A = np.vstack([np.hstack([x, one, none, -u[:, None] * x]), np.hstack([none, x, one, -v[:, None] * x])])
    size = float(max(surface.valid.shape))
    A[:, 8:] /= size
    solution = np.linalg.lstsq(A, np.concatenate([u, v]), rcond=1e-7)[0]
    P = np.vstack([solution[:4], solution[4:8], [*solution[8:] / size, 1.0]])
    P[:, :3] /= surface.diagonal_mm
    return P


def feet(grid: Grid, points: Array) -> Feet:
    """Return the feet of `points` (n, 3), given relative to the surface's origin."""
    h, w = grid.usable.shape
    uvw = turned(grid.projection[:, :3], points) + grid.projection[:, 3]
    ahead = uvw[:, 2] > 1e-6
    scale = 1.0 / np.where(ahead, uvw[:, 2], 1.0)
    column, row = (np.rint(np.clip(uvw[:, k] * scale, -1e6, 1e6)).astype(np.intp) for k in (0, 1))
    inside = ahead & (column > -LONGEST_WALK_PX) & (column < w + LONGEST_WALK_PX)
    inside &= (row > -LONGEST_WALK_PX) & (row < h + LONGEST_WALK_PX)
    at = np.clip(row, 0, h - 1) * w + np.clip(column, 0, w - 1)
    usable, valid = grid.usable.reshape(-1), grid.surface.valid.reshape(-1)
    xyz = grid.surface.xyz.reshape(-1, 3)
    a, b = grid.along_columns.reshape(-1, 3), grid.along_rows.reshape(-1, 3)
    for walk in range(WALKS + 1):
        off, tc, tr = points - xyz[at], a[at], b[at]
        du, dv = _solve(tc, tr, off)
        if walk < WALKS:
            here = valid[at]  # off the surface there is no tangent to walk along
            column = at % w + np.where(here, np.rint(du), 0).astype(np.intp)
            row = at // w + np.where(here, np.rint(dv), 0).astype(np.intp)
            at = np.clip(row, 0, h - 1) * w + np.clip(column, 0, w - 1)
    found = inside & usable[at] & (np.maximum(np.abs(du), np.abs(dv)) < 1.0)
    residual = np.einsum("ij,ij->i", off, grid.normals.reshape(-1, 3)[at])
    return Feet(at, found, residual)


def _solve(a: Array, b: Array, off: Array) -> tuple[Array, Array]:
    """Return how many columns and rows the foot is away: the 2 x 2 normal equations in the tangent plane."""
    aa, ab, bb = (np.einsum("ij,ij->i", x, y) for x, y in ((a, a), (a, b), (b, b)))
    ao, bo = np.einsum("ij,ij->i", a, off), np.einsum("ij,ij->i", b, off)
    determinant = np.maximum(aa * bb - ab * ab, 1e-12)
    du, dv = (bb * ao - ab * bo) / determinant, (aa * bo - ab * ao) / determinant
    return np.clip(du, -LONGEST_WALK_PX, LONGEST_WALK_PX), np.clip(dv, -LONGEST_WALK_PX, LONGEST_WALK_PX)
