"""What methods of guessing share: evenly thinned points, motions that agree, the overlap that a motion makes.

Owns no method. Lengths are in whatever unit the levels have; nothing depends on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray, orthonormal, rigid

Array = npt.NDArray[Any]
ALIKE_RAD = 0.21  # motions within 12 degrees and
ALIKE_PART = 0.12  # within this part of the model's diameter are one guess
SAME_SIDE_COS = 0.8
SCORED = 400
MOST = 20
LEAST_POINTS = 50
CONTRADICTED = 5.0  # tolerances from the reference's interior within which a point that does not fit speaks against
COST = 0.3  # of such a point, where one that fits exactly counts 1


@dataclass(frozen=True)
class Guess:
    """A motion that may be right: `T_reference_model` (4, 4) between the levels, a score to compare within a method."""

    T_reference_model: FloatArray
    score: float
    method: str


@dataclass(frozen=True)
class Thinned:
    """Points (n, 3) of a level's interior spread evenly in space, `side` apart, with their unit normals (n, 3)."""

    points: FloatArray
    normals: FloatArray
    side: float

    def size(self) -> tuple[FloatArray, float]:
        """Return the points' middle and the RMS distance from it."""
        middle: FloatArray = self.points.mean(0)
        return middle, float(np.sqrt(((self.points - middle) ** 2).sum(1).mean()))

    def extent(self) -> float:
        """Return the diagonal of the box around the points."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def thinned(level: Level, count: int) -> Thinned:
    """Return about `count` points of the level's interior, one in each cube of a grid that has something in it.

    A grid of pixels is dense where the surface faces the sensor; cubes are as full in one view as in another.

    Raises
    ------
    ValueError
        fewer than 50 points with normals, points that are not finite, or all in one place.
    """
    points, normals = _oriented(level)
    side = 0.5 * float(np.linalg.norm(np.ptp(points, axis=0))) / np.sqrt(count)
    at = _one_per_cube(points, side)
    for _ in range(5):
        if abs(len(at) / count - 1) < 0.1 or len(at) == len(points):
            break
        side *= np.sqrt(len(at) / count)
        at = _one_per_cube(points, side)
    return Thinned(points[at], normals[at], max(side, level.spacing_mm))


def thinned_by(level: Level, side: float) -> Thinned:
    """Return one point of the level's interior in each cube of the given side; errors as of `thinned`."""
    points, normals = _oriented(level)
    at = _one_per_cube(points, side)
    return Thinned(points[at], normals[at], max(side, level.spacing_mm))


def _oriented(level: Level) -> tuple[FloatArray, FloatArray]:
    points, normals, _ = level.inner()
    if len(points) < LEAST_POINTS:
        raise ValueError(
            f"a view has {len(points)} points with normals of {len(level.points)}; guesses need at least "
            f"{LEAST_POINTS}: check its mask, or take a level of more points"
        )
    if not (np.isfinite(level.points).all() and np.isfinite(normals).all()):
        raise ValueError("a view has points or normals that are not finite: leave them out of the level")
    if not np.ptp(points, axis=0).any():
        raise ValueError(f"all {len(points)} points of a view coincide; a motion needs a surface")
    return points, normals


def _one_per_cube(points: FloatArray, side: float) -> npt.NDArray[np.intp]:
    """Return the indices of the points nearest to the mean of each cube's points."""
    cube = np.floor(points / side).astype(np.int64)
    cube -= cube.min(0)
    wide = cube.max(0) + 1
    _, which, count = np.unique((cube[:, 0] * wide[1] + cube[:, 1]) * wide[2] + cube[:, 2], return_inverse=True,
                                return_counts=True)  # fmt: skip
    mean = np.stack([np.bincount(which, points[:, axis]) / count for axis in range(3)], axis=1)
    order = np.lexsort((((points - mean[which]) ** 2).sum(1), which))
    first = np.concatenate([[True], np.diff(which[order]) > 0])
    return np.sort(order[first])


def frames(normals: FloatArray) -> FloatArray:
    """Return a right-handed frame (n, 3, 3) at each unit normal (n, 3): rows u, v and the normal."""
    away = np.where(np.abs(normals[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = away - (away * normals).sum(1, keepdims=True) * normals
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.stack([u, np.cross(normals, u), normals], axis=1)


def overlaps(reference: Level, model: Thinned, T: FloatArray, tolerance: float, threads: int) -> FloatArray:
    """Return for each motion (k, 4, 4) how much of the model lies on the reference, 0 to 1, closer counting more.

    A point counts 1 - (residual / tolerance)^2, residuals along the reference's normal, where both normals agree.
    """
    good, residual, _ = _matched(reference, model, T, tolerance, 2 * tolerance, threads)
    share: FloatArray = np.where(good, 1 - residual**2, 0.0).mean(1)
    return share


def net_overlaps(reference: Level, model: Thinned, T: FloatArray, tolerance: float, threads: int) -> FloatArray:
    """Return for each motion (k, 4, 4) the overlap, less what contradicts it: -0.3 to 1.

    A point that is within 5 tolerances of the reference's interior and does not fit there counts -0.3. A smooth view
    slides over another one with more overlap than there is; such points refute that.
    """
    good, residual, inner = _matched(reference, model, T, tolerance, CONTRADICTED * tolerance, threads)
    share: FloatArray = (np.where(good, 1 - residual**2, 0.0) - COST * (inner & ~good)).mean(1)
    return share


def _matched(
    reference: Level, model: Thinned, T: FloatArray, tolerance: float, reach: float, threads: int
) -> tuple[Array, FloatArray, Array]:
    """Return (k, n) which points fit, the residuals in tolerances, and which are near the reference's interior."""
    some = np.linspace(0, len(model.points) - 1, min(SCORED, len(model.points))).round().astype(np.intp)
    moved = model.points[some] @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    turned = model.normals[some] @ np.swapaxes(T[:, :3, :3], 1, 2)
    found = reference.tree.query(moved.reshape(-1, 3), distance_upper_bound=reach, workers=threads)
    near = np.isfinite(found[0]).reshape(moved.shape[:2])
    index = np.where(near, found[1].reshape(near.shape), 0)
    n = reference.normals[index]
    residual = np.einsum("kni,kni->kn", moved - reference.points[index], n) / tolerance
    good = near & (np.einsum("kni,kni->kn", n, turned) > SAME_SIDE_COS) & (np.abs(residual) < 1)
    return good, residual, near & reference.interior[index]


def agreeing(T: FloatArray, votes: FloatArray, model: Thinned, most: int) -> tuple[FloatArray, FloatArray]:
    """Return at most `most` means of motions that are alike, and the sum of their votes, most votes first.

    Parameters
    ----------
    T
        (k, 4, 4) motions; some thousands at most, since every two are compared.
    votes
        (k,) how much speaks for each.
    model
        what is moved: motions are alike where they bring its middle to the same place with the same rotation.
    """
    R, (middle, radius) = T[:, :3, :3], model.size()
    place = R @ middle + T[:, :3, 3]
    # of two rotations by an angle apart, the matrices are 2 sqrt(2) sin(angle / 2) apart
    code = np.concatenate([R.reshape(-1, 9) / (np.sqrt(2) * ALIKE_RAD), place / (2 * ALIKE_PART * radius)], axis=1)
    square = (code**2).sum(1)
    apart = np.maximum(square[:, None] + square - 2 * code @ code.T, 0.0)
    support = (apart < 1) @ votes
    means, sums, covered = [], [], np.zeros(len(T), np.bool_)
    for i in np.argsort(-support, kind="stable"):
        if covered[i] or support[i] <= 0:
            continue
        covered |= apart[i] < 2
        alike = np.flatnonzero(apart[i] < 1)
        share = votes[alike] / votes[alike].sum()
        mean = orthonormal(rigid(np.einsum("k,kij->ij", share, R[alike]), np.zeros(3)))
        mean[:3, 3] = share @ place[alike] - mean[:3, :3] @ middle
        means.append(mean)
        sums.append(float(support[i]))
        if len(means) == most:
            break
    return np.array(means).reshape(-1, 4, 4), np.array(sums)


def ranked(T: FloatArray, score: FloatArray, method: str, most: int = MOST) -> list[Guess]:
    """Return the motions (k, 4, 4) as at most `most` guesses by falling score, those of no score left out."""
    order = [i for i in np.argsort(-score, kind="stable")[:most] if score[i] > 0]
    return [Guess(T[i], float(score[i]), method) for i in order]
