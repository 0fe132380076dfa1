"""A triangle mesh as arrays: its topology, normals and connected parts.

Owns what can be said of a mesh without knowing where it comes from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = npt.NDArray[Any]
CHUNK = 200_000  # faces


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
    return linked(faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel(), count)


def linked(i: Array, j: Array, count: int) -> Array:
    """Return the number of the part (count,) that each thing is in, where things `i` (n,) and `j` hang together."""
    graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(count, count))
    labels: Array = connected_components(graph, directed=False)[1]
    return labels


def fanned(faces: Array, rim: Array) -> tuple[Array, Array]:
    """Return which vertices to take (n + more,), and faces, so that every fan of faces has a vertex of its own.

    Where two fans meet in a point only, it is taken twice. Only vertices of `rim` (n,) are looked at.
    """
    near = np.flatnonzero(rim[faces].any(axis=1))
    corners = faces[near].ravel()
    labels = _fans(faces[near])
    chosen = np.flatnonzero(rim[corners])
    _, first, inverse = np.unique(labels[chosen], return_index=True, return_inverse=True)
    owner = corners[chosen[first]]
    _, earliest = np.unique(owner, return_index=True)
    number = np.full(len(owner), -1, np.int64)  # the first fan of each vertex keeps it
    number[earliest] = owner[earliest]
    more = np.flatnonzero(number < 0)
    number[more] = len(rim) + np.arange(len(more))
    out = faces.copy()
    changed = faces[near].ravel()
    changed[chosen] = number[inverse]
    out[near] = changed.reshape(-1, 3)
    return np.concatenate([np.arange(len(rim)), owner[more]]), out


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
    return linked(i, j, 3 * m)


def vertex_normals(vertices: Array, faces: Array, tell: Callable[[], None] = lambda: None) -> Array:
    """Return unit normals (n, 3): means of the faces' normals, weighted by their areas; `tell` is called often."""
    total = np.zeros((len(vertices), 3))
    for start in range(0, len(faces), CHUNK):
        tell()
        part = faces[start : start + CHUNK]
        a, b, c = (vertices[part[:, k]].astype(np.float64) for k in range(3))
        across = np.cross(b - a, c - a)
        for k in range(3):
            total[:, k] += np.bincount(part.ravel(), np.repeat(across[:, k], 3), minlength=len(vertices))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit: Array = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return unit


def compact(faces: Array, keep: Array, count: int) -> tuple[Array, Array]:
    """Return which of `count` vertices the faces use that `keep` (m,) names, and those faces of them."""
    used = np.zeros(count, np.bool_)
    used[faces[keep]] = True
    number = np.cumsum(used) - 1
    return np.flatnonzero(used), number[faces[keep]].astype(np.int32)
