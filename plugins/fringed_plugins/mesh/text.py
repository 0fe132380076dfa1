"""Text formats: XYZ and OBJ.

Owns the layout of their lines. Lengths have six significant decimals after the point: nanometres.

References
----------
Wavefront, "Advanced Visualizer manual", appendix B1 (OBJ).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.mesh.geometry import Geometry, comment_lines

_ROWS_AT_ONCE = 1 << 16


def xyz(geometry: Geometry) -> bytes:
    """Return one line for each point: x y z, then nx ny nz and the intensity where they are known.

    The notes come first, on lines that begin with "#".
    """
    columns, line = [geometry.vertices], "%.6f %.6f %.6f"
    if geometry.normals is not None:
        columns.append(geometry.normals)
        line += " %.6f %.6f %.6f"
    if geometry.intensity is not None:
        columns.append(geometry.intensity[:, None])
        line += " %d"
    return _comments(geometry) + _lines(line + "\n", np.concatenate(columns, axis=1, dtype=np.float64))


def obj(geometry: Geometry) -> bytes:
    """Return vertices, normals where they are known, and faces counted from 1."""
    parts = [b"# fringed, millimetres\n", _comments(geometry), _lines("v %.6f %.6f %.6f\n", geometry.vertices)]
    if geometry.normals is not None:
        parts.append(_lines("vn %.6f %.6f %.6f\n", geometry.normals))
    if geometry.faces is not None:
        faces = geometry.faces + 1
        if geometry.normals is None:
            parts.append(_lines("f %d %d %d\n", faces))
        else:
            parts.append(_lines("f %d//%d %d//%d %d//%d\n", np.repeat(faces, 2, axis=1)))
    else:
        points = np.arange(1, len(geometry.vertices) + 1)[:, None]
        parts.append(_lines("p %d\n", points))
    return b"".join(parts)


def _comments(geometry: Geometry) -> bytes:
    return "".join(f"{line}\n" for line in comment_lines(geometry.notes, "# ")).encode("ascii")


def _lines(template: str, table: npt.NDArray[Any]) -> bytes:
    """Format each row of `table`; in blocks, since one call with millions of numbers takes gigabytes."""
    blocks = (table[i : i + _ROWS_AT_ONCE] for i in range(0, len(table), _ROWS_AT_ONCE))
    return b"".join((template * len(block) % tuple(block.ravel().tolist())).encode("ascii") for block in blocks)
