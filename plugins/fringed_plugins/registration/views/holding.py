"""Steps of many poses, and whether the surfaces hold them: eigenvalues of the normal equations.

Owns the limits below which a direction does not count as known.
"""

from __future__ import annotations

import numpy as np

from fringed_plugins.registration.transforms import FloatArray, translation
from fringed_plugins.registration.verify import LEAST_INFORMATION
from fringed_plugins.registration.views.motions import adjoint
from fringed_plugins.registration.views.pairing import View

OVER_NOISE = 4.0
HELD = 1e-9  # least eigenvalue of the scaled normal equations of a direction that may move


def held(block: FloatArray, T: FloatArray, view: View, weight: float) -> tuple[float, float]:
    """Return the information in a view's weakest direction as a share of its pairs, and what is needed.

    About its middle, rotations in units of its radius. Noise of normals alone tells as much as its square: of a ball
    nothing else is left.
    """
    J = adjoint(T @ translation(view.middle))
    J[:, :3] /= view.radius
    values, _ = eigen(J.T @ block @ J / max(weight, 1e-300))
    return float(values[0]), max(LEAST_INFORMATION, OVER_NOISE * view.slope_noise**2)


def eigen(H: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues, rising, and eigenvectors in columns, of a symmetric matrix."""
    values, vectors = np.linalg.eigh(H)
    return np.asarray(values, np.float64), np.asarray(vectors, np.float64)


def step(H: FloatArray, g: FloatArray) -> FloatArray:
    """Return the motions that lower the weighted squares most; directions that nothing holds stand still."""
    scale = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    values, vectors = eigen(H / np.outer(scale, scale))
    along = vectors.T @ (g / scale)
    small: FloatArray = -(vectors @ np.where(values > HELD, along / np.maximum(values, HELD), 0.0)) / scale
    return small


def inverted(H: FloatArray) -> FloatArray | None:
    """Return the inverse of normal equations, None where a direction is not held."""
    scale = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    values, vectors = eigen(H / np.outer(scale, scale))
    if values[0] <= HELD:
        return None
    C: FloatArray = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return C
