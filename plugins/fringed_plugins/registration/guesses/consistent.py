"""Groups of correspondences that a rigid motion can have made: Johnson's geometric consistency.

Owns the test of two correspondences and the growth of groups. Knows nothing of where correspondences come from.

References
----------
Johnson, Hebert: Using spin images for efficient object recognition in cluttered 3D scenes, PAMI 1999, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.minimisers import by_svd
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
LEAST_GROUP = 4
PORTION = 10  # seeds and
ROWS = 200  # rows of the table of all pairs between two reports


@dataclass(frozen=True)
class Matches:
    """Correspondences: oriented points `p` with normals `n` of the reference, `q` with `m` of the model, all (k, 3)."""

    p: FloatArray
    n: FloatArray
    q: FloatArray
    m: FloatArray


@dataclass(frozen=True)
class Grouping:
    """How groups grow.

    `threshold` of the consistency; `apart`, a length below which two correspondences tell little; at most so many
    groups of at most so many members.
    """

    apart: float
    threshold: float = 0.15
    groups: int = 150
    most: int = 25


def motions(matches: Matches, how: Grouping, report: Report = silent) -> tuple[FloatArray, FloatArray]:
    """Return the motions (k, 4, 4) of the groups of those matches that fit most others, and the groups' sizes (k,).

    `report` hears the part of the seeds that is done, 0 to 1.
    """
    fits = consistency(matches, how.apart, lambda part, text: report(0.7 * part, text))
    agree = fits < how.threshold
    found, sizes = [], []
    taken = np.zeros(len(fits), np.bool_)
    seeds = np.argsort(-agree.sum(1), kind="stable")
    for number in range(how.groups):
        if number % PORTION == 0:
            report(0.7 + 0.3 * number / how.groups, "groups")
        left = seeds[~taken[seeds]]
        if not len(left):
            break
        group = _grown(int(left[0]), fits, how)
        taken[group] = True  # a seed that is in a group already would grow the same one
        if len(group) < LEAST_GROUP:
            continue
        try:
            T = by_svd(matches.q[group], matches.p[group])
        except ValueError:  # a group on a line is no guess
            continue
        found.append(T)
        sizes.append(float(len(group)))
    return np.array(found).reshape(-1, 4, 4), np.array(sizes)


def consistency(matches: Matches, apart: float, report: Report = silent) -> FloatArray:
    """Return how badly every two correspondences fit one motion (k, k): 0 exactly, infinite for themselves.

    The larger of both directions' differences of spin coordinates, as a part of their size, more where they are near.
    """
    count = len(matches.p)
    out = np.empty((count, count))
    for begin in range(0, count, ROWS):
        report(begin / count, "consistency")
        rows = slice(begin, begin + ROWS)
        a, b = _spin_coordinates(matches.p, matches.n, rows), _spin_coordinates(matches.q, matches.m, rows)
        size = 0.5 * (np.hypot(*a) + np.hypot(*b))
        difference = np.hypot(a[0] - b[0], a[1] - b[1]) / np.maximum(size, 1e-300)
        out[rows] = np.where(size > 0, difference / np.maximum(1 - np.exp(-size / apart), 1e-12), np.inf)
    np.fill_diagonal(out, np.inf)
    worse: FloatArray = np.maximum(out, out.T)
    return worse


def _spin_coordinates(x: FloatArray, n: FloatArray, rows: slice) -> tuple[FloatArray, FloatArray]:
    """Return all points' distances from the normals' lines of some, and the heights along them, (rows, k)."""
    beta = n[rows] @ x.T - np.einsum("ij,ij->i", n[rows], x[rows])[:, None]
    square = (x**2).sum(1)
    apart = np.maximum(square[rows, None] + square - 2 * x[rows] @ x.T, 0.0)
    return np.sqrt(np.maximum(apart - beta**2, 0.0)), beta


def _grown(seed: int, fits: FloatArray, how: Grouping) -> list[int]:
    """Return the group of a seed: always the next that fits best with the worst of those that are in it."""
    group, worst = [seed], fits[seed].copy()
    while len(group) < how.most:
        best = int(np.argmin(worst))
        if worst[best] > how.threshold:
            break
        group.append(best)
        worst = np.maximum(worst, fits[best])
    return group
