"""Which pairs are dropped: by distance, statistics, boundary, normals, one-to-one, trimming, sampling.

Owns the policies of rejection; they apply one after the other, each to what the former left. Knows nothing of how
pairs were found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fringed_plugins.registration.family.frames import Index
from fringed_plugins.registration.minimisers import by_svd
from fringed_plugins.registration.normals import BoolArray
from fringed_plugins.registration.rejection import mad_scale, zhang_limit
from fringed_plugins.registration.transforms import FloatArray, apply

_HYPOTHESES = 120
SAMPLE = 4  # one more than a motion needs, so that three on a line are rare


@dataclass(frozen=True)
class Pairs:
    """Matched points of one iteration: moved model points, their partners, both normals, the partners' indices.

    `boundary` tells which partners lie on the reference's rim; `variance` (n,) is that of both points along the
    normal, `resolution` the frames'.
    """

    model: FloatArray
    reference: FloatArray
    model_normals: FloatArray
    reference_normals: FloatArray
    index: Index
    chosen: Index
    boundary: BoolArray
    variance: FloatArray
    resolution: float

    def __len__(self) -> int:
        return len(self.model)

    @property
    def distance(self) -> FloatArray:
        """Distances (n,) of the pairs."""
        distance: FloatArray = np.sqrt(((self.model - self.reference) ** 2).sum(1))
        return distance

    def at(self, keep: BoolArray) -> Pairs:
        """Return some of the pairs."""
        return Pairs(
            self.model[keep], self.reference[keep], self.model_normals[keep], self.reference_normals[keep],
            self.index[keep], self.chosen[keep], self.boundary[keep], self.variance[keep], self.resolution,
        )  # fmt: skip


class Rejection(Protocol):
    """Drop pairs."""

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return which pairs stay (n,), and the distance that was the limit, infinite where it is no distance."""
        ...


@dataclass(frozen=True)
class Adaptive:
    """Zhang's adaptive limit of the distances' mean and deviation (thesis, section 4.4.4)."""

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the pairs within the limit."""
        limit = zhang_limit(pairs.distance, pairs.resolution)
        return pairs.distance <= limit, limit


@dataclass(frozen=True)
class Sigmas:
    """Pairs farther than `sigmas` standard deviations from the mean distance are dropped (Zinsser 2003; Druon 2006)."""

    sigmas: float = 2.5

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the pairs within the limit."""
        distance = pairs.distance
        limit = float(distance.mean() + self.sigmas * distance.std())
        return distance <= limit, limit


@dataclass(frozen=True)
class Distance:
    """Pairs farther apart than some resolutions are dropped (Turk & Levoy 1994 take 2)."""

    resolutions: float = 2.0

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the pairs within the limit."""
        limit = self.resolutions * pairs.resolution
        return pairs.distance <= limit, limit


@dataclass(frozen=True)
class Boundary:
    """Pairs whose partner lies on the rim are dropped (Turk & Levoy 1994): the surface went on there."""

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the pairs with inner partners."""
        return ~pairs.boundary, float("inf")


@dataclass(frozen=True)
class Normals:
    """Pairs whose normals differ by more than `degrees` are dropped (Zhang 1994; Pulli 1999 takes 45)."""

    degrees: float = 45.0

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the pairs whose normals agree."""
        cosine = np.einsum("ij,ij->i", pairs.model_normals, pairs.reference_normals)
        return cosine > np.cos(np.radians(self.degrees)), float("inf")


@dataclass(frozen=True)
class OneToOne:
    """Of all model points that share a partner the nearest stays: picky ICP (Zinsser, Schmidt, Niemann 2003)."""

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return one pair for each partner."""
        order = np.lexsort((pairs.distance, pairs.index))
        first = np.ones(len(order), np.bool_)
        first[1:] = pairs.index[order][1:] != pairs.index[order][:-1]
        keep = np.zeros(len(order), np.bool_)
        keep[order[first]] = True
        return keep, float("inf")


@dataclass(frozen=True)
class Trimmed:
    """The nearest part stays: trimmed ICP (Chetverikov, Stepanov, Krsek 2005).

    Without a `part` the overlap that minimises mean squared distance / overlap^3 is taken.
    """

    part: float | None = None
    least: float = 0.4

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the nearest pairs."""
        squares = np.sort(pairs.distance**2)
        count = np.arange(1, len(squares) + 1)
        if self.part is None:
            first = max(1, int(self.least * len(squares)))
            objective = (np.cumsum(squares) / count / (count / len(squares)) ** 3)[first - 1 :]
            kept = first + int(np.argmin(objective))
        else:
            kept = max(1, round(self.part * len(squares)))
        limit = float(np.sqrt(squares[min(kept, len(squares)) - 1]))
        return pairs.distance <= limit, limit


def _least_median(pairs: Pairs, rng: np.random.Generator, hypotheses: int) -> FloatArray | None:
    """Return the residual distances under that motion of a few pairs which has the least median of them."""
    best: tuple[float, FloatArray] | None = None
    for _ in range(hypotheses if len(pairs) >= SAMPLE else 0):
        sample = rng.choice(len(pairs), SAMPLE, replace=False)
        try:
            T = by_svd(pairs.model[sample], pairs.reference[sample])
        except ValueError:  # a sample on a line is no hypothesis
            continue
        left = np.sqrt(((apply(T, pairs.model) - pairs.reference) ** 2).sum(1))
        median = float(np.median(left))
        if best is None or median < best[0]:
            best = (median, left)
    return None if best is None else best[1]


@dataclass(frozen=True)
class LeastMedian:
    """Pairs beyond 2.5 robust deviations of the motion with the least median of squares are dropped.

    References
    ----------
    Masuda & Yokoya 1995; Trucco, Fusiello, Roberto: Robust motion and correspondence of noisy 3-D point sets, 1999;
    the scale is Rousseeuw & Leroy's 1987.
    """

    hypotheses: int = _HYPOTHESES

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the inliers; all where no sample gives a motion."""
        left = _least_median(pairs, rng, self.hypotheses)
        if left is None:
            return np.ones(len(pairs), np.bool_), float("inf")
        scale = 1.4826 * (1 + 5 / max(len(pairs) - 6, 1)) * float(np.median(left))
        limit = 2.5 * max(scale, 1e-9 * pairs.resolution)
        return left <= limit, limit


@dataclass(frozen=True)
class Consensus:
    """Pairs that the motion with most inliers does not explain are dropped (RANSAC: Fischler & Bolles 1981)."""

    resolutions: float = 2.0
    hypotheses: int = _HYPOTHESES

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the inliers; all where no sample gives a motion."""
        limit = self.resolutions * pairs.resolution
        best: BoolArray | None = None
        for _ in range(self.hypotheses if len(pairs) >= SAMPLE else 0):
            sample = rng.choice(len(pairs), SAMPLE, replace=False)
            try:
                T = by_svd(pairs.model[sample], pairs.reference[sample])
            except ValueError:  # a sample on a line is no hypothesis
                continue
            inlier = ((apply(T, pairs.model) - pairs.reference) ** 2).sum(1) <= limit**2
            if best is None or int(inlier.sum()) > int(best.sum()):
                best = inlier
        if best is None or int(best.sum()) < SAMPLE:
            return np.ones(len(pairs), np.bool_), float("inf")
        return best, limit


@dataclass(frozen=True)
class Robust:
    """Pairs whose point-to-plane residual exceeds 4.7 robust deviations are dropped."""

    deviations: float = 4.685

    def __call__(self, pairs: Pairs, rng: np.random.Generator) -> tuple[BoolArray, float]:
        """Return the inliers."""
        residual = np.einsum("ij,ij->i", pairs.model - pairs.reference, pairs.reference_normals)
        limit = self.deviations * max(mad_scale(residual), 1e-9 * pairs.resolution)
        return np.abs(residual) <= limit, limit
