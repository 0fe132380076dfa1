"""Binary formats: PLY, PCD and STL, little-endian.

Owns the layout of their bytes.

References
----------
Turk 1994 (PLY); pointclouds.org, "The PCD file format", version 0.7; 3D Systems 1988 (STL).
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.mesh.geometry import Geometry, comment_lines, face_normals

_COMMENT = "fringed, millimetres"
_CHUNK = 100_000  # triangles


def ply(geometry: Geometry) -> bytes:
    """Return a binary little-endian PLY: float x, y, z, nx, ny, nz, uchar intensity, and faces."""
    columns: list[tuple[str, str, npt.NDArray[Any]]] = [
        (name, "<f4", geometry.vertices[:, i]) for i, name in enumerate("xyz")
    ]
    if geometry.normals is not None:
        columns += [(name, "<f4", geometry.normals[:, i]) for i, name in enumerate(("nx", "ny", "nz"))]
    if geometry.intensity is not None:
        columns.append(("intensity", "u1", geometry.intensity))
    words = {"<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"comment {_COMMENT}"]
    header += comment_lines(geometry.notes, "comment ")
    header.append(f"element vertex {len(geometry.vertices)}")
    header += [f"property {words[kind]} {name}" for name, kind, _ in columns]
    faces = b""
    if geometry.faces is not None:
        header += [f"element face {len(geometry.faces)}", "property list uchar int vertex_indices"]
        faces = _counted(geometry.faces)
    header.append("end_header\n")
    return "\n".join(header).encode("ascii") + _packed(columns) + faces


def pcd(geometry: Geometry, size: tuple[int, int] | None = None) -> bytes:
    """Return a binary PCD 0.7 of float x, y, z, normals and intensity; `size` is (width, height) of a grid."""
    columns: list[tuple[str, str, npt.NDArray[Any]]] = [
        (name, "<f4", geometry.vertices[:, i]) for i, name in enumerate("xyz")
    ]
    if geometry.normals is not None:
        names = ("normal_x", "normal_y", "normal_z")
        columns += [(name, "<f4", geometry.normals[:, i]) for i, name in enumerate(names)]
    if geometry.intensity is not None:
        columns.append(("intensity", "<f4", geometry.intensity))
    count = len(columns)
    width, height = size or (len(geometry.vertices), 1)
    header = [
        f"# .PCD v0.7 - {_COMMENT}",
        *comment_lines(geometry.notes, "# "),
        "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _, _ in columns),
        "SIZE" + " 4" * count,
        "TYPE" + " F" * count,
        "COUNT" + " 1" * count,
        f"WIDTH {width}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {width * height}",
        "DATA binary\n",
    ]
    return "\n".join(header).encode("ascii") + _packed(columns)


def stl(geometry: Geometry) -> bytes:
    """Return a binary STL; what of the notes fits stands in its header of 80 bytes.

    Raises
    ------
    ValueError
        a geometry without faces.
    """
    if geometry.faces is None or len(geometry.faces) == 0:
        raise ValueError("STL holds triangles only, and this has none; export points as PLY, PCD or XYZ")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
    head = ", ".join(comment_lines((_COMMENT, *geometry.notes), ""))[:80].rstrip(", ").encode("ascii").ljust(80, b" ")
    content = bytearray(len(head) + 4 + record.itemsize * len(geometry.faces))
    content[: len(head) + 4] = head + struct.pack("<I", len(geometry.faces))
    triangles = np.frombuffer(content, record, offset=len(head) + 4)
    for start in range(0, len(geometry.faces), _CHUNK):  # whole, its temporaries are many times the file
        some = geometry.faces[start : start + _CHUNK]
        triangles["normal"][start : start + _CHUNK] = face_normals(geometry.vertices, some)
        triangles["corners"][start : start + _CHUNK] = geometry.vertices[some]
    return bytes(content)


def _packed(columns: list[tuple[str, str, npt.NDArray[Any]]]) -> bytes:
    table = np.empty(len(columns[0][2]), np.dtype([(name, kind) for name, kind, _ in columns]))
    for name, _, values in columns:
        table[name] = values
    return table.tobytes()


def _counted(faces: npt.NDArray[np.int32]) -> bytes:
    table = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    table["count"] = 3
    table["corners"] = faces
    return table.tobytes()
