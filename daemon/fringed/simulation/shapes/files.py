"""Read a triangle mesh from PLY, STL or OBJ.

Owns the three formats, as bytes; polygons become fans. Colours of PLY vertices become albedo.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from fringed.data import Array
from fringed.errors import DataError
from fringed.simulation.shapes.ply import read_ply
from fringed.simulation.shapes.shape import Shape, ShapeOptions, mesh_shape

MAX_BYTES = 2 * 1024**3


class MeshOptions(ShapeOptions, frozen=True, kw_only=True):
    """A triangle mesh from a file."""

    path: Annotated[str, Meta(min_length=1, description="a .ply, .stl or .obj file")]
    scale: Annotated[float, Meta(gt=0, description="millimetres per unit of the file")] = 1.0
    centre: Annotated[bool, Meta(description="put the middle of its bounding box on the origin")] = True


def mesh_file(options: MeshOptions) -> Shape:
    """Load the mesh.

    Raises
    ------
    DataError
        the file is missing, of another format, truncated or contradicts itself.
    """
    vertices, faces, albedo = load_mesh(Path(options.path).expanduser())
    vertices = vertices * options.scale
    if options.centre and len(vertices):
        vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    try:
        return mesh_shape(vertices, faces, albedo)
    except DataError as error:
        raise DataError(f"{options.path}: {error}") from error


def load_mesh(path: Path) -> tuple[Array, Array, Array | None]:
    """Return vertices (n, 3), faces (m, 3) and albedo (n,) or None, as the file has them.

    Raises
    ------
    DataError
        the file is missing, of another format, truncated or contradicts itself.
    """
    readers = {".ply": read_ply, ".stl": _read_stl, ".obj": _read_obj}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise DataError(f"{path} ends in {path.suffix!r}; a mesh is read from {', '.join(readers)}")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path} has {path.stat().st_size} bytes; at most {MAX_BYTES} are read")
        return reader(path.read_bytes())
    except FileNotFoundError as error:
        raise DataError(f"there is no mesh file {path}") from error
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error}") from error
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise DataError(f"{path} is no valid {path.suffix[1:].upper()}: {error}") from error


def _read_stl(raw: bytes) -> tuple[Array, Array, Array | None]:
    count = int(np.frombuffer(raw[80:84], "<u4")[0]) if len(raw) >= 84 else -1
    if count >= 0 and len(raw) == 84 + 50 * count:
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        corners = np.frombuffer(raw, record, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
    elif raw.lstrip()[:5].lower() == b"solid":
        lines = [line.split() for line in raw.decode("ascii").splitlines()]
        corners = np.array([line[1:4] for line in lines if line[:1] == ["vertex"]], dtype=np.float64).reshape(-1, 3)
        if len(corners) % 3 or lines[-1][:1] != ["endsolid"]:
            raise ValueError(f"it ends after {len(corners)} corners, without 'endsolid'; it is truncated")
    else:
        raise ValueError(f"{len(raw)} bytes; {count} triangles take {84 + 50 * max(count, 0)}: it is truncated")
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3), None


def _read_obj(raw: bytes) -> tuple[Array, Array, Array | None]:
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(raw.decode("utf-8").splitlines(), 1):
        words = line.split()
        if words[:1] == ["v"]:
            if len(words) < 4:
                raise ValueError(f"line {number}: a vertex has 3 coordinates, this has {len(words) - 1}")
            vertices.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            if len(words) < 4:
                raise ValueError(f"line {number}: a face has at least 3 corners, this has {len(words) - 1}")
            corners = [int(word.split("/")[0]) for word in words[1:]]
            corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            faces += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
    return np.array(vertices).reshape(-1, 3), np.array(faces).reshape(-1, 3), None
