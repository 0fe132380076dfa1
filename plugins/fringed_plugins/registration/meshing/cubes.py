"""Marching cubes by a table that is generated, not copied: every field with signs everywhere gives a manifold.

Owns the 256 cases and the extraction from padded blocks of voxels. Where a cell's face has two opposite corners
inside, each is cut off by itself, on both sides of the face alike, so that no crack opens; no triangle's diagonal lies
in a face, so that no edge is used four times.

References
----------
Lorensen & Cline 1987; the ambiguity of faces: Nielson & Hamann 1991.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.meshing.triangles import linked, part_of

Array = npt.NDArray[Any]
MOST_TRIANGLES = 6
_LEAST_PART = 1e-3  # of a voxel's edge between a vertex and its ends: no triangle without area

# corner c at (c & 1, c >> 1 & 1, c >> 2 & 1); edge e along axis e // 4 from corner EDGE_START[e]
EDGE_START = tuple(c for axis in range(3) for c in range(8) if not c >> axis & 1)
EDGE_AXIS = tuple(axis for axis in range(3) for _ in range(4))


def _edge(a: int, b: int) -> int:
    """Return the edge between two corners that differ in one axis."""
    axis = (a ^ b).bit_length() - 1
    return next(e for e in range(12) if EDGE_AXIS[e] == axis and EDGE_START[e] == min(a, b))


def _faces() -> Iterator[tuple[int, int, int, int]]:
    """Give the corners of the six faces, anticlockwise from outside."""
    for axis in range(3):
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        yield (0, v, u | v, u)
        w = 1 << axis
        yield (w, w | u, w | u | v, w | v)


def _loops(case: int) -> list[list[int]]:
    """Return the closed polygons of a case as edges in order; corner c is inside where bit c is set."""
    following: dict[int, int] = {}
    for corners in _faces():
        inside = [case >> c & 1 for c in corners]
        for k in range(4):
            if inside[k] or not inside[(k + 1) % 4]:
                continue
            end = next(n for n in range(k + 1, k + 5) if inside[n % 4] and not inside[(n + 1) % 4])
            enters = _edge(corners[k], corners[(k + 1) % 4])
            leaves = _edge(corners[end % 4], corners[(end + 1) % 4])
            following[enters] = leaves
    loops = []
    while following:
        first, at = next(iter(following.items()))
        del following[first]
        loop = [first]
        while at != first:
            loop.append(at)
            at = following.pop(at)
        loops.append(loop)
    return loops


def _together(a: int, b: int) -> bool:
    """Tell whether two edges lie in one face of the cell."""
    ends = [{EDGE_START[e], EDGE_START[e] | 1 << EDGE_AXIS[e]} for e in (a, b)]
    return any(ends[0] | ends[1] <= set(face) for face in _faces())


def _split(loop: list[int]) -> list[tuple[int, int, int]] | None:
    """Return the triangles of a polygon, no diagonal of which lies in a face; None where there are none."""
    if len(loop) == 3:
        return [(loop[0], loop[1], loop[2])]
    for k in range(1, len(loop) - 1):  # the triangle at the side from the last to the first
        fits = (k == 1 or not _together(loop[0], loop[k])) and (k == len(loop) - 2 or not _together(loop[k], loop[-1]))
        if not fits:
            continue
        parts = [[(loop[-1], loop[0], loop[k])]]
        parts += [made for side in (loop[: k + 1], loop[k:]) if len(side) > 2 and (made := _split(side)) is not None]
        if sum(map(len, parts)) == len(loop) - 2:
            return [triangle for part in parts for triangle in part]
    return None


@lru_cache(maxsize=1)
def table() -> tuple[Array, Array]:
    """Return the triangles of each case as edges (256, MOST_TRIANGLES, 3) int8, and how many they are (256,)."""
    edges, count = np.full((256, MOST_TRIANGLES, 3), -1, np.int8), np.zeros(256, np.int64)
    for case in range(256):
        for loop in _loops(case):
            triangles = _split(loop)
            assert triangles is not None  # tested: every case has one
            for triangle in triangles:
                edges[case, count[case]] = triangle
                count[case] += 1
    return edges, count


def march(values: Array, corner: Array) -> tuple[Array, Array, Array]:
    """Return the triangles of blocks as lattice edges.

    Parameters
    ----------
    values
        (b, s + 1, s + 1, s + 1) signed distances, negative inside; NaN where unknown: cells there are left out.
    corner
        (b, 3) int64 lattice coordinates of the blocks' first voxels, 0 or more and below 2^19.

    Returns
    -------
    edges
        (m, 3) int64: of each triangle's corners the lattice edge that they lie on.
    vertices
        (m, 3, 3) where on them the field is zero, in lattice units.
    once
        (m, 3) True once for each cell that an edge's vertex is in: four times in all, unless cells are left out.
    """
    edges, count = table()
    s = values.shape[1] - 1
    case, known = np.zeros((len(values), s, s, s), np.uint8), np.ones((len(values), s, s, s), np.bool_)
    for c in range(8):
        x, y, z = c & 1, c >> 1 & 1, c >> 2 & 1
        part = values[:, x : x + s, y : y + s, z : z + s]
        case |= (part < 0).astype(np.uint8) << c
        known &= ~np.isnan(part)
    b, i, j, k = np.nonzero(known & (count[case] > 0))
    which = case[b, i, j, k]
    times = count[which]
    cell = np.repeat(np.arange(len(b)), times)
    number = np.arange(len(cell)) - np.repeat(np.cumsum(times) - times, times)
    e = edges[which[cell], number].astype(np.int64)
    start, axis = np.array(EDGE_START)[e], np.array(EDGE_AXIS)[e]
    at = np.stack([i, j, k], axis=1)[cell][:, None] + np.stack([start & 1, start >> 1 & 1, start >> 2 & 1], axis=2)
    step = np.eye(3, dtype=np.int64)[axis]
    block = b[cell][:, None]
    here = values[block, at[..., 0], at[..., 1], at[..., 2]].astype(np.float64)
    end = at + step
    there = values[block, end[..., 0], end[..., 1], end[..., 2]].astype(np.float64)
    first = at + corner[block]
    key = ((first[..., 0] << 40 | first[..., 1] << 20 | first[..., 2]) << 2) | axis
    part = np.clip(here / (here - there), _LEAST_PART, 1 - _LEAST_PART)
    return key, first + step * part[..., None], _first_times()[which[cell], number]


@lru_cache(maxsize=1)
def _first_times() -> Array:
    """Return where in the cases' triangles an edge is named for the first time, (256, MOST_TRIANGLES, 3)."""
    edges, _ = table()
    flat = edges.reshape(256, -1)
    before = (flat[:, :, None] == flat[:, None, :]) & np.tri(flat.shape[1], k=-1, dtype=np.bool_)
    first: Array = (flat >= 0) & ~before.any(axis=2)
    return first.reshape(edges.shape)


@dataclass(frozen=True)
class Welded:
    """Edges met only once: sorted `keys` (n,), `vertices` (n, 3), faces (m, 3), in how many cells each one is.

    `parts` (n,) numbers the connected parts.
    """

    keys: Array
    vertices: Array
    faces: Array
    cells: Array
    parts: Array

    @property
    def rim(self) -> Array:
        """Which vertices (n,) lie at a cell that was left out."""
        out: Array = self.cells < 4
        return out


def weld(keys: Array, vertices: Array, once: Array) -> Welded:
    """Return what `march` gave with every edge's vertex once."""
    unique, at, inverse = np.unique(keys.ravel(), return_index=True, return_inverse=True)
    cells = np.bincount(inverse.ravel(), once.ravel(), minlength=len(unique)).astype(np.int64)
    faces = inverse.reshape(-1, 3).astype(np.int32)
    return Welded(unique, vertices.reshape(-1, 3)[at], faces, cells, part_of(faces, len(unique)))


def joined(parts: Sequence[Welded]) -> Welded:
    """Return the parts of a mesh as one: quicker than welding all at once, for the parts are small by then."""
    keys = np.concatenate([part.keys for part in parts])
    unique, at, inverse = np.unique(keys, return_index=True, return_inverse=True)
    vertices = np.concatenate([part.vertices for part in parts])[at]
    cells = np.bincount(inverse, np.concatenate([part.cells for part in parts]), minlength=len(unique))
    offsets = np.cumsum([0, *(len(part.keys) for part in parts)])
    faces = [inverse[offset + part.faces] for offset, part in zip(offsets, parts, strict=False)]
    counts = np.cumsum([0, *(int(part.parts.max(initial=-1)) + 1 for part in parts)])
    local = np.concatenate([count + part.parts for count, part in zip(counts, parts, strict=False)])
    # the same vertex in two of them joins their parts
    labels = linked(local, local[at][inverse], int(counts[-1]))
    return Welded(unique, vertices, np.concatenate(faces).astype(np.int32), cells.astype(np.int64), labels[local[at]])
