"""Guesses from local shape: what a point's surroundings look like, who looks alike, which likenesses agree.

Owns descriptors of a decimated view, candidate correspondences and the motions that many of them agree on. Needs no
start: views may be turned and moved in any way, as long as they share a good part. Knows nothing of what verifies.

References
----------
Rusu, Blodow, Beetz: Fast point feature histograms (FPFH) for 3D registration, ICRA 2009; Chen et al.: SC2-PCR, a second
order spatial compatibility for efficient and robust point cloud registration, CVPR 2022.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fringed_plugins.registration.describing_kernels import blended, simple
from fringed_plugins.registration.minimisers import by_svd
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray, apply

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Search:
    """How guesses are looked for; lengths in resolutions of the levels."""

    radius: float = 5.0
    described: int = 1500  # points of each view
    alike: int = 3  # reference points that a model point may belong to
    correspondences: int = 900
    apart: float = 5.0  # two correspondences nearer than this say little of a rotation
    tolerance: float = 1.0  # of their distance
    tolerance_cos: float = 0.2  # of what their normals say
    seeds: int = 60
    support: int = 20  # correspondences that a guess is made of


def guesses(reference: Level, model: Level, most: int = 12, search: Search | None = None) -> list[FloatArray]:
    """Return at most `most` motions (4, 4) of `model` to `reference`, those that most correspondences agree on first.

    Parameters
    ----------
    reference, model
        levels of some 1,500 to 4,000 points of about the same resolution.

    Returns
    -------
    list
        empty where nothing agrees.
    """
    search = search or Search()
    length = max(reference.spacing_mm, model.spacing_mm)
    p, q = (_described(level, search.radius * length, search.described) for level in (reference, model))
    if min(len(p.points), len(q.points)) < search.support:
        return []
    at_p, at_q = _alike(p, q, search)
    agree = _agreement(p, q, at_p, at_q, length, search)
    return _motions(p.points[at_p], q.points[at_q], agree, (most, search, length))


@dataclass(frozen=True)
class _Described:
    points: FloatArray
    normals: FloatArray
    descriptors: Array


def _described(level: Level, radius: float, most: int) -> _Described:
    """Return interior points with the square roots of their histograms, so that distances are Hellinger's."""
    points, normals, _ = level.inner()
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray").astype(np.int32)
    histograms = simple(points, normals, pairs)
    out = np.sqrt(blended(points, pairs, histograms))
    step = max(1, -(-len(points) // most))
    return _Described(points[::step], normals[::step], out[::step])


def _alike(p: _Described, q: _Described, search: Search) -> tuple[Array, Array]:
    """Return indices of candidate correspondences: a model point and the reference points that look most alike."""
    likeness = q.descriptors @ p.descriptors.T
    k = min(search.alike, likeness.shape[1])
    nearest = np.argpartition(-likeness, k - 1, axis=1)[:, :k]
    value = np.take_along_axis(likeness, nearest, axis=1)
    # a likeness counts by how far it stands out of what the model point's surroundings share with everything
    distinct = value - likeness.mean(axis=1, keepdims=True)
    best = np.argsort(-distinct.ravel(), kind="stable")[: search.correspondences]
    return nearest.ravel()[best], best // k


def _agreement(p: _Described, q: _Described, at_p: Array, at_q: Array, length: float, search: Search) -> Array:
    """Return which correspondences (n, n) agree: as far apart on both sides, and normals in the same relation."""
    x, y = p.points[at_p], q.points[at_q]
    n, m = p.normals[at_p], q.normals[at_q]
    far_x, far_y = _distances(x), _distances(y)
    agree = np.abs(far_x - far_y) < search.tolerance * length
    agree &= (far_x > search.apart * length) & (far_y > search.apart * length)
    agree &= np.abs(n @ n.T - m @ m.T) < search.tolerance_cos
    along_x = (n @ x.T - np.einsum("ij,ij->i", n, x)[:, None]) / np.maximum(far_x, 1e-300)
    along_y = (m @ y.T - np.einsum("ij,ij->i", m, y)[:, None]) / np.maximum(far_y, 1e-300)
    close = np.abs(along_x - along_y) < search.tolerance_cos
    agree &= close & close.T
    return agree.astype(np.float32)


def _distances(points: FloatArray) -> FloatArray:
    square = (points**2).sum(1)
    squared = square[:, None] + square - 2 * points @ points.T
    distances: FloatArray = np.sqrt(np.maximum(squared, 0.0))
    return distances


def _motions(x: FloatArray, y: FloatArray, agree: Array, how: tuple[int, Search, float]) -> list[FloatArray]:
    """Return motions of seeds and the correspondences that agree with them and with each other."""
    most, search, length = how
    second = agree * (agree @ agree)  # how many agree with both
    weight = second.sum(1)
    found: list[tuple[int, FloatArray]] = []
    covered = np.zeros(len(x), np.bool_)
    for seed in np.argsort(-weight, kind="stable")[: search.seeds]:
        if covered[seed] or weight[seed] <= 0:
            continue
        group = np.argsort(-second[seed], kind="stable")[: search.support]
        group = np.append(group[second[seed, group] > 0], seed)
        try:
            T = by_svd(y[group], x[group])
        except ValueError:  # a group on a line is no guess
            continue
        inlier = ((apply(T, y) - x) ** 2).sum(1) < (2 * search.tolerance * length) ** 2
        if int(inlier.sum()) >= 6:
            try:
                T = by_svd(y[inlier], x[inlier])
            except ValueError:
                continue
        covered |= inlier
        found.append((int(inlier.sum()), T))
    found.sort(key=lambda one: -one[0])
    return [T for _, T in found[:most]]
