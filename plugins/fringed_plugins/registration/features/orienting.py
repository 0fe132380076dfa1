"""Which way the normals of unorganised points face.

Owns the choice of sign alone: towards where a point was seen from, or alike along a spanning tree.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.features.orienting_kernel import join
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
Index = npt.NDArray[np.intp]
EDGES = 8  # of a point to its nearest neighbours
LEVELS = 65_535  # of 1 - |n_i . n_j|: 0.3 degrees apart at parallel normals; sorted in linear time
_CHUNK = 50_000


def towards(points: FloatArray, normals: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return +1 or -1 (n,) that turns `normals` (n, 3) of `points` (n, 3) towards `viewpoint` (3,) or (n, 3)."""
    away = np.einsum("ij,ij->i", points - viewpoint, normals)
    return np.where(away > 0, -1.0, 1.0)


def consistent(points: FloatArray, normals: FloatArray, near: Index, report: Report = silent) -> FloatArray:
    """Return +1 or -1 (n,) that makes neighbouring normals agree, each connected part facing out of itself.

    Parameters
    ----------
    points, normals
        (n, 3); normals that are not finite take part in nothing.
    near
        (n, k) indices of nearest neighbours, a point itself first; k at least 9.
    report
        called at least every 0.2 s with how much is done; may raise.

    Notes
    -----
    Signs travel along the spanning tree of least 1 - |n_i . n_j|, so that they cross edges last. Out is where the sum
    of n . (p - mean) is positive, which is the volume for a closed surface; for a flat patch it means nothing.

    References
    ----------
    Hoppe et al., Surface reconstruction from unorganized points, SIGGRAPH 1992, section 3.3; Kruskal 1956.
    """
    n = len(points)
    some = np.nan_to_num(normals)
    level, alike = np.empty((n, EDGES), np.uint16), np.empty((n, EDGES), np.int8)
    for first in range(0, n, _CHUNK):
        part = np.s_[first : first + _CHUNK]
        cosine = np.einsum("ij,ikj->ik", some[part], some[near[part, 1 : EDGES + 1]])
        level[part] = np.rint(LEVELS * np.clip(1.0 - np.abs(cosine), 0.0, 1.0))
        alike[part] = np.where(cosine < 0, -1, 1)
        report(0.3 * first / n, "orienting normals")
    order = np.argsort(level.ravel(), kind="stable")
    parent, sign = np.arange(n), np.ones(n, np.int8)
    for first in range(0, len(order), EDGES * _CHUNK):
        report(0.3 + 0.6 * first / len(order), "orienting normals")
        join(order[first : first + EDGES * _CHUNK], near, EDGES, alike.ravel(), parent, sign)
    report(0.9, "orienting normals")
    return _outwards(points, some, parent, sign)


def _outwards(points: FloatArray, normals: FloatArray, parent: Index, sign: Array) -> FloatArray:
    """Return signs (n,) of a forest, those of each tree such that most of its normals point away from its mean."""
    while (parent[parent] != parent).any():
        sign, parent = sign * sign[parent], parent[parent]
    part = np.unique(parent, return_inverse=True)[1]
    mean = np.stack([np.bincount(part, points[:, k]) for k in range(3)], axis=1) / np.bincount(part)[:, None]
    out = np.bincount(part, np.einsum("ij,ij->i", points - mean[part], normals) * sign)
    facing: FloatArray = sign * np.where(out < 0, -1.0, 1.0)[part]
    return facing
