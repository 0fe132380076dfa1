"""Which reference point belongs to a model point: nearest in place, with invariants, on the grid, along normals.

Owns the policies of correspondence. A policy is prepared with the reference and then asked in each iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from fringed_plugins.registration.family.frames import Frame, Index
from fringed_plugins.registration.transforms import FloatArray

SHOTS = 3  # how often a normal is cut with the tangent plane at its last hit


@dataclass(frozen=True)
class Query:
    """Model points as they stand now: points and normals (n, 3), features (n, m), and alpha in units of length."""

    points: FloatArray
    normals: FloatArray
    features: FloatArray
    alpha: float


class Finder(Protocol):
    """A matching that knows its reference."""

    def __call__(self, query: Query) -> Index:
        """Return for each point the index of its reference point, -1 where it has none."""
        ...


class Matching(Protocol):
    """Find partners."""

    @property
    def by_features(self) -> bool:
        """Whether invariants are compared, so that alpha matters and points need whole windows."""
        ...

    def prepare(self, reference: Frame, threads: int) -> Finder:
        """Return the finder on a reference."""
        ...


@dataclass(frozen=True)
class Closest:
    """The closest point (Besl & McKay 1992), exactly, by a k-d tree (Zhang 1994)."""

    by_features: bool = False

    def prepare(self, reference: Frame, threads: int) -> Finder:
        """Return the finder on a reference."""

        def find(query: Query) -> Index:
            index: Index = reference.tree.query(query.points, workers=threads)[1]
            return index

        return find


@dataclass(frozen=True)
class InvariantFeatures:
    """The closest point in place and invariants: d = |p - q|^2 + a^2 |f_p - f_q|^2.

    The tree is built anew when alpha has changed by more than `stale`, for it is part of the metric.

    References
    ----------
    Sharp, Lee, Wehe: ICP registration using invariant features, PAMI 2002.
    """

    stale: float = 0.02
    by_features: bool = True

    def prepare(self, reference: Frame, threads: int) -> Finder:
        """Return the finder on the points of a reference whose window is whole."""
        at = np.flatnonzero(reference.whole)
        points, features = reference.points[at], reference.features[at]
        kept: list[tuple[float, cKDTree]] = []

        def find(query: Query) -> Index:
            if not kept or abs(query.alpha - kept[0][0]) > self.stale * kept[0][0]:
                tree = cKDTree(np.hstack([points, query.alpha * features]), balanced_tree=False, compact_nodes=False)
                kept[:] = [(query.alpha, tree)]
            alpha, tree = kept[0]
            index: Index = at[tree.query(np.hstack([query.points, alpha * query.features]), workers=threads)[1]]
            return index

        return find


@dataclass(frozen=True)
class Projective:
    """The point of the reference's grid that a point projects to, then the nearest of its neighbours.

    References
    ----------
    Blais & Levine 1995; Neugebauer 1997; the walk over 3 x 3 neighbours: Benjemaa & Schmitt 1999.
    """

    walks: int = 3
    by_features: bool = False

    def prepare(self, reference: Frame, threads: int) -> Finder:
        """Return the finder on a reference.

        Raises
        ------
        ValueError
            the reference is no grid.
        """
        if reference.pixel is None or reference.projection is None:
            raise ValueError(f"the {reference.name} is no grid: projective matching needs an organised range image")
        pixel, P = np.pad(reference.pixel, 1, constant_values=-1), reference.projection
        height, width = reference.pixel.shape

        def find(query: Query) -> Index:
            uvw = query.points @ P[:, :3].T + P[:, 3]
            ahead = uvw[:, 2] > 1e-6
            place = np.rint(np.where(ahead[:, None], uvw[:, :2], -9.0) / np.where(ahead, uvw[:, 2], 1.0)[:, None])
            column, row = np.clip(place, -2, max(height, width) + 2).astype(np.intp).T
            inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
            column, row = np.clip(column, 0, width - 1), np.clip(row, 0, height - 1)
            for _ in range(self.walks):
                column, row = _step(reference.points, pixel, query.points, column, row)
            return np.where(inside, pixel[row + 1, column + 1], -1)

        return find


def _step(points: FloatArray, pixel: Index, wanted: FloatArray, column: Index, row: Index) -> tuple[Index, Index]:
    """Return the nearest of each pixel and its eight neighbours; `pixel` has a rim of -1."""
    height, width = pixel.shape
    best = np.full(len(wanted), np.inf)
    to_column, to_row = column, row
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            r, c = np.clip(row + dr, 0, height - 3), np.clip(column + dc, 0, width - 3)
            index = pixel[r + 1, c + 1]
            off = np.where(index >= 0, ((points[index] - wanted) ** 2).sum(1), np.inf)
            nearer = off < best
            best, to_column, to_row = (
                np.where(nearer, off, best), np.where(nearer, c, to_column), np.where(nearer, r, to_row)
            )  # fmt: skip
    return to_column, to_row


@dataclass(frozen=True)
class NormalShooting:
    """The reference point nearest to where the model's normal cuts the reference.

    References
    ----------
    Chen & Medioni: Object modelling by registration of multiple range images, IVC 1992: cut the normal with the
    tangent plane at the last hit, again and again.
    """

    by_features: bool = False

    def prepare(self, reference: Frame, threads: int) -> Finder:
        """Return the finder on a reference with normals."""

        def find(query: Query) -> Index:
            index: Index = reference.tree.query(query.points, workers=threads)[1]
            for _ in range(SHOTS):
                n = reference.normals[index]
                slope = np.einsum("ij,ij->i", n, query.normals)
                off = np.einsum("ij,ij->i", n, reference.points[index] - query.points)
                along = np.where(np.abs(slope) > 0.2, off / np.where(slope == 0, 1.0, slope), 0.0)
                hit = query.points + along[:, None] * query.normals
                index = reference.tree.query(hit, workers=threads)[1]
            return index

        return find
