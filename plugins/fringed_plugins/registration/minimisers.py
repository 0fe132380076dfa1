"""The rigid motion that best brings matched points together, by three closed forms.

Owns the point-to-point minimisers of the thesis (section 4.4.5): singular values (Arun 1987), unit
quaternions (Horn 1987) and dual quaternions (Walker 1991). They agree to rounding. Points are centred
and scaled first, which changes nothing but the rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.transforms import FloatArray, cross_matrix, rigid

Minimiser = Callable[..., FloatArray]
_COLLINEAR = 1e-10


@dataclass(frozen=True)
class _Pairs:
    x: FloatArray
    y: FloatArray
    w: FloatArray
    mean_x: FloatArray
    mean_y: FloatArray
    scale: float

    def transform(self, R: FloatArray, t: FloatArray) -> FloatArray:
        return rigid(R, self.mean_y + self.scale * t - R @ self.mean_x)


def _prepared(model: npt.ArrayLike, reference: npt.ArrayLike, weights: npt.ArrayLike | None) -> _Pairs:
    x, y = np.asarray(model, np.float64), np.asarray(reference, np.float64)
    w = np.ones(len(x)) if weights is None else np.asarray(weights, np.float64)
    if x.ndim != 2 or x.shape[1:] != (3,) or x.shape != y.shape or w.shape != x.shape[:1]:
        raise ValueError(f"pairs of shapes {x.shape} and {y.shape}, weights {w.shape}; expected (n, 3), (n, 3), (n,)")
    if not (np.isfinite(x).all() and np.isfinite(y).all() and np.isfinite(w).all() and (w >= 0).all()):
        raise ValueError("pairs or weights hold NaN, infinite or negative weights; drop those pairs first")
    if int((w > 0).sum()) < 3:
        raise ValueError(f"{int((w > 0).sum())} weighted pairs; a rigid motion needs at least 3 that are not on a line")
    w = w / w.sum()
    mean_x, mean_y = w @ x, w @ y
    x, y = x - mean_x, y - mean_y
    scale = float(np.sqrt(w @ (x**2).sum(1)))
    for name, points in (("model", x), ("reference", y)):
        spread = np.linalg.svd(points * np.sqrt(w)[:, None], compute_uv=False)
        if spread[0] <= 0 or (spread[1] / spread[0]) ** 2 < _COLLINEAR:
            raise ValueError(f"the {name} points lie on one line or in one point; the rotation about it is unknown")
    return _Pairs(x / scale, y / scale, w, mean_x, mean_y, scale)


def by_svd(model: npt.ArrayLike, reference: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> FloatArray:
    """Return `T_reference_model` (4, 4) by singular value decomposition.

    Parameters
    ----------
    model, reference
        (n, 3) matched points.
    weights
        (n,) not negative; all one when left out.

    Raises
    ------
    ValueError
        fewer than three pairs, points on a line, NaN.

    References
    ----------
    Arun, Huang, Blostein: Least-squares fitting of two 3-D point sets, PAMI 1987; the reflection is
    excluded as by Umeyama 1991.

    Examples
    --------
    >>> corners = np.eye(3)
    >>> by_svd(corners, corners + [1, 2, 3])[:3, 3].round(12)
    array([1., 2., 3.])
    """
    pairs = _prepared(model, reference, weights)
    U, _, Vt = np.linalg.svd(pairs.y.T @ (pairs.w[:, None] * pairs.x))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return pairs.transform(R, np.zeros(3))


def by_unit_quaternion(
    model: npt.ArrayLike, reference: npt.ArrayLike, weights: npt.ArrayLike | None = None
) -> FloatArray:
    """Return `T_reference_model` (4, 4) by the eigenvector of Horn's matrix; arguments as `by_svd`.

    Raises
    ------
    ValueError
        fewer than three pairs, points on a line, NaN.

    References
    ----------
    Horn: Closed-form solution of absolute orientation using unit quaternions, JOSA A 1987.
    """
    pairs = _prepared(model, reference, weights)
    S = pairs.x.T @ (pairs.w[:, None] * pairs.y)
    delta = np.array([S[1, 2] - S[2, 1], S[2, 0] - S[0, 2], S[0, 1] - S[1, 0]])
    N = np.empty((4, 4))
    N[3, 3] = np.trace(S)
    N[3, :3] = N[:3, 3] = delta
    N[:3, :3] = S + S.T - np.trace(S) * np.eye(3)
    return pairs.transform(_rotation(np.linalg.eigh(N)[1][:, -1]), np.zeros(3))


def by_dual_quaternion(
    model: npt.ArrayLike, reference: npt.ArrayLike, weights: npt.ArrayLike | None = None
) -> FloatArray:
    """Return `T_reference_model` (4, 4), rotation and translation at once; arguments as `by_svd`.

    Raises
    ------
    ValueError
        fewer than three pairs, points on a line, NaN.

    References
    ----------
    Walker, Shao, Volz: Estimating 3-D location parameters using dual number quaternions, CVGIP 1991.
    """
    pairs = _prepared(model, reference, weights)
    C1, C3, total = np.zeros((4, 4)), np.zeros((4, 4)), float(pairs.w.sum())
    Wx, Qy = _right(pairs.x), _left(pairs.y)
    C1 = -2.0 * np.einsum("n,nji,njk->ik", pairs.w, Qy, Wx)
    C3 = 2.0 * np.einsum("n,nij->ij", pairs.w, Wx - Qy)
    A = 0.5 * (C3.T @ C3 / (2.0 * total) - C1 - C1.T)
    q = np.linalg.eigh(A)[1][:, -1]
    s = -C3 @ q / (2.0 * total)
    return pairs.transform(_rotation(q), (_right(q[None, :3], q[3])[0].T @ s)[:3])


MINIMISERS: dict[str, Minimiser] = {
    "svd": by_svd,
    "unit-quaternion": by_unit_quaternion,
    "dual-quaternion": by_dual_quaternion,
}


def _rotation(q: FloatArray) -> FloatArray:
    """Return the rotation of a unit quaternion, scalar last."""
    v, s = q[:3], q[3]
    R: FloatArray = (s * s - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * s * cross_matrix(v)
    return R


def _left(vectors: FloatArray, scalar: float = 0.0) -> FloatArray:
    """Return Walker's Q of quaternions (n, 3) + scalar: the matrix of multiplication from the left."""
    return _quaternion_matrix(vectors, scalar, 1.0)


def _right(vectors: FloatArray, scalar: float = 0.0) -> FloatArray:
    """Return Walker's W: the matrix of multiplication from the right."""
    return _quaternion_matrix(vectors, scalar, -1.0)


def _quaternion_matrix(v: FloatArray, scalar: float, sign: float) -> FloatArray:
    M = np.zeros((len(v), 4, 4))
    M[:] = scalar * np.eye(4)
    for (i, j), k, s in (((0, 1), 2, -1.0), ((0, 2), 1, 1.0), ((1, 2), 0, -1.0)):
        M[:, i, j] += sign * s * v[:, k]
        M[:, j, i] -= sign * s * v[:, k]
    M[:, :3, 3] = v
    M[:, 3, :3] = -v
    return M
