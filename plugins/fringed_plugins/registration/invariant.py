"""A coarse stage that matches by place and by principal curvatures: motions of 60 degrees and more.

Owns the features of a decimated view, their scale, and the loop around the five-dimensional closest point. What
curvatures say about noise and validity is in their windows. Knows nothing of the stages after it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fringed_plugins.registration.minimisers import by_svd
from fringed_plugins.registration.normals import BoolArray, complete, healed
from fringed_plugins.registration.patches import table_of
from fringed_plugins.registration.result import Iteration
from fringed_plugins.registration.surface import Surface, block_means
from fringed_plugins.registration.transforms import FloatArray, apply, turned

WINDOW_PX = 7
DOUBT = 0.1  # of the curvatures' spread: what sampling and windows leave of a curvature's repeatability
FIRST_ERROR = 0.25  # of the extent, the positional error that nothing is known of
FACING_COS = 0.0
LEAST_PAIRS = 20
KEPT = 0.8  # of the pairs, the nearest: Zhang's limit would let the features decide too early
SLOW = 0.8  # of the positional error's square, at most, that one iteration may believe in
STILL = 0.5  # of the resolution


@dataclass(frozen=True)
class Curved:
    """Points of a decimated view with whole windows: (n, 3), unit normals, principal curvatures (n, 2) k1 >= k2."""

    points: FloatArray
    normals: FloatArray
    curvatures: FloatArray
    rim: BoolArray
    spacing_mm: float


def curved(surface: Surface, most_points: int) -> Curved:
    """Return a view's points with principal curvatures, positive where the surface bulges towards the sensor.

    Raises
    ------
    ValueError
        too few whole windows.
    """
    step = surface.step_of(most_points)
    xyz, valid, _ = block_means(surface, step)
    whole, filled = healed(xyz.astype(np.float32), valid)
    usable = complete(filled, WINDOW_PX) & valid
    table = table_of(whole, usable, WINDOW_PX)
    if int(usable.sum()) < LEAST_PAIRS:
        raise ValueError(f"the {surface.name} has {int(usable.sum())} whole windows of {WINDOW_PX * step} pixels")
    rim = usable & ~complete(usable, 3)
    t = table[usable].astype(np.float64)
    return Curved(t[:, :3], t[:, 9:12], principal(t), rim[usable], surface.spacing_mm * step)


def principal(table: FloatArray) -> FloatArray:
    """Return k1 >= k2 (n, 2) of patches (n, 15): roots of k^2 - 2 H k + K.

    References
    ----------
    do Carmo 1976, section 3.3: K = (e g - f^2) / (E G - F^2), H = (e G - 2 f F + g E) / (2 (E G - F^2)).
    """
    a, b = table[:, 3:6], table[:, 6:9]
    E, F, G = ((x * y).sum(1) for x, y in ((a, a), (a, b), (b, b)))
    e, f, g = table[:, 12], table[:, 13], table[:, 14]
    area = np.maximum(E * G - F * F, 1e-300)
    K, H = (e * g - f * f) / area, -0.5 * (e * G - 2 * f * F + g * E) / area
    root = np.sqrt(np.maximum(H * H - K, 0.0))
    return np.stack([H + root, H - root], axis=1)


def draw_near(
    reference: Curved, model: Curved, T: FloatArray, iterations: int, tell: Callable[[Iteration], None], most: int = 900
) -> FloatArray:
    """Return T after iterations of the closest point in place and curvature.

    d = |p - q|^2 + a^2 |f_p - f_q|^2 with features in units of their doubt and a^2 = MSE / 3, so that curvatures
    decide while the views are far apart and places do when they have met.

    References
    ----------
    Sharp, Lee, Wehe: ICP registration using invariant features, PAMI 2002.
    """
    inner = np.flatnonzero(~model.rim)
    chosen = inner[:: max(1, len(inner) // most)]
    points, normals = model.points[chosen], model.normals[chosen]
    unit = DOUBT * _spread(np.vstack([reference.curvatures, model.curvatures]))
    f_p, f_q = reference.curvatures / unit, model.curvatures[chosen] / unit
    extent = float(np.sqrt(((reference.points - reference.points.mean(0)) ** 2).sum(1).mean()))
    mse = (2 * FIRST_ERROR * extent) ** 2
    for _ in range(iterations):
        alpha = float(np.sqrt(mse / 3))
        moved = apply(T, points)
        tree = cKDTree(np.hstack([reference.points, alpha * f_p]), balanced_tree=False, compact_nodes=False)
        _, index = tree.query(np.hstack([moved, alpha * f_q]))
        off = reference.points[index] - moved
        distance = np.sqrt((off**2).sum(1))
        facing = np.einsum("ij,ij->i", reference.normals[index], turned(T[:3, :3], normals))
        keep = ~reference.rim[index] & (facing > FACING_COS)
        if int(keep.sum()) < LEAST_PAIRS:
            break
        limit = float(np.quantile(distance[keep], KEPT))
        keep &= distance <= limit
        try:
            small = by_svd(moved[keep], reference.points[index[keep]])
        except ValueError:  # pairs on a line say nothing
            break
        T = small @ T
        went = float(np.sqrt(((apply(small, moved) - moved) ** 2).sum(1).mean()))
        left = apply(small, moved[keep]) - reference.points[index[keep]]
        mse = min(mse, max(float((left**2).sum(1).mean()), SLOW * mse))
        angle = float(np.arccos(np.clip((np.trace(small[:3, :3]) - 1) / 2, -1, 1)))
        tell(Iteration(float(np.sqrt(mse)), int(keep.sum()), limit, angle, went, "coarse"))
        if went < STILL * reference.spacing_mm:
            break
    return T


def _spread(curvatures: FloatArray) -> FloatArray:
    low, high = np.percentile(curvatures, (10, 90), axis=0)
    spread: FloatArray = np.maximum(high - low, 1e-12)
    return spread
