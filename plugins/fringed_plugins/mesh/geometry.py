"""What all formats write: vertices with what is known of them, and the triangles of an organised grid.

Owns `Geometry` and the meshing of a grid; knows no format.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]
Int32Array = npt.NDArray[np.int32]
_AUTOMATIC_EDGES = 6.0


@dataclass(frozen=True)
class Geometry:
    """Vertices (n, 3) mm with normals (n, 3), intensity (n,) uint8 and faces (m, 3), where there are any.

    `notes` are lines of text on their origin, written where a format has room for comments.
    """

    vertices: npt.NDArray[Any]
    normals: Float32Array | None = None
    intensity: npt.NDArray[np.uint8] | None = None
    faces: Int32Array | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.vertices) == 0:
            raise ValueError("nothing is left to write: no point was kept; look at the masks of the earlier stages")


def comment_lines(notes: tuple[str, ...], prefix: str) -> list[str]:
    """Return each note on a line of its own after `prefix`: printable ASCII, whatever it holds."""
    plain = ("".join(c if " " <= c <= "~" else "?" for c in note) for note in notes)
    return [prefix + note for note in plain]


def from_grid(
    xyz_mm: Float32Array, intensity: npt.NDArray[np.uint8], meshed: bool = False, max_edge_mm: float = 0.0
) -> Geometry:
    """Return the finite points of an organised grid (height, width, 3), meshed on demand.

    Triangles join neighbours on the grid whose three edges are at most `max_edge_mm` long; 0 stands
    for six times the median distance of neighbours. They face the camera at the origin.

    Raises
    ------
    ValueError
        no finite point, or no triangle where a mesh is wanted.
    """
    valid: npt.NDArray[np.bool_] = np.asarray(np.isfinite(xyz_mm).all(axis=2))
    vertices = xyz_mm[valid]
    faces = None
    if meshed and len(vertices):
        faces = grid_faces(xyz_mm, valid, max_edge_mm)
        if len(faces) == 0:
            raise ValueError(f"no triangle has edges of at most {max_edge_mm:g} mm; allow longer ones")
    return Geometry(vertices, None, intensity[valid], faces)


def grid_faces(xyz_mm: Float32Array, valid: npt.NDArray[np.bool_], max_edge_mm: float = 0.0) -> Int32Array:
    """Return the triangles (m, 3) of a grid as numbers of its valid points, counted along the rows."""
    number = np.full(valid.shape, -1, np.int32)
    number[valid] = np.arange(np.count_nonzero(valid), dtype=np.int32)
    long = _longest(xyz_mm, max_edge_mm)
    corners = (slice(None, -1), slice(1, None))
    a, b = number[corners[0], corners[0]], number[corners[0], corners[1]]
    c, d = number[corners[1], corners[0]], number[corners[1], corners[1]]
    along = _near(xyz_mm[:, :-1], xyz_mm[:, 1:], long)
    down = _near(xyz_mm[:-1], xyz_mm[1:], long)
    across = _near(xyz_mm[:-1, 1:], xyz_mm[1:, :-1], long)
    first = along[:-1] & down[:, :-1] & across  # a, c, b
    second = along[1:] & down[:, 1:] & across  # b, c, d
    faces = [np.stack([a, c, b], axis=-1)[first], np.stack([b, c, d], axis=-1)[second]]
    return np.concatenate(faces).astype(np.int32)


def _near(first: Float32Array, second: Float32Array, limit: float) -> npt.NDArray[np.bool_]:
    """Tell which pairs are at most `limit` apart; NaN is never near."""
    difference = first - second
    return np.asarray(np.einsum("...i,...i", difference, difference) <= limit * limit)


def _longest(xyz_mm: Float32Array, max_edge_mm: float) -> float:
    if max_edge_mm > 0:
        return max_edge_mm
    steps = np.linalg.norm(xyz_mm[:, 1:] - xyz_mm[:, :-1], axis=2)
    steps = steps[np.isfinite(steps)]
    return float(_AUTOMATIC_EDGES * np.median(steps)) if steps.size else 0.0


def face_normals(vertices: npt.NDArray[Any], faces: Int32Array) -> Float32Array:
    """Return the unit normal (m, 3) of each triangle; 0 for one without area."""
    corners = vertices[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0), np.float32)
