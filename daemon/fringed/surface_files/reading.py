"""Read points and triangles from PLY, STL, OBJ or XYZ files.

Owns which format a file has, and what is said of broken ones; polygons become fans.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fringed.data import Array, Mesh, Model
from fringed.errors import DataError
from fringed.surface_files.ply import read_ply
from fringed.surface_files.surface_file import SurfaceFile

MAX_BYTES = 2 * 1024**3
WITH_NORMALS = 6  # columns


def read_surface(path: Path) -> SurfaceFile:
    """Return what a file holds, in its own unit.

    Raises
    ------
    DataError
        the file is missing, of another format, truncated or contradicts itself.
    """
    readers = {".ply": read_ply, ".stl": _read_stl, ".obj": _read_obj, ".xyz": _read_xyz}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise DataError(f"{path} ends in {path.suffix!r}; a surface is read from {', '.join(readers)}")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise DataError(f"{path} has {path.stat().st_size} bytes; at most {MAX_BYTES} are read")
        return reader(path.read_bytes())
    except FileNotFoundError as error:
        raise DataError(f"there is no file {path}") from error
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error}") from error
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise DataError(f"{path} is no valid {path.suffix[1:].upper()}: {error}") from error


def product_of_file(path: Path) -> Model | Mesh:
    """Return a file's triangles as a `Mesh`, or its points as a `Model` whose normals are zero where unknown.

    Raises
    ------
    DataError
        as `read_surface`.
    """
    read = read_surface(path)
    if read.faces is not None and len(read.faces):
        albedo = None if read.albedo is None else read.albedo.astype(np.float32)
        return Mesh(read.vertices, read.faces.astype(np.int32), albedo)
    normals = np.zeros_like(read.vertices) if read.normals is None else read.normals
    grey = np.zeros(len(read.vertices)) if read.albedo is None else 255 * np.clip(read.albedo, 0, 1)
    return Model(read.vertices.astype(np.float32), normals.astype(np.float32), np.rint(grey).astype(np.uint8))


def _read_stl(raw: bytes) -> SurfaceFile:
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
    return SurfaceFile(vertices, index.reshape(-1, 3))


def _read_obj(raw: bytes) -> SurfaceFile:
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
    points = np.array(vertices, np.float64).reshape(-1, 3)
    return SurfaceFile(points, np.array(faces, np.int64).reshape(-1, 3) if faces else None)


def _read_xyz(raw: bytes) -> SurfaceFile:
    lines = [line for line in raw.decode("utf-8").splitlines() if line.strip() and not line.lstrip().startswith("#")]
    columns = {len(line.replace(",", " ").split()) for line in lines}
    if not lines or len(columns) > 1:
        seen = f"lines of {min(columns)} to {max(columns)} numbers" if lines else "no line of numbers"
        raise ValueError(f"it has {seen}; a line has 3 coordinates, and maybe 3 of a normal, all lines alike")
    table: Array = np.array([line.replace(",", " ").split() for line in lines], dtype=np.float64)
    if table.ndim != 2 or table.shape[1] < 3:
        raise ValueError("a line has 3 coordinates, and maybe 3 of a normal")
    return SurfaceFile(table[:, :3], None, table[:, 3:6] if table.shape[1] >= WITH_NORMALS else None)
