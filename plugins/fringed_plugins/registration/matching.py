"""Closest points: which reference point belongs to which model point.

Owns the pairs of one iteration. A matcher is a callable from moved points to pairs, so that other
metrics (curvatures, colour) take its place without touching the loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray

SPLIT = 3000


@dataclass(frozen=True)
class Matches:
    """For each asked point the index of its reference point and their distance in mm."""

    index: npt.NDArray[np.intp]
    distance_mm: FloatArray


class Matcher(Protocol):
    """Find the reference point of each moved model point."""

    def __call__(self, points: npt.NDArray[Any], T_reference_model: FloatArray) -> Matches:
        """Return the matches of `points` (n, 3), already moved by `T_reference_model`."""
        ...


@dataclass(frozen=True)
class ClosestPoint:
    """Match by Euclidean distance on a level's k-d tree, exactly."""

    reference: Level
    threads: int = 1

    def __call__(self, points: npt.NDArray[Any], T_reference_model: FloatArray) -> Matches:
        """Return the closest reference point of each of `points` (n, 3)."""
        threads = self.threads if len(points) >= SPLIT else 1  # threads cost more than they save on few points
        distance, index = self.reference.tree.query(points, workers=threads)
        return Matches(index, distance)
