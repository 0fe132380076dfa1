"""Least squares of poses on SE(3) under a robust kernel: errors of edges, normal equations, damped steps.

Owns the arithmetic of `poses`: nothing is decided here about which edges count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.plane import motion
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.transforms import FloatArray, inverse, orthonormal
from fringed_plugins.registration.views.graph import Edge
from fringed_plugins.registration.views.motions import adjoint, after, logarithm

STILL = 1e-9  # of the cost: a step that lowers it by less is rounding
MOST_DAMPING = 1e12


@dataclass(frozen=True)
class Minimum:
    """Where the steps ended; `errors` (m, 6), `mahalanobis2` (m,) and kernel `weights` (m,) of the edges."""

    poses: dict[int, FloatArray]
    errors: FloatArray
    mahalanobis2: FloatArray
    weights: FloatArray
    history: tuple[float, ...]
    settled: bool


def kernel(mahalanobis2: FloatArray, limit: float) -> tuple[FloatArray, FloatArray]:
    """Return cost and weight of squared distances: quadratic up to `limit`, then bounded by three of it.

    Weight s^2 with s = min(1, 2 limit / (limit + x)): Agarwal et al. 2013, equation 12. The cost is its integral.

    Examples
    --------
    >>> kernel(np.array([1.0, 9.0]), 1.0)
    (array([1. , 2.6]), array([1.  , 0.04]))
    """
    s = np.minimum(1.0, 2 * limit / (limit + mahalanobis2))
    far = limit * (3 * mahalanobis2 - limit) / (limit + mahalanobis2)
    return np.where(mahalanobis2 <= limit, mahalanobis2, far), s**2


class Sums:
    """Normal equations H (6 n, 6 n) and g (6 n,) of the small motions of n `views`; others stand still."""

    def __init__(self, views: Sequence[int]) -> None:
        self.place = {view: 6 * n for n, view in enumerate(views)}
        self.H, self.g = np.zeros((6 * len(views), 6 * len(views))), np.zeros(6 * len(views))

    def add(self, i: int, j: int, information: FloatArray, pull: FloatArray) -> None:
        """Add what a pair says of its views' small motions d: `information` and `pull` of d_j - d_i."""
        a, b = self.place.get(i), self.place.get(j)
        for at, sign in ((a, -1.0), (b, 1.0)):
            if at is not None:
                self.H[at : at + 6, at : at + 6] += information
                self.g[at : at + 6] += sign * pull
        if a is not None and b is not None:
            self.H[a : a + 6, b : b + 6] -= information
            self.H[b : b + 6, a : a + 6] -= information


class System:
    """The edges of these numbers as a least-squares problem; view `reference` stays.

    An edge's error is the small motion in frame i, made after its measured motion, that gives the poses' one.
    """

    def __init__(self, edges: Sequence[Edge], kept: Sequence[int], reference: int) -> None:
        self.edges, self.reference = [edges[k] for k in kept], reference
        self.weights = [_inverse(np.asarray(edge.covariance)) for edge in self.edges]

    def errors(self, poses: dict[int, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return the errors (m, 6) and their squared Mahalanobis distances (m,)."""
        found = [logarithm(inverse(poses[e.i]) @ poses[e.j] @ inverse(e.T_i_j)) for e in self.edges]
        small = np.array(found).reshape(-1, 6)
        return small, np.array([e @ W @ e for e, W in zip(small, self.weights, strict=True)])

    def normal_equations(
        self, poses: dict[int, FloatArray], small: FloatArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return H (6 n, 6 n) and g (6 n,) of all poses but the reference's, in the order of `poses`."""
        sums = Sums([view for view in poses if view != self.reference])
        for edge, e, W, w in zip(self.edges, small, self.weights, weights, strict=True):
            J = after(e) @ adjoint(inverse(poses[edge.i]))
            sums.add(edge.i, edge.j, w * J.T @ W @ J, w * J.T @ W @ e)
        return sums.H, sums.g

    def covariances(self, found: Minimum) -> FloatArray:
        """Return the poses' covariances (n, 6, 6) but the reference's, in the order of `found.poses`."""
        H, _ = self.normal_equations(found.poses, found.errors, found.weights)
        if not len(H):
            return np.zeros((0, 6, 6))
        scale = np.sqrt(np.diagonal(H))
        C = np.linalg.inv(H / np.outer(scale, scale)) / np.outer(scale, scale)
        return np.array([C[n : n + 6, n : n + 6] for n in range(0, len(H), 6)])


def minimise(system: System, start: dict[int, FloatArray], limit: float, iterations: int, report: Report) -> Minimum:
    """Return the poses of least robust cost, from `start` on, through a wider kernel first.

    The wide kernel lets long loops close, whose whole error lies in one edge at the start. The cost under the
    narrow one never ends above the start's: where it would, the way through the wide kernel is not taken.
    """
    wide = descend(system, start, limit * max(len(start), 1), iterations, report)
    found = descend(system, wide.poses, limit, iterations, report)
    first = float(kernel(system.errors(start)[1], limit)[0].sum())
    if found.history[-1] > first:
        return descend(system, start, limit, iterations, report)
    return Minimum(found.poses, found.errors, found.mahalanobis2, found.weights, (first, *found.history), found.settled)


def descend(system: System, poses: dict[int, FloatArray], limit: float, iterations: int, report: Report) -> Minimum:
    """Return where Levenberg's damped steps lead (Levenberg 1944); a step that raises the cost is not made."""
    small, far = system.errors(poses)
    cost, weights = kernel(far, limit)
    history, damping, settled = [float(cost.sum())], 1e-6, len(poses) < 2
    for number in range(iterations):
        if settled:
            break
        report(0.5, f"poses: step {number + 1}")
        H, g = system.normal_equations(poses, small, weights)
        settled = True  # unless a step is found that lowers the cost
        while damping < MOST_DAMPING:
            step = _step(H, g, damping)
            if -(g @ step) <= STILL * history[-1]:
                break
            tried = _moved(poses, system.reference, step)
            e, d = system.errors(tried)
            c, w = kernel(d, limit)
            if c.sum() < history[-1]:
                settled = bool(history[-1] - c.sum() <= STILL * history[-1])
                poses, small, far, weights = tried, e, d, w
                history.append(float(c.sum()))
                damping = max(damping / 10, 1e-9)
                break
            damping *= 10
        else:
            damping = 1e-6
    return Minimum(poses, small, far, weights, tuple(history), settled)


def _step(H: FloatArray, g: FloatArray, damping: float) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    damped = H / np.outer(scale, scale) + damping * np.eye(len(H))
    small: FloatArray = -np.linalg.solve(damped, g / scale) / scale
    return small


def _moved(poses: dict[int, FloatArray], reference: int, small: FloatArray) -> dict[int, FloatArray]:
    """Return the poses with their small motions made after them."""
    moved, rest = {}, iter(small.reshape(-1, 6))
    for view, T in poses.items():
        moved[view] = T if view == reference else orthonormal(motion(next(rest)) @ T)
    return moved


def _inverse(covariance: FloatArray) -> FloatArray:
    scale = np.sqrt(np.diagonal(covariance))
    W = np.linalg.inv(covariance / np.outer(scale, scale)) / np.outer(scale, scale)
    symmetric: FloatArray = 0.5 * (W + W.T)
    return symmetric
