"""The thesis's synthetic surface (section 4.5), its formula being lost: any smooth freeform with several bumps serves.

u, v in [-6, 6] in steps of 0.1: 121 x 121 points. The model is the same points, rotated by 5 degrees about each axis
and moved by (1.5, 0.5, 0.2).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

STEP = 0.1
TURN_DEG, SHIFT = (5.0, 5.0, 5.0), (1.5, 0.5, 0.2)


def height(u, v):
    """Return z of the surface: four bumps, a dent and a gentle saddle."""

    def bump(cu, cv, su, sv, h):
        return h * np.exp(-(((u - cu) / su) ** 2) - ((v - cv) / sv) ** 2)

    bumps = bump(-2.5, -2, 1.5, 1.9, 2.0) + bump(2.6, 1.4, 1.8, 1.3, 1.6) + bump(-1.8, 3.1, 1.4, 1.2, 1.2)
    return bumps + bump(2.2, -3.2, 1.6, 1.3, -1.3) + bump(0.3, 0.4, 1.1, 1.2, 0.7) + 0.02 * (u * u - 0.7 * v * v)


def surface(columns=(-6.0, 6.0)):
    """Return points (rows, columns, 3) of the part between two values of u."""
    u = np.arange(-6.0, 6.0 + STEP / 2, STEP)
    u = u[(u >= columns[0] - 1e-9) & (u <= columns[1] + 1e-9)]
    v = np.arange(-6.0, 6.0 + STEP / 2, STEP)
    grid_u, grid_v = np.meshgrid(u, v)
    return np.dstack([grid_u, grid_v, height(grid_u, grid_v)])


def pose(turn_deg=TURN_DEG, shift=SHIFT):
    """Return T_model_reference: what was done to the points to make the model."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    T[:3, 3] = shift
    return T


def moved(points, T):
    """Return points (..., 3) moved by T (4, 4)."""
    return points @ T[:3, :3].T + T[:3, 3]


def errors_percent(T_reference_model, T_model_reference):
    """Return the translation and rotation errors of the thesis's equations 4.70 and 4.71 in percent.

    Of the estimate of what was done to the model: |t - t_est| / |t| and |r - r_est| / |r| of rotation vectors.
    """
    found = np.linalg.inv(T_reference_model)
    t, r = T_model_reference[:3, 3], Rotation.from_matrix(T_model_reference[:3, :3]).as_rotvec()
    r_est = Rotation.from_matrix(found[:3, :3]).as_rotvec()
    off_t, off_r = np.linalg.norm(t - found[:3, 3]), np.linalg.norm(r - r_est)
    return 100 * off_t / np.linalg.norm(t), 100 * off_r / np.linalg.norm(r)
