"""Which points of the model are asked for partners: all, uniform, random, by normals, by curvature.

Owns the policies of selection. Each takes a frame and a generator, and returns indices that rise.

References
----------
Turk & Levoy 1994 (uniform); Masuda, Sakaue, Yokoya 1996 (random, anew in each iteration); Rusinkiewicz & Levoy 2001
(normal space).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fringed_plugins.registration.family.frames import Frame, Index

NORMAL_BINS = 12  # along each of two angles


class Selection(Protocol):
    """Choose points of the model."""

    @property
    def anew(self) -> bool:
        """Whether every iteration chooses again."""
        ...

    def __call__(self, model: Frame, rng: np.random.Generator) -> Index:
        """Return the indices of the chosen points, rising."""
        ...


def candidates(model: Frame, whole: bool) -> Index:
    """Return the indices of all points, or of those whose window is whole."""
    return np.flatnonzero(model.whole) if whole else np.arange(len(model))


@dataclass(frozen=True)
class Everything:
    """All points; with `whole` all that have features."""

    whole: bool = False
    anew: bool = False

    def __call__(self, model: Frame, rng: np.random.Generator) -> Index:
        """Return every index."""
        return candidates(model, self.whole)


@dataclass(frozen=True)
class Uniform:
    """Every k-th row and column of a grid, every k-th point of a cloud, so that about `count` are left."""

    count: int = 1000
    whole: bool = False
    anew: bool = False

    def __call__(self, model: Frame, rng: np.random.Generator) -> Index:
        """Return the chosen indices."""
        among = candidates(model, self.whole)
        if len(among) <= self.count:
            return among
        if model.pixel is None:
            return among[np.linspace(0, len(among) - 1, self.count).round().astype(np.intp)]
        step = max(1, int(np.floor(np.sqrt(len(among) / self.count))))
        on_grid = np.zeros(len(model), np.bool_)
        chosen = model.pixel[step // 2 :: step, step // 2 :: step].reshape(-1)
        on_grid[chosen[chosen >= 0]] = True
        return among[on_grid[among]]


@dataclass(frozen=True)
class Random:
    """`count` points at random, others in each iteration."""

    count: int = 1000
    whole: bool = False
    anew: bool = True

    def __call__(self, model: Frame, rng: np.random.Generator) -> Index:
        """Return the chosen indices."""
        among = candidates(model, self.whole)
        if len(among) <= self.count:
            return among
        return np.sort(rng.choice(among, self.count, replace=False))


@dataclass(frozen=True)
class NormalSpace:
    """`count` points whose normals spread over directions as evenly as they can."""

    count: int = 1000
    anew: bool = False

    def __call__(self, model: Frame, rng: np.random.Generator) -> Index:
        """Return the chosen indices."""
        among = candidates(model, whole=True)
        if len(among) <= self.count:
            return among
        n = model.normals[among]
        polar = (np.clip((1 + n[:, 2]) / 2, 0, 1 - 1e-9) * NORMAL_BINS).astype(np.intp)
        azimuth = ((np.arctan2(n[:, 1], n[:, 0]) / (2 * np.pi) + 0.5) % 1.0 * NORMAL_BINS).astype(np.intp)
        return _evenly(among, polar * NORMAL_BINS + azimuth, self.count, rng)


@dataclass(frozen=True)
class Curvature:
    """The `count` points of strongest curvature, spread over as many levels of it."""

    count: int = 1000
    anew: bool = False

    def __call__(self, model: Frame, rng: np.random.Generator) -> Index:
        """Return the chosen indices."""
        among = candidates(model, whole=True)
        if len(among) <= self.count:
            return among
        strength = np.abs(model.features[among]).sum(1)
        edges = np.linspace(0.0, float(np.percentile(strength, 99)) or 1.0, NORMAL_BINS**2)
        return _evenly(among, np.digitize(strength, edges), self.count, rng)


def _evenly(among: Index, bins: Index, count: int, rng: np.random.Generator) -> Index:
    """Return `count` of the points, one from each bin in turn."""
    order = rng.permutation(len(among))
    by_bin = order[np.argsort(bins[order], kind="stable")]
    sizes = np.unique(bins[by_bin], return_counts=True)[1]
    turn = np.arange(len(by_bin)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.sort(among[by_bin[np.argsort(turn, kind="stable")[:count]]])
