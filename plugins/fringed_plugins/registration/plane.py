"""One linearised step of the point-to-plane error, and the information it rests on.

Owns the normal equations of small motions (rotation vector, translation); batches of them work as well.

References
----------
Chen & Medioni 1992; the mean of both normals makes it symmetric, exact on quadrics: Rusinkiewicz 2019.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.transforms import FloatArray, rigid, rotation

Array = npt.NDArray[Any]
MOST_TURN_RAD = 0.35
_HELD = 1e-6  # least eigenvalue, of 6 in all, of a direction that may move


def jacobian(points: Array, normals: Array) -> Array:
    """Return d residual / d (rotation, translation), (..., n, 6), of residuals normal . (point - partner)."""
    rows = np.empty((*points.shape[:-1], 6))
    x, n = points, normals
    rows[..., 0] = x[..., 1] * n[..., 2] - x[..., 2] * n[..., 1]
    rows[..., 1] = x[..., 2] * n[..., 0] - x[..., 0] * n[..., 2]
    rows[..., 2] = x[..., 0] * n[..., 1] - x[..., 1] * n[..., 0]
    rows[..., 3:] = n
    return rows


def information(rows: Array, weights: Array) -> Array:
    """Return H = J^T W J, (..., 6, 6); not by BLAS, whose threads would wait for each other (see `turned`)."""
    H: Array = np.einsum("...ni,...nj->...ij", rows * weights[..., None], rows)
    return H


def step(rows: Array, residual_mm: Array, weights: Array) -> tuple[Array, Array]:
    """Return the small motion (..., 6) that lowers the weighted squares most, and H (..., 6, 6).

    Directions that the pairs do not determine stand still; `verify` tells of them.
    """
    H = information(rows, weights)
    g = np.einsum("...ni,...n->...i", rows, weights * residual_mm)
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
    values, vectors = np.linalg.eigh(H / scale[..., :, None] / scale[..., None, :])
    along = np.einsum("...ij,...i->...j", vectors, g / scale)
    along = np.where(values > _HELD, along / np.maximum(values, _HELD), 0.0)
    small: Array = -np.einsum("...ij,...j->...i", vectors, along) / scale
    return small, H


def limited(small: Array, most_turn_rad: float, most_shift_mm: float) -> Array:
    """Return small motions (..., 6) shortened to the given turn and shift; linearisation holds no farther."""
    turn = np.linalg.norm(small[..., :3], axis=-1) / most_turn_rad
    shift = np.linalg.norm(small[..., 3:], axis=-1) / most_shift_mm
    shortened: Array = small / np.maximum(1.0, np.maximum(turn, shift))[..., None]
    return shortened


def motion(small: Array) -> FloatArray:
    """Return the (4, 4) transform of one small motion (6,)."""
    return rigid(rotation(small[:3]), small[3:])
