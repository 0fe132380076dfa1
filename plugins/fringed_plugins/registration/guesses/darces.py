"""Guesses by RANSAC-DARCES: three points at random, and every place where the other view has such a triangle.

Owns the search with rigid constraints. No feature is needed: the three distances leave few triangles, the normals
fewer, and more control points refute those.

References
----------
Chen, Hung, Cheng: RANSAC-based DARCES: a new approach to fast automatic registration of partially overlapping range
images, PAMI 1999.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.guesses.common import (
    Guess,
    Thinned,
    agreeing,
    net_overlaps,
    ranked,
    thinned,
    thinned_by,
)
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray

NAME = "ransac-darces"
THICKNESS = 1.1  # of a triangle: its two shorter sides by the longest


@dataclass(frozen=True)
class Darces:
    """How many triangles are tried, and how triangles agree.

    `side` of a triangle is a part of the smaller view's extent: as long as the overlap lets it be. `tolerance` of
    distances and of control points is in sides of the thinned cubes; `normals_deg` of the angles between normals and
    sides, 180 for the paper's own constraint, distances alone. `wanted` is the least net overlap of control points.
    """

    points: int = 450
    trials: int = 60
    side: tuple[float, float] = (0.2, 0.45)
    tolerance: float = 0.6
    normals_deg: float = 12.0
    control: int = 24
    wanted: float = 0.1
    most: int = 4000  # triangles of one trial
    kept: int = 5  # of their motions
    motions: int = 60


@dataclass(frozen=True)
class _Relations:
    """Distances (n, n) of every two points, and the cosines (n, n) between normals, and of normals to lines."""

    distance: FloatArray
    between: FloatArray
    along: FloatArray

    @classmethod
    def of(cls, some: Thinned) -> _Relations:
        d = some.points[None] - some.points[:, None]
        distance = np.sqrt((d**2).sum(2))
        along = np.einsum("ik,ijk->ij", some.normals, d) / np.maximum(distance, 1e-300)
        return cls(distance, some.normals @ some.normals.T, along)

    def like(self, other: _Relations, pair: tuple[int, int], off: tuple[float, float]) -> np.ndarray:
        """Return which ordered pairs (n, n) are like the other side's `pair`, by distance and by angles."""
        i, j = pair
        found: np.ndarray = np.abs(self.distance - other.distance[i, j]) < off[0]
        if off[1] < np.pi:
            for mine, its in (
                (self.between, other.between[i, j]),
                (self.along, other.along[i, j]),
                (self.along.T, other.along[j, i]),
            ):
                angle = float(np.arccos(np.clip(its, -1.0, 1.0)))
                found &= (mine > np.cos(min(angle + off[1], np.pi))) & (mine < np.cos(max(angle - off[1], 0.0)))
        return found


def ransac_darces(
    reference: Level,
    model: Level,
    options: Darces | None,
    rng: np.random.Generator,
    threads: int,
    *,
    report: Report = silent,
) -> list[Guess]:
    """Return the motions of `model` to `reference` by which most control points of random triangles meet it.

    The paper's exhaustive search for primary, secondary and auxiliary points, all at once instead of one after the
    other; angles of normals prune, which it leaves to options.

    Parameters
    ----------
    reference, model
        levels of about 1,500 to 7,000 points, of which `options.points` are used.
    rng
        chooses the triangles.

    Returns
    -------
    list
        at most 20 guesses, their scores the net overlap (`common.net_overlaps`); empty where no triangle was found
        again.

    Raises
    ------
    ValueError
        a view without 50 points with normals, or with points that are not finite.

    References
    ----------
    Chen, Hung, Cheng, PAMI 1999.
    """
    how = options or Darces()
    p = thinned(reference, how.points)
    q = thinned_by(model, p.side)
    on_p, on_q = _Relations.of(p), _Relations.of(q)
    sides = tuple(part * min(p.extent(), q.extent()) for part in how.side)
    found, scores = [np.empty((0, 4, 4))], [np.empty(0)]
    for trial in range(how.trials):
        report(0.9 * trial / how.trials, f"DARCES: triangle {trial + 1} of {how.trials}")
        triangle = _triangle(on_q, sides, rng)
        if triangle is None:
            continue
        T = laid(p.points[_found_again(on_p, on_q, triangle, how, p.side)], q.points[list(triangle)])
        control = rng.choice(len(q.points), min(how.control, len(q.points)), replace=False)
        some = Thinned(q.points[control], q.normals[control], q.side)
        score = net_overlaps(reference, some, T, how.tolerance * p.side, threads)
        best = np.argsort(-score, kind="stable")[: how.kept]
        best = best[score[best] > how.wanted]
        found.append(T[best])
        scores.append(score[best])
    report(0.9, "DARCES: overlaps")
    T, _ = agreeing(np.concatenate(found), np.concatenate(scores), q, how.motions)
    return ranked(T, net_overlaps(reference, q, T, how.tolerance * p.side, threads), NAME)


def _triangle(on: _Relations, sides: tuple[float, ...], rng: np.random.Generator) -> tuple[int, int, int] | None:
    """Return a random triangle of the model with sides between the limits, None where a few draws gave none.

    Three points almost on a line say nothing of the turn about it: they are drawn again.
    """
    right = (on.distance > sides[0]) & (on.distance < sides[1])
    for _ in range(20):
        a = int(rng.integers(len(right)))
        near = np.flatnonzero(right[a])
        if len(near) < 2:
            continue
        b = int(rng.choice(near))
        third = near[right[b, near]]
        if not len(third):
            continue
        c = int(rng.choice(third))
        lengths = sorted(on.distance[(a, a, b), (b, c, c)])
        if lengths[0] + lengths[1] > THICKNESS * lengths[2]:
            return a, b, c
    return None


def _found_again(p: _Relations, q: _Relations, triangle: tuple[int, int, int], how: Darces, side: float) -> np.ndarray:
    """Return the reference's triangles (k, 3) that are like the model's: primary, secondary, auxiliary points."""
    a, b, c = triangle
    off = how.tolerance * side, float(np.radians(how.normals_deg))
    first, second = np.nonzero(p.like(q, (a, b), off))
    if not len(first):
        return np.empty((0, 3), np.intp)
    which, third = np.nonzero(p.like(q, (a, c), off)[first] & p.like(q, (b, c), off)[second])
    some = slice(None, None, max(1, -(-len(which) // how.most)))
    return np.stack([first[which], second[which], third], axis=1)[some]


def laid(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the motions (k, 4, 4) that lay the triangle q (3, 3) on each triangle of p (k, 3, 3), corner by corner."""
    on_p, on_q = _frame(p), _frame(q[None])
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3] = np.swapaxes(on_p, 1, 2) @ on_q
    T[:, :3, 3] = p.mean(1) - T[:, :3, :3] @ q.mean(0)
    return T


def _frame(triangles: FloatArray) -> FloatArray:
    """Return an orthonormal frame (k, 3, 3), as rows, of each triangle (k, 3, 3)."""
    u = triangles[:, 1] - triangles[:, 0]
    w = np.cross(u, triangles[:, 2] - triangles[:, 0])
    u = u / np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-300)
    w = w / np.maximum(np.linalg.norm(w, axis=1, keepdims=True), 1e-300)
    return np.stack([u, np.cross(w, u), w], axis=1)
