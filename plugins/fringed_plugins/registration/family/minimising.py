"""The motion that brings pairs together: point to point, to the plane, to both planes, plane to plane, with scale.

Owns the policies of minimisation, each from pairs and weights to a (4, 4) transform that is applied after the present
one. Closed forms are `minimisers`; here are the linearised ones and scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fringed_plugins.registration.family.rejection import Pairs
from fringed_plugins.registration.minimisers import MINIMISERS, by_svd
from fringed_plugins.registration.plane import MOST_TURN_RAD, jacobian, limited, motion, step
from fringed_plugins.registration.transforms import FloatArray

FLAT = 1e-3  # GICP's variance along the normal, in units of that along the surface


class Minimising(Protocol):
    """Find the motion of matched points."""

    def __call__(self, pairs: Pairs, weights: FloatArray) -> FloatArray:
        """Return the transform (4, 4); raises ValueError where the pairs determine none."""
        ...


@dataclass(frozen=True)
class PointToPoint:
    """Least squares of distances by a closed form: "svd", "unit-quaternion" or "dual-quaternion"."""

    by: str = "dual-quaternion"

    def __call__(self, pairs: Pairs, weights: FloatArray) -> FloatArray:
        """Return the motion."""
        return MINIMISERS[self.by](pairs.model, pairs.reference, weights)


@dataclass(frozen=True)
class Scaled:
    """Least squares with a scale within bounds: scaling ICP (Du, Zheng, Ying, Xue 2010); the form is Umeyama's 1991."""

    least: float = 0.5
    most: float = 2.0

    def __call__(self, pairs: Pairs, weights: FloatArray) -> FloatArray:
        """Return the similarity transform: its upper left is scale times rotation."""
        T = by_svd(pairs.model, pairs.reference, weights)
        w = weights / weights.sum()
        x, y = pairs.model - w @ pairs.model, pairs.reference - w @ pairs.reference
        scale = float(np.einsum("n,ni,ij,nj->", w, y, T[:3, :3], x) / (w @ (x**2).sum(1)))
        scale = float(np.clip(scale, self.least, self.most))
        out = np.eye(4)
        out[:3, :3] = scale * T[:3, :3]
        out[:3, 3] = w @ pairs.reference - out[:3, :3] @ (w @ pairs.model)
        return out


@dataclass(frozen=True)
class PointToPlane:
    """One step of the distances to the partners' tangent planes (Chen & Medioni 1992)."""

    def __call__(self, pairs: Pairs, weights: FloatArray) -> FloatArray:
        """Return the motion."""
        return _plane(pairs, weights, pairs.reference_normals, pairs.model)


@dataclass(frozen=True)
class Symmetric:
    """One step of the distances along the mean of both normals (Rusinkiewicz 2019)."""

    def __call__(self, pairs: Pairs, weights: FloatArray) -> FloatArray:
        """Return the motion."""
        n = pairs.reference_normals + pairs.model_normals
        n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
        return _plane(pairs, weights, n, 0.5 * (pairs.model + pairs.reference))


def _plane(pairs: Pairs, weights: FloatArray, n: FloatArray, at: FloatArray) -> FloatArray:
    middle = at.mean(0)
    residual = np.einsum("ij,ij->i", pairs.model - pairs.reference, n)
    size = float(np.sqrt(((at - middle) ** 2).sum(1).mean()))
    small, _ = step(jacobian((at - middle) / size, n), residual / size, weights)
    small = limited(small, MOST_TURN_RAD, 1.0)
    return _about(motion(small), middle, size)


def _about(T: FloatArray, middle: FloatArray, size: float) -> FloatArray:
    """Return the motion of points from one that was found of (points - middle) / size."""
    out = T.copy()
    out[:3, 3] = middle + size * T[:3, 3] - T[:3, :3] @ middle
    return out


@dataclass(frozen=True)
class PlaneToPlane:
    """One step of Mahalanobis distances with each point's own covariance (GICP: Segal, Haehnel, Thrun 2009).

    A point is sure along its normal as far as the sensor's variance goes, and unsure along the surface by the
    resolution; where no variance is known, GICP's thousandth.
    """

    def __call__(self, pairs: Pairs, weights: FloatArray) -> FloatArray:
        """Return the motion."""
        middle = pairs.model.mean(0)
        size = float(np.sqrt(((pairs.model - middle) ** 2).sum(1).mean()))
        x = (pairs.model - middle) / size
        along = (pairs.resolution / size) ** 2
        own = np.maximum(0.5 * pairs.variance / size**2, FLAT * along)
        C = 2.0 * along * np.eye(3)[None] - sum(
            ((along - own)[:, None, None] * n[:, :, None] * n[:, None, :])
            for n in (pairs.model_normals, pairs.reference_normals)
        )
        information = np.linalg.inv(C) * weights[:, None, None]
        J = np.zeros((len(x), 3, 6))
        J[:, :, :3] = np.stack([np.cross(axis, x) for axis in np.eye(3)], axis=2)
        J[:, :, 3:] = np.eye(3)
        e = (pairs.model - pairs.reference) / size
        H = np.einsum("nki,nkl,nlj->ij", J, information, J, optimize=True)
        g = np.einsum("nki,nkl,nl->i", J, information, e, optimize=True)
        small = -np.linalg.lstsq(H, g, rcond=1e-9)[0]
        return _about(motion(limited(small, MOST_TURN_RAD, 1.0)), middle, size)
