"""Which points of one range image lie on another's surface, and how far from it: for pictures.

Owns nearest points and their distances along the normal; arrays in, arrays out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fringed.data import Array
from fringed_client.pictures.layers import Surface, grid_of, moved, sided

BESIDE = 1.5  # of the resolution: a partner farther aside than this is the rim of the surface, not its nearest point
AGREEING = 0.5  # cosine of the greatest angle between partners' normals


@dataclass(frozen=True)
class Partners:
    """The model's points in the reference's frame, each with the reference's nearest point.

    `points_mm` and `normals` (n, 3); `nearest_mm` (n, 3) on the reference; `distance_mm` (n,) is along the normal,
    positive where the point is in front of the reference; `partner` (n,) says which points have one.
    """

    points_mm: Array
    normals: Array
    nearest_mm: Array
    distance_mm: Array
    partner: Array


def partners_of(reference: Surface, model: Surface, T_reference_model: Array) -> Partners:
    """Return the model's points with their partners; T (4, 4) takes them to the reference's frame.

    The distance is along the mean of both normals, which leaves nothing of the curvature between the samples
    (Rusinkiewicz: A symmetric objective function for ICP, 2019). No partner: what is not in front of or behind the
    reference but beside it, and what faces another way.
    """
    fixed, normals = _surface(reference)
    points, turned = _surface(model)
    points, turned = moved(points, T_reference_model), turned @ T_reference_model[:3, :3].T
    if not len(fixed) or not len(points):
        nowhere = np.full(len(points), np.nan)
        return Partners(points, turned, np.full_like(points, np.nan), nowhere, np.zeros(len(points), bool))
    tree = cKDTree(fixed, balanced_tree=False, compact_nodes=False)
    _, index = tree.query(points, workers=1)
    few = fixed[:: max(1, len(fixed) // 2000)]
    spacing = float(np.sqrt(np.pi / 6) * np.median(tree.query(few, k=7, workers=1)[0][:, 6]))
    between, facing = points - fixed[index], normals[index]
    agreeing = np.einsum("ij,ij->i", facing, turned)
    if not (sided(reference) and sided(model)):  # nobody knows a side: planes agree or not
        turned = np.where(agreeing[:, None] < 0, -turned, turned)
        agreeing = np.abs(agreeing)
    agreeing = agreeing > AGREEING
    mean = facing + np.where(agreeing[:, None], turned, facing)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    distance = np.einsum("ij,ij->i", between, mean)
    aside = np.linalg.norm(between - distance[:, None] * mean, axis=1)
    return Partners(points, turned, fixed[index], distance, agreeing & (aside < BESIDE * spacing))


def _surface(image: Surface) -> tuple[Array, Array]:
    points, normals = grid_of(image)
    known = np.isfinite(normals[:, 2])
    return points[known], normals[known]
