"""A triangle mesh as arrays: its topology, normals and connected parts.

Owns what can be said of a mesh without knowing where it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class TriangleMesh:
    """Vertices (n, 3) in units of length and unit normals (n, 3), float32; faces (m, 3) int32, anticlockwise.

    `intensity` (n,) uint8; `confidence` (n,) float32 is the sum of the views' weights in 1 / length^2, the inverse
    variance of a vertex along its normal where noise is independent; zero where no view has looked.
    """

    vertices: Array
    faces: Array
    normals: Array
    intensity: Array
    confidence: Array


@dataclass(frozen=True)
class Topology:
    """How often edges are used, V - E + F, and the connected parts.

    `closed`: every edge is used exactly twice, once in each direction. `manifold`: none more than twice, none twice
    in one direction, and the faces round every vertex hang together.
    """

    boundary_edges: int
    manifold: bool
    closed: bool
    euler: int
    parts: int


def topology(faces: Array) -> Topology:
    """Return the topology of faces (m, 3); vertices that no face uses do not count.

    Examples
    --------
    >>> topology(np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))
    Topology(boundary_edges=0, manifold=True, closed=True, euler=2, parts=1)
    """
    count = int(faces.max()) + 1 if len(faces) else 0
    directed = np.concatenate([faces[:, [a, (a + 1) % 3]] for a in range(3)]).astype(np.int64)
    _, times = np.unique(directed[:, 0] * count + directed[:, 1], return_counts=True)
    low, high = directed.min(1), directed.max(1)
    undirected, uses = np.unique(low * count + high, return_counts=True)
    single, used = bool((times == 1).all()), np.unique(faces)
    fans = len(np.unique(_fans(faces))) == len(used)
    parts = len(np.unique(part_of(faces, count)[used])) if count else 0
    open_edges = int((uses == 1).sum())
    manifold = single and bool((uses <= 2).all()) and fans
    return Topology(open_edges, manifold, manifold and open_edges == 0, len(used) - len(undirected) + len(faces), parts)


def part_of(faces: Array, count: int) -> Array:
    """Return the number of the connected part (count,) of each vertex."""
    i, j = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(count, count))
    labels: Array = connected_components(graph, directed=False)[1]
    return labels


def fanned(vertices: Array, faces: Array) -> tuple[Array, Array]:
    """Return the mesh with a vertex for every fan of faces: where two meet in a point only, it is doubled."""
    labels = _fans(faces)
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return vertices[faces.ravel()[first]], inverse.reshape(-1, 3).astype(np.int32)


def _fans(faces: Array) -> Array:
    """Return for each corner (3 m,) the number of the fan that it belongs to: corners joined over shared edges."""
    m = len(faces)
    a, b = (np.concatenate([faces[:, (k + n) % 3] for k in range(3)]).astype(np.int64) for n in (0, 1))
    at_a, at_b = (np.concatenate([3 * np.arange(m) + (k + n) % 3 for k in range(3)]) for n in (0, 1))
    flip = a > b
    key = np.where(flip, b, a) * (int(faces.max(initial=0)) + 1) + np.where(flip, a, b)
    low, high = np.where(flip, at_b, at_a), np.where(flip, at_a, at_b)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    first, second = order[same], order[same + 1]
    i, j = np.concatenate([low[first], high[first]]), np.concatenate([low[second], high[second]])
    graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(3 * m, 3 * m))
    labels: Array = connected_components(graph, directed=False)[1]
    return labels


def vertex_normals(vertices: Array, faces: Array) -> Array:
    """Return unit normals (n, 3): means of the faces' normals, weighted by their areas."""
    corners = vertices[faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack(
        [np.bincount(faces.ravel(), np.repeat(across[:, k], 3), minlength=len(vertices)) for k in range(3)],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit: Array = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return unit


def compact(vertices: Array, faces: Array, keep: Array) -> tuple[Array, Array]:
    """Return the mesh of the faces that `keep` (m,) names, without the vertices that none of them uses."""
    used, inverse = np.unique(faces[keep], return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3).astype(np.int32)
