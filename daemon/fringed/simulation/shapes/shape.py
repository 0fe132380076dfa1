"""What an object of the simulated scene is: a mesh or spheres, in its own frame.

Owns the object's form and albedo; knows nothing of where it stands. An object's frame: millimetres, x to the right,
y up, z towards the camera when it is not turned.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np
import numpy.typing as npt

from fringed.data import Array, Float32Array, Float64Array, Int32Array
from fringed.errors import DataError


class ShapeOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every object's options: unknown keys are errors."""


@dataclass(frozen=True)
class Print:
    """Marks on the front of a flat sheet, in its own frame (mm), x to the right and y down.

    `discs` (m, 3) are x, y, radius, `boxes` (k, 4) x0, y0, x1, y1; `albedo` of the ground and of the marks. What is
    printed at x stands at x `scale_x`. Cells of `place` (x0, y0, side), `cells` rows and columns of them, say which
    discs and which boxes may reach there: `items[starts[cell] : starts[cell + 1]]`.
    """

    discs: Float64Array
    boxes: Float64Array
    albedo: tuple[float, float]
    scale_x: float
    place: Float64Array
    cells: tuple[int, int]
    starts: tuple[Array, Array]
    items: tuple[Array, Array]


@dataclass(frozen=True)
class Shape:
    """An object: triangles with smooth normals, and `spheres` (k, 4), exact ones: centre and radius, mm.

    `albedo` (m,) of each vertex is relative to the scene's albedo, and so is what is `printed` on z = 0.
    """

    vertices_mm: Float64Array
    faces: Int32Array
    normals: Float64Array
    albedo: Float32Array
    spheres: Float64Array = field(default_factory=lambda: np.zeros((0, 4)))
    printed: Print | None = None


def sphere_shape(spheres: npt.ArrayLike) -> Shape:
    """Return exact spheres (k, 4), centre and radius."""
    none = np.zeros((0, 3))
    return Shape(none, np.zeros((0, 3), np.int32), none, np.zeros(0, np.float32), np.array(spheres, np.float64))


def mesh_shape(vertices_mm: npt.ArrayLike, faces: npt.ArrayLike, albedo: Array | None = None) -> Shape:
    """Return a shape of triangles; normals are the mean of the faces around a vertex, weighted by area.

    Raises
    ------
    DataError
        no triangle, an index that is no vertex's, or a vertex that is no number.
    """
    vertices = np.array(vertices_mm, dtype=np.float64)
    triangles = np.array(faces, dtype=np.int64)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise DataError(f"a mesh has (n, 3) vertices and (m, 3) faces; these are {vertices.shape}, {triangles.shape}")
    if not len(triangles):
        raise DataError(f"the mesh has {len(vertices)} vertices and no triangle; a scene needs at least one")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise DataError(
            f"the mesh has faces with vertices {triangles.min()} to {triangles.max()}; it has vertices 0 to "
            f"{len(vertices) - 1}"
        )
    if not np.isfinite(vertices).all():
        raise DataError("the mesh has vertices that are not finite numbers")
    corners = vertices[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    kept = area > 1e-12 * max(1.0, float(area.max()))
    triangles, across = triangles[kept], across[kept]
    if not len(triangles):
        raise DataError("every triangle of the mesh is degenerate: its corners are in one line")
    normals = np.zeros_like(vertices)
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(triangles[:, corner], across[:, axis], len(vertices))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    tint = np.ones(len(vertices), np.float32) if albedo is None else np.array(albedo, np.float32)
    return Shape(vertices, triangles.astype(np.int32), normals, tint)


def grid_faces(rows: int, columns: int, closed: bool = False) -> Int32Array:
    """Return the triangles (m, 3) of a grid of vertices, row by row; `closed` joins the last column to the first."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    if closed:
        index = np.concatenate([index, index[:, :1]], axis=1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    return np.concatenate(
        [np.stack([a, c, b], axis=-1).reshape(-1, 3), np.stack([b, c, d], axis=-1).reshape(-1, 3)]
    )  # fmt: skip
