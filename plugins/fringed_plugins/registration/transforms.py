"""Rigid transforms as (4, 4) matrices: build, apply, compare, check.

Owns the conventions: `T_a_b` takes points of frame b to frame a; a small motion is (rotation vector,
translation). Knows nothing of points' meaning.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
RIGID = 3e-3  # of R R^T: three digits typed by hand


def rigid(R: npt.ArrayLike, t: npt.ArrayLike) -> FloatArray:
    """Return the (4, 4) transform of a rotation (3, 3) and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def translation(t: npt.ArrayLike) -> FloatArray:
    """Return the (4, 4) transform that only moves by `t` (3,)."""
    return rigid(np.eye(3), t)


def cross_matrix(v: FloatArray) -> FloatArray:
    """Return the matrix K with K x = v cross x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation(vector: npt.ArrayLike) -> FloatArray:
    """Return the rotation matrix of a rotation vector in radians (Rodrigues' formula).

    Examples
    --------
    >>> rotation([0.0, 0.0, np.pi / 2]).round(6) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    v = np.asarray(vector, np.float64)
    K = cross_matrix(v)
    angle = float(np.linalg.norm(v))
    half = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2  # (1 - cos a) / a^2 without cancellation
    return np.eye(3) + np.sinc(angle / np.pi) * K + half * (K @ K)


def rotation_angle(T: FloatArray) -> float:
    """Return the angle of a transform's rotation in radians, exact for small angles too."""
    R = T[:3, :3]
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(R) - 1.0))


def inverse(T: FloatArray) -> FloatArray:
    """Return the inverse of a rigid transform."""
    R = T[:3, :3].T
    return rigid(R, -R @ T[:3, 3])


def turned(R: FloatArray, vectors: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return R v of `vectors` (..., 3).

    Written out: a product with a 3 x 3 matrix wakes all threads of BLAS, which spin for each other longer than
    the sum takes where other processes want the cores too.
    """
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    out = np.empty(vectors.shape, np.float64)
    for k in range(3):
        out[..., k] = x * R[k, 0] + y * R[k, 1] + z * R[k, 2]
    return out


def apply(T: FloatArray, points: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return `points` (..., 3) moved by T."""
    moved: npt.NDArray[Any] = turned(T[:3, :3], points) + T[:3, 3]
    return moved


def orthonormal(T: FloatArray) -> FloatArray:
    """Return T with its rotation brought back to the nearest proper one (rounding of many products)."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    return rigid(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, T[:3, 3])


def checked(T: npt.ArrayLike, name: str = "T_reference_model") -> FloatArray:
    """Return T as (4, 4) float64, orthonormal to rounding.

    Raises
    ------
    ValueError
        T is no rigid transform.
    """
    try:
        matrix = np.array(T, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is not a 4 x 4 matrix of numbers; give four rows of four numbers") from None
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"{name} has shape {matrix.shape}; expected a (4, 4) matrix of finite numbers")
    R = matrix[:3, :3]
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > RIGID or np.linalg.det(R) < 0 or not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9):
        raise ValueError(
            f"{name} is not rigid: R R^T is off the identity by {off:.2g}, its determinant is "
            f"{np.linalg.det(R):.3g}, its last row {matrix[3].tolist()}; expected a proper rotation (to {RIGID:g}) "
            "and a translation"
        )
    return orthonormal(matrix)
