"""How much each pair counts: alike, by distance, by normals, by noise, by Tukey.

Owns the policies of weighting, each from pairs to weights (n,) that are not negative.

References
----------
Godin, Rioux, Baribeau 1994 (distance, compatibility of normals); Rusinkiewicz & Levoy 2001 (a comparison).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fringed_plugins.registration.family.rejection import Pairs
from fringed_plugins.registration.rejection import mad_scale, tukey_weights
from fringed_plugins.registration.transforms import FloatArray


class Weighting(Protocol):
    """Weigh pairs."""

    def __call__(self, pairs: Pairs) -> FloatArray:
        """Return the weights (n,)."""
        ...


@dataclass(frozen=True)
class Alike:
    """Every pair counts the same."""

    def __call__(self, pairs: Pairs) -> FloatArray:
        """Return ones."""
        return np.ones(len(pairs))


@dataclass(frozen=True)
class ByDistance:
    """1 - distance / greatest distance."""

    def __call__(self, pairs: Pairs) -> FloatArray:
        """Return the weights."""
        distance = pairs.distance
        return np.asarray(1.0 - 0.99 * distance / max(float(distance.max()), 1e-300))


@dataclass(frozen=True)
class ByNormals:
    """The cosine between the normals."""

    def __call__(self, pairs: Pairs) -> FloatArray:
        """Return the weights."""
        weights: FloatArray = np.clip(np.einsum("ij,ij->i", pairs.model_normals, pairs.reference_normals), 0.01, 1.0)
        return weights


@dataclass(frozen=True)
class ByNoise:
    """The inverse of both points' variance along the normal."""

    def __call__(self, pairs: Pairs) -> FloatArray:
        """Return the weights."""
        return np.asarray(1.0 / np.maximum(pairs.variance, 1e-300))


@dataclass(frozen=True)
class Tukey:
    """Tukey's biweight of the point-to-plane residual at the MAD's scale."""

    def __call__(self, pairs: Pairs) -> FloatArray:
        """Return the weights."""
        residual = np.einsum("ij,ij->i", pairs.model - pairs.reference, pairs.reference_normals)
        weights: FloatArray = tukey_weights(residual, max(mad_scale(residual), 1e-9 * pairs.resolution))
        return weights
