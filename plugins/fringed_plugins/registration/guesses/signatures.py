"""Guesses by point signatures: the heights of the surface above a circle around a point, by the angle.

Owns signatures and their comparison at every turn. A match of two says the whole motion: the points, their normals, and
the turn about them at which the heights agree.

References
----------
Chua, Jarvis: Point signatures: a new representation for 3D object recognition, IJCV 1997.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fringed_plugins.registration.guesses.common import (
    Guess,
    Thinned,
    agreeing,
    frames,
    overlaps,
    ranked,
    thinned,
    thinned_by,
)
from fringed_plugins.registration.guesses.pairs import facing
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray

NAME = "point-signatures"
BRIDGED = 2  # directions without a point that are filled, from each side of a gap


@dataclass(frozen=True)
class PointSignatures:
    """Points that take part, radii of the spheres as parts of the smaller view's extent, directions of a turn.

    `tolerance` of the overlap is in sides of the thinned reference's cubes.
    """

    reference_points: int = 900
    signed: int = 300
    radii: tuple[float, ...] = (0.07, 0.14)
    directions: int = 24
    alike: int = 3
    motions: int = 40
    tolerance: float = 1.5


def point_signatures(
    reference: Level,
    model: Level,
    options: PointSignatures | None,
    rng: np.random.Generator,
    threads: int,
    *,
    report: Report = silent,
) -> list[Guess]:
    """Return the motions of `model` to `reference` that most points of like signatures agree on, best first.

    Three departures from the paper, for noise: signatures are compared at every turn rather than from the highest
    point on, a model point's one vote is shared by the reference points that look like it, and there are two radii.

    Parameters
    ----------
    reference, model
        levels of about 1,500 to 7,000 points.
    rng
        chooses nothing here: the method is deterministic.

    Returns
    -------
    list
        at most 20 guesses, their scores votes times overlap; empty where no circle is complete.

    Raises
    ------
    ValueError
        a view without 50 points with normals, or with points that are not finite.

    References
    ----------
    Chua, Jarvis, IJCV 1997.
    """
    how = options or PointSignatures()
    p = thinned(reference, how.reference_points)
    q = thinned_by(model, p.side)
    some = np.unique(np.linspace(0, len(q.points) - 1, min(how.signed, len(q.points))).round().astype(np.intp))
    few = Thinned(q.points[some], q.normals[some], q.side)
    radii = [part * min(p.extent(), q.extent()) for part in how.radii]
    on_p, on_q = frames(p.normals), frames(few.normals)
    report(0.0, "signatures: the reference's")
    at_p, signed_p = _signed(reference, p, on_p, radii, how.directions)
    report(0.5, "signatures: the model's")
    at_q, signed_q = _signed(model, few, on_q, radii, how.directions)
    if not len(at_p) or not len(at_q):
        return []
    report(0.7, "signatures: compared")
    best, who, turn, votes = compared(signed_p, signed_q, how.alike)
    i, j = at_p[best], at_q[who]
    T, votes = agreeing(facing(p.points[i], on_p[i], few.points[j], on_q[j], turn), votes, q, how.motions)
    if not len(T):
        return []
    return ranked(T, votes * overlaps(reference, q, T, how.tolerance * p.side, threads), NAME)


def _signed(
    level: Level, centres: Thinned, on: FloatArray, radii: list[float], directions: int
) -> tuple[np.ndarray, FloatArray]:
    """Return which centres have all their circles complete, and their signatures (k, radii, directions)."""
    points, _, _ = level.inner()
    thickness = max(level.spacing_mm, centres.side / 2)
    near = cKDTree(centres.points).sparse_distance_matrix(
        cKDTree(points), max(radii) + thickness, output_type="ndarray"
    )
    whole, out = np.ones(len(centres.points), np.bool_), []
    for radius in radii:
        shell = np.abs(near["v"] - radius) < thickness
        i = near["i"][shell]
        local = np.einsum("kij,kj->ki", on[i], points[near["j"][shell]] - centres.points[i])
        # a point of the shell stands for the one on the sphere in its direction
        height = local[:, 2] * radius / np.maximum(near["v"][shell], 1e-300)
        direction = np.arctan2(local[:, 1], local[:, 0]) % (2 * np.pi)
        bins = np.minimum((direction * directions / (2 * np.pi)).astype(np.intp), directions - 1)
        cell = i * directions + bins
        count = np.bincount(cell, minlength=len(whole) * directions).reshape(-1, directions)
        total = np.bincount(cell, height, len(whole) * directions).reshape(-1, directions)
        mean, complete = bridged(total / np.maximum(count, 1), count > 0)
        whole &= complete
        out.append(_above_their_plane(mean) / radius)
    return np.flatnonzero(whole), np.stack(out, axis=1)[whole]


def bridged(values: FloatArray, known: np.ndarray) -> tuple[FloatArray, np.ndarray]:
    """Return circles of values (k, directions) with small gaps filled from both sides, and which are whole."""
    for _ in range(BRIDGED):
        left, right = np.roll(known, 1, axis=1), np.roll(known, -1, axis=1)
        beside = np.roll(values, 1, axis=1) * left + np.roll(values, -1, axis=1) * right
        fill = ~known & (left | right)
        values = np.where(fill, beside / np.maximum(1 * left + 1 * right, 1), values)
        known = known | fill
    return values, known.sum(axis=1) == known.shape[1]


def _above_their_plane(height: FloatArray) -> FloatArray:
    """Return heights over the plane through the point that is parallel to the circle's own: the paper's distances.

    A tilt of the plane is one wave around the circle; the paper fits the plane to the circle and moves it to the point.
    """
    waves = np.fft.rfft(height, axis=1)
    waves[:, 1] = 0
    flat: FloatArray = np.fft.irfft(waves, height.shape[1], axis=1)
    return flat


def compared(p: FloatArray, q: FloatArray, alike: int) -> tuple[np.ndarray, np.ndarray, FloatArray, FloatArray]:
    """Return the reference's best signatures for each of the model's, whose they are, the turns in rad and votes."""
    directions = p.shape[2]
    waves_p, waves_q = np.fft.rfft(p, axis=2), np.fft.rfft(q, axis=2)
    crossed = np.einsum("prw,qrw->qpw", waves_p, np.conj(waves_q))  # of all radii: they turn together
    correlation = np.fft.irfft(crossed, directions, axis=2)
    shift = correlation.argmax(axis=2)
    energy_p, energy_q = (p**2).sum((1, 2)), (q**2).sum((1, 2))
    apart = np.maximum(energy_q[:, None] + energy_p - 2 * correlation.max(axis=2), 0.0)
    k = min(alike, apart.shape[1])
    best = np.argpartition(apart, k - 1, axis=1)[:, :k]
    scale = max(float(np.median(apart.min(axis=1))), 1e-300)
    like = np.exp(-0.5 * apart / scale)
    share = np.take_along_axis(like, best, axis=1) / np.maximum(like.sum(axis=1, keepdims=True), 1e-300)
    turn = np.take_along_axis(shift, best, axis=1) * 2 * np.pi / directions
    return best.ravel(), np.repeat(np.arange(len(q)), k), turn.ravel(), share.ravel()
