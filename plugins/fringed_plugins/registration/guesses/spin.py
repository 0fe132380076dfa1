"""Guesses by spin images: how the surface around a point looks when it spins about the point's normal.

Owns spin images, their similarity and the matches; groups of matches come from `consistent`.

References
----------
Johnson, Hebert: Using spin images for efficient object recognition in cluttered 3D scenes, PAMI 1999; Surface
matching for object recognition in complex three-dimensional scenes, Image and Vision Computing 1998.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fringed_plugins.registration.guesses.common import Guess, Thinned, agreeing, overlaps, ranked, thinned, thinned_by
from fringed_plugins.registration.guesses.consistent import Grouping, Matches, motions
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray

NAME = "spin-images"
PORTION = 300  # images between two reports


@dataclass(frozen=True)
class SpinImages:
    """Points that take part, image size and matches.

    A bin is as wide as the thinned points' cubes, the paper's mesh resolution; `bins` of them across and along the
    normal. Surface whose normal is more than `support_deg` off is left out: it may be hidden in the other view.
    """

    points: int = 1500
    spun: int = 400
    bins: int = 10
    support_deg: float = 60.0
    alike: int = 3
    matches: int = 700
    tolerance: float = 2.0


def spin_images(
    reference: Level,
    model: Level,
    options: SpinImages | None,
    rng: np.random.Generator,
    threads: int,
    *,
    report: Report = silent,
) -> list[Guess]:
    """Return the motions of `model` to `reference` that points of like spin images agree on, best first.

    Parameters
    ----------
    reference, model
        levels of about 1,500 to 7,000 points, thinned evenly here: spin images count points.
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
    Johnson, Hebert, PAMI 1999.
    """
    how = options or SpinImages()
    p = thinned(reference, how.points)
    q = thinned_by(model, p.side)
    on_p, images_p = spun(p, p.side, how, len(p.points), lambda part, text: report(0.4 * part, text))
    on_q, images_q = spun(q, p.side, how, how.spun, lambda part, text: report(0.4 + 0.2 * part, text))
    report(0.6, "spin images: matches")
    at_p, at_q = _matched(images_p, images_q, how)
    matches = Matches(p.points[on_p[at_p]], p.normals[on_p[at_p]], q.points[on_q[at_q]], q.normals[on_q[at_q]])
    groups = motions(matches, Grouping(apart=4 * p.side), lambda part, text: report(0.7 + 0.2 * part, text))
    T, votes = agreeing(*groups, q, 40)
    if not len(T):
        return []
    report(0.9, "spin images: overlaps")
    return ranked(T, votes * overlaps(reference, q, T, how.tolerance * p.side, threads), NAME)


def spun(
    surface: Thinned, bin_width: float, how: SpinImages, most: int, report: Report = silent
) -> tuple[np.ndarray, FloatArray]:
    """Return the indices of at most `most` points, and their spin images (k, bins * bins), counts of points."""
    at = np.unique(np.linspace(0, len(surface.points) - 1, min(most, len(surface.points))).round().astype(np.intp))
    tree, images = cKDTree(surface.points), []
    for begin in range(0, len(at), PORTION):
        report(begin / len(at), "spin images")
        images.append(_images(surface, tree, at[begin : begin + PORTION], bin_width, how))
    return at, np.concatenate(images)


def _images(surface: Thinned, tree: cKDTree, at: np.ndarray, bin_width: float, how: SpinImages) -> FloatArray:
    reach = bin_width * how.bins * np.hypot(1.0, 0.5)
    near = cKDTree(surface.points[at]).sparse_distance_matrix(tree, reach, output_type="ndarray")
    i, j = near["i"], near["j"]
    n = surface.normals[at]
    seen = np.einsum("ij,ij->i", n[i], surface.normals[j]) > np.cos(np.radians(how.support_deg))
    i, j = i[seen], j[seen]
    d = surface.points[j] - surface.points[at][i]
    beta = np.einsum("ij,ij->i", n[i], d)
    alpha = np.sqrt(np.maximum((d**2).sum(1) - beta**2, 0.0))
    column, row = alpha / bin_width - 0.5, beta / bin_width + 0.5 * how.bins - 0.5
    return _spread(i, column, row, (len(at), how.bins))


def _spread(which: np.ndarray, column: FloatArray, row: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return images with each point spread over the four bins around it (bilinear, as in the paper)."""
    count, bins = size
    left, low = np.floor(column).astype(np.intp), np.floor(row).astype(np.intp)
    image = np.zeros(count * bins * bins)
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        x, y = np.maximum(left + dx, 0), low + dy  # what is nearer to the axis than half a bin stays in the first one
        weight = (1 - np.abs(column - left - dx)) * (1 - np.abs(row - y))
        inside = (x < bins) & (y >= 0) & (y < bins)
        cell = (which[inside] * bins + y[inside]) * bins + x[inside]
        image += np.bincount(cell, weight[inside], len(image))
    return image.reshape(count, bins * bins)


def similarity(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return Johnson's similarity (len(a), len(b)) of spin images: atanh(R)^2 - lambda / (N - 3).

    R is the correlation over the N bins that are filled in both: what one view does not show does not count. lambda
    is such that images with half the usual number of common bins lose as much as the typical similarity.
    """
    in_a, in_b = (a > 0).astype(np.float64), (b > 0).astype(np.float64)
    n = in_a @ in_b.T
    sum_a, sum_b = a @ in_b.T, in_a @ b.T
    square_a, square_b = n * ((a**2) @ in_b.T) - sum_a**2, n * (in_a @ (b**2).T) - sum_b**2
    R = (n * (a @ b.T) - sum_a * sum_b) / np.sqrt(np.maximum(square_a * square_b, 1e-12))
    usual = float(np.median(n))
    raised = np.arctanh(np.clip(R, 0.0, 0.999)) ** 2
    weight = 0.5 * usual * float(np.median(raised))
    enough = n > max(0.5 * usual, 4.0)
    out: FloatArray = np.where(enough, raised - weight / np.maximum(n - 3, 1.0), -np.inf)
    return out


def _matched(p: FloatArray, q: FloatArray, how: SpinImages) -> tuple[np.ndarray, np.ndarray]:
    """Return indices of matches: model images and the reference's most similar ones, by how far they stand out."""
    like = similarity(q, p)
    k = min(how.alike, like.shape[1])
    best = np.argpartition(-like, k - 1, axis=1)[:, :k]
    value = np.take_along_axis(like, best, axis=1)
    usual = np.median(np.where(np.isfinite(like), like, 0.0), axis=1, keepdims=True)
    order = np.argsort(-(value - usual).ravel(), kind="stable")[: how.matches]
    order = order[np.isfinite(value.ravel()[order])]
    return best.ravel()[order], order // k
