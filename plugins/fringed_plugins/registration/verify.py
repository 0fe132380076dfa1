"""Whether a registration can be believed: overlap, residuals against noise, directions nobody holds.

Owns the judgement at the end and the covariance; never changes the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.icp import MIN_PAIRS, Paired, Settings, pair, weigh
from fringed_plugins.registration.matching import ClosestPoint
from fringed_plugins.registration.plane import information, jacobian, step
from fringed_plugins.registration.rejection import mad_scale
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray, apply, cross_matrix

NEAR = 1.5  # a partner within this many resolutions covers a point
GATE = 8.0  # a partner on the same side within this many resolutions can contradict
LEAST_AGREEING = 0.8  # right poses of scans have 0.86 and more, of range images of one rig 0.95
LEAST_INFORMATION = 5e-4  # smallest share of the pairs that has to hold each direction (slopes of 2.2 % rms)
OVER_SLOPE_NOISE = 10.0
NOISES = 5.0
OF_DIAGONAL = 1e-3


@dataclass(frozen=True)
class Limits:
    """What a believable result keeps; `max_rms_mm` 0 takes 5 x the noise or 0.1 % of the diagonal.

    `slack` multiplies the residual that is allowed.
    """

    min_overlap: float = 0.2
    max_rms_mm: float = 0.0
    slack: float = 1.0


@dataclass(frozen=True)
class Verdict:
    """What was found, and `fault` in words where the result cannot be believed (empty where it can)."""

    fault: str
    rms_mm: float
    overlap: float
    covariance: FloatArray | None


def verify(
    reference: Level, model: Level, T: FloatArray, limits: Limits, matcher: ClosestPoint, diagonal_mm: float
) -> Verdict:
    """Judge `T` (reference level's origin from model level's) on all points of both levels."""
    gate = GATE * reference.spacing_mm
    pairs = pair(reference, model, T, matcher, Settings(normals_cos=0.5, symmetric=False), gate)
    if len(pairs) < MIN_PAIRS:
        found = f"only {len(pairs)} of {pairs.asked} model points meet the reference"
        return Verdict(f"{found}: the views do not overlap", float("nan"), len(pairs) / max(pairs.asked, 1), None)
    noise = float(np.sqrt(np.median(pairs.variance_mm2)))
    allowed = limits.slack * (limits.max_rms_mm or max(NOISES * noise, OF_DIAGONAL * diagonal_mm))
    near = np.linalg.norm(pairs.points - pairs.partners, axis=1) < NEAR * reference.spacing_mm
    inlier = near & (np.abs(pairs.residual_mm) < max(3 * allowed, NOISES * noise))
    rms = _rms(pairs, inlier)
    overlap = _overlap(model, T, matcher, pairs, inlier)
    share = float(inlier.sum()) / len(pairs)
    eigenvalues, weakest = _held(pairs, inlier)
    least = max(LEAST_INFORMATION, OVER_SLOPE_NOISE * max(reference.slope_noise, model.slope_noise) ** 2)
    fault = ""
    if overlap < limits.min_overlap:
        fault = f"the overlap is {overlap:.1%}; at least {limits.min_overlap:.0%} is needed"
    elif share < LEAST_AGREEING:
        fault = f"{1 - share:.0%} of the pairs contradict each other; the surfaces do not fit there"
    elif rms > allowed:
        fault = f"the residual is {rms:.3g} RMS; {allowed:.3g} is allowed (the noise is {noise:.3g})"
    elif eigenvalues[0] < least:
        fault = f"{weakest} is not determined by the surface (information {eigenvalues[0]:.1e}, needed {least:.1e})"
    covariance = None if eigenvalues[0] < least else _covariance(pairs, inlier, noise)
    return Verdict(fault, rms, overlap, covariance)


def still_to_go(reference: Level, model: Level, T: FloatArray, matcher: ClosestPoint) -> float:
    """Return by how much, RMS over the model's points, one point-to-plane step would still move the model.

    A method that minimises something else stands where its own error is least; how far that is from where the
    surfaces meet is told by this.
    """
    pairs = pair(reference, model, T, matcher, Settings(normals_cos=0.5), GATE * reference.spacing_mm)
    if len(pairs) < MIN_PAIRS:
        return float("inf")
    weights, _ = weigh(pairs, 1e-6 * reference.spacing_mm)
    middle = 0.5 * (pairs.points + pairs.partners)
    small, _ = step(jacobian(middle, pairs.normals), pairs.residual_mm, weights)
    moved = small[3:] + np.cross(small[:3], pairs.points)
    return float(np.sqrt((moved**2).sum(1).mean()))


def in_frame(covariance: FloatArray, origin: FloatArray) -> FloatArray:
    """Return a covariance about `origin` (3,) as one about the frame's own origin."""
    J = np.eye(6)
    J[3:, :3] = cross_matrix(origin)
    moved: FloatArray = J @ covariance @ J.T
    return moved


def _rms(pairs: Paired, inlier: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> float:
    return float(np.sqrt(np.mean(pairs.residual_mm[inlier] ** 2))) if inlier.any() else float("inf")


def _overlap(
    model: Level,
    T: FloatArray,
    matcher: ClosestPoint,
    pairs: Paired,
    inlier: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> float:
    """Return the part of the model's points that lie on the reference, its boundary included."""
    points = model.points[model.interior]
    matches = matcher(apply(T, points), T)
    rim = ~matcher.reference.interior[matches.index] & (matches.distance_mm < matcher.reference.spacing_mm)
    return float(int(inlier.sum()) + int(rim.sum())) / max(len(points), 1)


def _held(pairs: Paired, inlier: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> tuple[FloatArray, str]:
    """Return the information in each direction as a share of the pairs, rising, and the weakest in words.

    About the pairs' middle, rotations in units of their radius, so that both kinds compare.
    """
    if not inlier.any():
        return np.zeros(6), "nothing"
    points = pairs.points[inlier] - pairs.points[inlier].mean(0)
    radius = float(np.sqrt((points**2).sum(1).mean())) or 1.0
    rows = jacobian(points / radius, pairs.normals[inlier])
    values, vectors = np.linalg.eigh(information(rows, np.full(len(points), 1.0 / len(points))))
    weak = vectors[:, 0]
    turn = bool(np.linalg.norm(weak[:3]) > np.linalg.norm(weak[3:]))
    part = weak[:3] if turn else weak[3:]
    axis = ", ".join(f"{x:.2f}" for x in part / np.linalg.norm(part))
    return np.maximum(values, 0.0), f"{'the rotation about' if turn else 'the shift along'} ({axis})"


def _covariance(
    pairs: Paired, inlier: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], noise_mm: float
) -> FloatArray | None:
    """Return sigma^2 H^-1 of the point-to-plane error (closed forms of point-to-point are wrong: Bonnabel 2014)."""
    if int(inlier.sum()) < MIN_PAIRS:
        return None
    weights, _ = weigh(pairs, 1e-3 * noise_mm)
    weights = weights * inlier
    scale = mad_scale(pairs.residual_mm[inlier])
    relative = weights * scale**2
    H = information(jacobian(pairs.points, pairs.normals), relative)
    try:
        inverted: FloatArray = scale**2 * np.linalg.inv(H)
    except np.linalg.LinAlgError:
        return None
    return 0.5 * (inverted + inverted.T)
