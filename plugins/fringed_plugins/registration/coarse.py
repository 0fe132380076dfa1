"""A tournament of first guesses on few points: all run at once, the better ones go on.

Owns the batched trimmed iterations and the score: how much of the model lies on the reference, and how
well. Knows nothing of where guesses come from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.plane import MOST_TURN_RAD, jacobian, limited, motion, step
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.scan import Scan
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray, rotation_angle

Array = npt.NDArray[Any]
TRIM = 0.7
CORE = 0.3
OVER_CORE = 3.0
SAME_SURFACE_COS = 0.85
AGAINST = 5.0
COST = 0.3
SAME_RAD = 0.05


@dataclass(frozen=True)
class Round:
    """One round: points of both sides, iterations, how many guesses stay, and the score's tolerance."""

    reference_points: int
    model_points: int
    iterations: int
    stay: int
    tolerance: float  # in resolutions of the reference's level


ROUNDS = (Round(2500, 500, 6, 14, 0.4), Round(2500, 700, 10, 5, 0.25), Round(7000, 1800, 8, 3, 0.12))

SHORT = (Round(2500, 500, 6, 4, 0.4),)  # for guesses that are near where they are right


@dataclass(frozen=True)
class Candidate:
    """A guess that survived, with its score (0 to 1)."""

    T_reference_model: FloatArray
    score: float


def tournament(
    reference: Scan,
    model: Scan,
    guesses: list[FloatArray],
    report: Report,
    threads: int = 1,
    rounds: tuple[Round, ...] = ROUNDS,
) -> list[Candidate]:
    """Return the best guesses, refined on few points, best first; at least one."""
    T = np.array(guesses)
    score = np.zeros(len(T))
    for number, game in enumerate(rounds):
        level = reference.level(game.reference_points)
        report(number / len(rounds), f"first guesses, {len(T)} left")
        points, normals = _sample(model.level(4 * game.model_points), game.model_points)
        race = _Race(level, points, normals, threads)
        for _ in range(game.iterations):
            T = race.advance(T, 0.2 * reference.diagonal_mm)
            report(number / len(rounds), f"first guesses, {len(T)} left")
        score = race.score(T, game.tolerance * level.spacing_mm)
        order = _distinct(T, score, reference.diagonal_mm)[: game.stay]
        T, score = T[order], score[order]
    return [Candidate(t, float(s)) for t, s in zip(T, score, strict=True)]


def _sample(level: Level, count: int) -> tuple[FloatArray, FloatArray]:
    points, normals, _ = level.inner()
    chosen = np.linspace(0, len(points) - 1, min(count, len(points))).round().astype(np.intp)
    return points[chosen], normals[chosen]


def _distinct(T: Array, score: Array, diagonal_mm: float) -> list[int]:
    """Return the indices by falling score, without those that all but repeat a better one."""
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        same = any(
            rotation_angle(np.linalg.inv(T[k]) @ T[i]) < SAME_RAD
            and np.linalg.norm(T[k][:3, 3] - T[i][:3, 3]) < SAME_RAD * diagonal_mm
            for k in kept
        )
        if not same:
            kept.append(int(i))
    return kept


@dataclass(frozen=True)
class _Race:
    reference: Level
    points: FloatArray
    normals: FloatArray
    threads: int

    def _match(self, T: Array, least_cos: float) -> tuple[Array, Array, Array, Array]:
        """Return moved points, partners' indices, distances (infinite where a pair cannot be) and normals."""
        moved = self.points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
        turned = self.normals @ np.swapaxes(T[:, :3, :3], 1, 2)
        distance, index = self.reference.tree.query(moved.reshape(-1, 3), workers=self.threads)
        distance, index = distance.reshape(moved.shape[:2]), index.reshape(moved.shape[:2])
        agree = np.einsum("kni,kni->kn", self.reference.normals[index], turned) > least_cos
        return moved, index, np.where(agree & self.reference.interior[index], distance, np.inf), turned

    def advance(self, T: Array, most_shift_mm: float) -> Array:
        """Return every guess after one trimmed, symmetric point-to-plane iteration."""
        moved, index, distance, turned = self._match(T, 0.5)
        possible = np.isfinite(distance)
        limit = self._limit(distance, possible)
        weights = (possible & (distance <= limit)).astype(np.float64)
        partners, n = self.reference.points[index], self.reference.normals[index] + turned
        n = n / np.maximum(np.linalg.norm(n, axis=2, keepdims=True), 1e-9)
        residual = np.einsum("kni,kni->kn", moved - partners, n)
        weights[weights.sum(1) < 12] = 0
        small, _ = step(jacobian(0.5 * (moved + partners), n), residual, weights)
        small = limited(small, MOST_TURN_RAD, most_shift_mm)
        return np.array([motion(s) @ t for s, t in zip(small, T, strict=True)])

    def _limit(self, distance: Array, possible: Array) -> Array:
        """Return every guess's limit in mm: the nearer 70 %, or fewer once the nearest 30 % have come close."""
        rising, count = np.sort(distance, axis=1), possible.sum(1)
        core, most = (
            rising[np.arange(len(rising)), np.maximum(part * count, 1).astype(np.intp) - 1] for part in (CORE, TRIM)
        )
        finite = np.where(np.isfinite(core), core, 0.0)
        limit: Array = np.minimum(most, np.maximum(OVER_CORE * finite, self.reference.spacing_mm))[:, None]
        return limit

    def score(self, T: Array, tolerance_mm: float) -> Array:
        """Return every guess's mean over the model's points: 1 - (residual / tolerance)^2 on the reference, 0 off it.

        A point that has the reference's surface before or behind it, with no boundary near, counts against.
        """
        moved, index, distance, turned = self._match(T, 0.0)
        n = self.reference.normals[index]
        residual = np.einsum("kni,kni->kn", moved - self.reference.points[index], n)
        alike = np.einsum("kni,kni->kn", n, turned) > SAME_SURFACE_COS
        good = (distance < 1.5 * self.reference.spacing_mm) & alike & (np.abs(residual) < tolerance_mm)
        against = ~good & (distance < AGAINST * self.reference.spacing_mm)
        points: Array = np.where(good, 1.0 - (residual / tolerance_mm) ** 2, 0.0) - COST * against
        mean: Array = points.mean(1)
        return mean
