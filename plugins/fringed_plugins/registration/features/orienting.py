"""Which way the normals of unorganised points face.

Owns the choice of sign alone: towards where a point was seen from, or alike along a spanning tree.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from fringed_plugins.registration.transforms import FloatArray

Index = npt.NDArray[Any]
EDGES = 10  # of a point to its nearest neighbours
_LEAST = 1e-6  # weight of an edge between parallel normals: zero would be no edge


def towards(points: FloatArray, normals: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return +1 or -1 (n,) that turns `normals` (n, 3) of `points` (n, 3) towards `viewpoint` (3,) or (n, 3)."""
    away = np.einsum("ij,ij->i", points - viewpoint, normals)
    return np.where(away > 0, -1.0, 1.0)


def consistent(points: FloatArray, normals: FloatArray, near: Index) -> FloatArray:
    """Return +1 or -1 (n,) that makes neighbouring normals agree, each connected part facing out of itself.

    Parameters
    ----------
    points, normals
        (n, 3); normals that are not finite take part in nothing.
    near
        (n, k) indices of nearest neighbours, a point itself first.

    Notes
    -----
    Signs travel along the spanning tree of least 1 - |n_i . n_j|, so that they cross edges last. Out is where the sum
    of n . (p - mean) is positive, which is the volume for a closed surface; for a flat patch it means nothing.

    References
    ----------
    Hoppe et al., Surface reconstruction from unorganized points, SIGGRAPH 1992, section 3.3.
    """
    n = len(points)
    some = np.nan_to_num(normals)
    edges = near[:, 1 : EDGES + 1]
    agree = np.einsum("ij,ikj->ik", some, some[edges])
    weights = np.maximum(1.0 - np.abs(agree), 0.0) + _LEAST
    pointer = np.arange(n + 1) * edges.shape[1]
    tree = minimum_spanning_tree(csr_array((weights.ravel(), edges.ravel(), pointer), shape=(n, n))).tocoo()
    parts, part = connected_components(tree, directed=False)
    # one more vertex holds the parts together, so that one walk reaches all of them
    first = np.unique(part, return_index=True)[1]
    ends = np.concatenate([tree.row, np.full(parts, n)]), np.concatenate([tree.col, first])
    whole = csr_array((np.ones(len(ends[0])), ends), shape=(n + 1, n + 1))
    _, parent = breadth_first_order(whole, n, directed=False)
    up = np.where(parent < 0, n, parent)
    sign = np.ones(n + 1)
    sign[:n] = np.where(np.einsum("ij,ij->i", some, np.vstack([some, np.zeros(3)])[up[:n]]) < 0, -1.0, 1.0)
    while (up != n).any():  # each pass doubles the way to the root that a sign has gone
        sign *= sign[up]
        up = up[up]
    mean = np.stack([np.bincount(part, points[:, k]) for k in range(3)], axis=1) / np.bincount(part)[:, None]
    out = np.bincount(part, np.einsum("ij,ij->i", points - mean[part], some) * sign[:n])
    facing: FloatArray = sign[:n] * np.where(out < 0, -1.0, 1.0)[part]
    return facing
