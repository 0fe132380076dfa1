"""Guesses by local features: fast point feature histograms, and groups of alike points that one motion explains.

Owns the choice of points, their matches and the options; histograms are made in `feature_kernels`, groups in
`consistent`.

References
----------
Rusu, Blodow, Beetz: Fast point feature histograms (FPFH) for 3D registration, ICRA 2009.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fringed_plugins.registration.guesses.common import (
    Array,
    Guess,
    Thinned,
    agreeing,
    overlaps,
    ranked,
    thinned,
    thinned_by,
)
from fringed_plugins.registration.guesses.consistent import Grouping, Matches, motions
from fringed_plugins.registration.guesses.feature_kernels import blended, simple
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import Level

NAME = "local-features"


@dataclass(frozen=True)
class LocalFeatures:
    """Points that take part, the surroundings that are described, and matches.

    `radius` and `tolerance` (of the overlap) are in sides of the thinned reference's cubes. Of the model `described`
    points are matched, each with the `alike` reference points that look most like it; the `matches` that stand out
    most go on.
    """

    points: int = 1500
    described: int = 600
    radius: float = 6.0
    alike: int = 3
    matches: int = 900
    tolerance: float = 2.0


def local_features(
    reference: Level,
    model: Level,
    options: LocalFeatures | None,
    rng: np.random.Generator,
    threads: int,
    *,
    report: Report = silent,
) -> list[Guess]:
    """Return the motions of `model` to `reference` that points of like surroundings agree on, best first.

    Histograms as in the paper. Its sampling of triples is replaced by groups that are geometrically consistent
    (Johnson, Hebert 1999), which needs no luck. Points are thinned evenly, or a histogram would depend on where the
    sensor stood.

    Parameters
    ----------
    reference, model
        levels of about 1,500 to 7,000 points.
    rng
        chooses nothing here: the method is deterministic.

    Returns
    -------
    list
        at most 20 guesses, their scores group sizes times overlap; empty where nothing agrees.

    Raises
    ------
    ValueError
        a view without 50 points with normals, or with points that are not finite.

    References
    ----------
    Rusu, Blodow, Beetz, ICRA 2009.
    """
    how = options or LocalFeatures()
    p = thinned(reference, how.points)
    q = thinned_by(model, p.side)
    report(0.0, "features: the reference's")
    described_p = histograms(p, how.radius * p.side)
    report(0.3, "features: the model's")
    described_q = histograms(q, how.radius * p.side)
    report(0.5, "features: matches")
    some = np.unique(np.linspace(0, len(q.points) - 1, min(how.described, len(q.points))).round().astype(np.intp))
    at_p, at_q = _matched(described_p, described_q[some], how)
    at_q = some[at_q]
    matches = Matches(p.points[at_p], p.normals[at_p], q.points[at_q], q.normals[at_q])
    groups = motions(matches, Grouping(apart=4 * p.side), lambda part, text: report(0.6 + 0.3 * part, text))
    T, votes = agreeing(*groups, q, 40)
    if not len(T):
        return []
    report(0.9, "features: overlaps")
    return ranked(T, votes * overlaps(reference, q, T, how.tolerance * p.side, threads), NAME)


def histograms(surface: Thinned, radius: float) -> Array:
    """Return the square roots of fast point feature histograms (n, 33): distances between them are Hellinger's."""
    pairs = cKDTree(surface.points).query_pairs(radius, output_type="ndarray").astype(np.int32)
    out: Array = np.sqrt(blended(surface.points, pairs, simple(surface.points, surface.normals, pairs)))
    return out


def _matched(p: Array, q: Array, how: LocalFeatures) -> tuple[Array, Array]:
    """Return indices of matches of model points, those that stand out most of what looks like everything first."""
    like = q @ p.T
    k = min(how.alike, like.shape[1])
    best = np.argpartition(-like, k - 1, axis=1)[:, :k]
    stands_out = np.take_along_axis(like, best, axis=1) - like.mean(axis=1, keepdims=True)
    order = np.argsort(-stands_out.ravel(), kind="stable")[: how.matches]
    return best.ravel()[order], order // k
