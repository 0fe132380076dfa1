"""Small motions of poses: logarithm, adjoint, Jacobian, and the point about which a covariance turns.

Owns the calculus on SE(3) that many views need; a small motion is (rotation vector, translation), as in
`transforms`, and is made after the pose it belongs to.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.transforms import FloatArray, cross_matrix


def logarithm(T: FloatArray) -> FloatArray:
    """Return the motion (6,) of a transform: rotation vector in radians and translation; `plane.motion` undoes it.

    Examples
    --------
    >>> from fringed_plugins.registration.plane import motion
    >>> logarithm(motion(np.array([0.1, 0.0, 0.0, 1.0, 2.0, 3.0]))).round(6)
    array([0.1, 0. , 0. , 1. , 2. , 3. ])
    """
    small = np.empty(6)
    small[:3] = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    small[3:] = T[:3, 3]
    return small


def adjoint(T: FloatArray) -> FloatArray:
    """Return Ad (6, 6): a small motion of frame b, seen from frame a, where T takes b to a.

    Examples
    --------
    >>> T = np.eye(4); T[:3, 3] = 0.0, 0.0, 2.0
    >>> adjoint(T) @ np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    array([0.1, 0. , 0. , 0. , 0.2, 0. ])
    """
    R = T[:3, :3]
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    out[3:, :3] = cross_matrix(T[:3, 3]) @ R
    return out


def after(small: FloatArray) -> FloatArray:
    """Return d logarithm / d (a motion made after it), (6, 6), exact for large rotations too.

    References
    ----------
    Barfoot: State Estimation for Robotics, 2017, equation 7.76: the inverse left Jacobian of SO(3).
    """
    w, angle = small[:3], float(np.linalg.norm(small[:3]))
    K = cross_matrix(w)
    # 1 / angle^2 - (1 + cos) / (2 angle sin), whose limit is 1 / 12
    square = 1 / 12 + angle**2 / 720 if angle < 1e-2 else 1 / angle**2 - 0.5 / (angle * np.tan(angle / 2))
    out = np.eye(6)
    out[:3, :3] = np.eye(3) - 0.5 * K + square * (K @ K)
    out[3:, :3] = -cross_matrix(small[3:])
    return out


def pivot(covariance: FloatArray) -> FloatArray:
    """Return the point (3,) that a motion of this covariance (6, 6) displaces least: the middle of what was matched.

    Minimises E |t + w x p|^2, so that rotation and translation are told apart at the object, not at a camera
    a metre away. The origin where rotations are certain.
    """
    turn, mixed = covariance[:3, :3], covariance[3:, :3]
    A = np.trace(turn) * np.eye(3) - turn
    across = np.array([mixed[2, 1] - mixed[1, 2], mixed[0, 2] - mixed[2, 0], mixed[1, 0] - mixed[0, 1]])  # E w x t
    point: FloatArray = np.linalg.lstsq(A, across, rcond=1e-12)[0]
    return point


def displacement(small: FloatArray, point: FloatArray) -> float:
    """Return how far a small motion (6,) moves a point (3,)."""
    return float(np.linalg.norm(small[3:] + np.cross(small[:3], point)))
