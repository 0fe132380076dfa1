"""PLY bytes -> vertices, faces, normals, albedo.

Owns the format (ascii and binary of both byte orders); does no I/O.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fringed.data import Array
from fringed.surface_files.surface_file import SurfaceFile

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
NORMAL = ("nx", "ny", "nz")
_LUMINANCE = np.array([0.299, 0.587, 0.114])


@dataclass
class _Element:
    name: str
    count: int
    scalars: list[tuple[str, str]] = field(default_factory=list)
    list_types: tuple[str, str] | None = None


def read_ply(raw: bytes) -> SurfaceFile:
    """Return what it holds.

    Raises
    ------
    ValueError
        not a PLY, truncated, or of a form that surfaces do not have.
    """
    head, mark, body = raw.partition(b"end_header")
    if not raw.startswith(b"ply") or not mark:
        raise ValueError("it does not begin with 'ply' and a header that ends in 'end_header'")
    body = body[body.index(b"\n") + 1 :]
    order, elements = _header(head.decode("ascii").split("\n"))
    words = body.split() if order == "ascii" else []
    position = 0
    found: dict[str, Any] = {}
    for element in elements:
        if order == "ascii":
            found[element.name], position = _ascii(element, words, position)
        else:
            found[element.name], position = _binary(element, body, position, order)
    if "vertex" not in found:
        raise ValueError(f"it holds {', '.join(found) or 'nothing'}; a surface needs 'vertex'")
    table = found["vertex"]
    vertices = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
    normals = np.stack([table[n] for n in NORMAL], axis=1).astype(np.float64) if set(NORMAL) <= set(table) else None
    return SurfaceFile(vertices, found.get("face"), normals, _albedo(table))


def _header(lines: list[str]) -> tuple[str, list[_Element]]:
    order, elements = "", list[_Element]()
    for line in lines:
        words = line.split()
        if words[:1] == ["format"]:
            orders = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}
            order = orders.get(words[1], "")
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2])))
        elif words[:2] == ["property", "list"]:
            elements[-1].list_types = (_TYPES[words[2]], _TYPES[words[3]])
        elif words[:1] == ["property"]:
            elements[-1].scalars.append((words[2], _TYPES[words[1]]))
    if not order:
        raise ValueError("its format is none of ascii, binary_little_endian, binary_big_endian")
    for element in elements:
        if element.list_types and element.scalars:
            raise ValueError(f"element {element.name!r} mixes a list with other properties; write faces as lists only")
    return order, elements


def _ascii(element: _Element, words: list[bytes], position: int) -> tuple[Any, int]:
    if element.list_types is None:
        width = len(element.scalars)
        end = position + width * element.count
        table = np.array(words[position:end], dtype=np.float64)
        if len(table) < width * element.count:
            raise ValueError(f"it ends within element {element.name!r}; it is truncated")
        columns = table.reshape(element.count, width).T
        return {name: columns[i] for i, (name, _) in enumerate(element.scalars)}, end
    faces: list[tuple[int, int, int]] = []
    for _ in range(element.count):
        if position >= len(words) or position + 1 + int(words[position]) > len(words):
            raise ValueError(f"it ends within element {element.name!r}; it is truncated")
        corners = [int(word) for word in words[position + 1 : position + 1 + int(words[position])]]
        position += 1 + len(corners)
        faces += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
    return np.array(faces, dtype=np.int64).reshape(-1, 3), position


def _binary(element: _Element, body: bytes, position: int, order: str) -> tuple[Any, int]:
    truncated = ValueError(f"it ends within element {element.name!r}; it is truncated")
    if element.list_types is None:
        record = np.dtype([(name, order + kind) for name, kind in element.scalars])
        if len(body) < position + record.itemsize * element.count:
            raise truncated
        table = np.frombuffer(body, record, element.count, position)
        return {name: table[name] for name, _ in element.scalars}, position + record.itemsize * element.count
    count_type, index_type = (np.dtype(order + kind) for kind in element.list_types)
    triangle = np.dtype([("count", count_type), ("corners", index_type, 3)])
    if len(body) >= position + triangle.itemsize * element.count:
        table = np.frombuffer(body, triangle, element.count, position)
        if (table["count"] == 3).all():
            return table["corners"].astype(np.int64), position + triangle.itemsize * element.count
    faces: list[Array] = []
    for _ in range(element.count):
        if len(body) < position + count_type.itemsize:
            raise truncated
        count = int(np.frombuffer(body, count_type, 1, position)[0])
        position += count_type.itemsize
        if len(body) < position + count * index_type.itemsize:
            raise truncated
        corners = np.frombuffer(body, index_type, count, position).astype(np.int64)
        position += count * index_type.itemsize
        faces += [corners[[0, i, i + 1]] for i in range(1, count - 1)]
    return np.array(faces, dtype=np.int64).reshape(-1, 3), position


def _albedo(table: Any) -> Array | None:
    names = set(table)
    if {"red", "green", "blue"} <= names:
        colour = np.stack([np.asarray(table[name], np.float64) for name in ("red", "green", "blue")], axis=1)
        return np.asarray(np.clip(colour @ _LUMINANCE / (255.0 if colour.max(initial=0) > 1 else 1.0), 0.0, 1.0))
    if "intensity" in names:
        grey = np.asarray(table["intensity"], np.float64)
        return np.clip(grey / (255.0 if grey.max(initial=0) > 1 else 1.0), 0.0, 1.0)
    return None
