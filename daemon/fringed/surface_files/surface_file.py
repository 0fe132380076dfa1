"""What a file of points or triangles holds."""

from __future__ import annotations

from dataclasses import dataclass

from fringed.data import Array


@dataclass(frozen=True)
class SurfaceFile:
    """`vertices` (n, 3) in the file's unit; `faces` (m, 3), `normals` (n, 3) and `albedo` (n,) 0 to 1, or None."""

    vertices: Array
    faces: Array | None = None
    normals: Array | None = None
    albedo: Array | None = None
