"""The loop of the iterative closest point: match, reject, weigh, move, until it stands still.

Owns the order of the steps and the reasons for stopping; the steps are others'.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.matching import Matcher
from fringed_plugins.registration.plane import MOST_TURN_RAD, jacobian, limited, motion, step
from fringed_plugins.registration.rejection import mad_scale, tukey_weights, zhang_limit
from fringed_plugins.registration.result import Iteration
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray, apply, orthonormal, turned

MIN_PAIRS = 30
SWINGS = 4  # changing pairs can keep the loop swinging within its own uncertainty for ever


@dataclass(frozen=True)
class Settings:
    """When to stop and which pairs count; `stage` names the loop in its history."""

    iterations: int = 40
    still: float = 3e-4  # motion of the points in one iteration, in resolutions, that counts as standing
    swing: float = 0.1  # the same in standard errors of the motion, for some iterations in a row
    normals_cos: float = 0.7
    symmetric: bool = True
    stage: str = "fine"


@dataclass(frozen=True)
class Paired:
    """Pairs in the reference's frame: model points, their partners, the error's direction, residuals."""

    points: FloatArray
    partners: FloatArray
    normals: FloatArray
    residual_mm: FloatArray
    variance_mm2: FloatArray
    asked: int
    threshold_mm: float
    index: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.residual_mm)


@dataclass(frozen=True)
class Outcome:
    """Where one stage of the loop ended and why."""

    T_reference_model: FloatArray
    stopped: str
    settled: bool
    history: tuple[Iteration, ...]


def pair(
    reference: Level,
    model: Level,
    T: FloatArray,
    matcher: Matcher,
    settings: Settings,
    limit_mm: float | None = None,
) -> Paired:
    """Return the pairs that count: normals agree, partner not on the boundary, not beyond Zhang's limit."""
    points, normals, sigma = model.inner()
    moved, facing_now = apply(T, points), turned(T[:3, :3], normals)
    matches = matcher(moved, T)
    facing = reference.normals[matches.index]
    agree = np.einsum("ij,ij->i", facing, facing_now)
    keep = np.flatnonzero(reference.interior[matches.index] & (agree > settings.normals_cos))
    distance = matches.distance_mm[keep]
    if limit_mm is None:
        limit_mm = zhang_limit(distance, reference.spacing_mm) if keep.size else 0.0
    near = keep[distance <= limit_mm]
    index = matches.index[near]
    n = facing[near] + facing_now[near] if settings.symmetric else facing[near].copy()
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    partners = reference.points[index]
    residual = np.einsum("ij,ij->i", moved[near] - partners, n)
    variance = sigma[near] ** 2 + reference.sigma_mm[index] ** 2
    return Paired(moved[near], partners, n, residual, variance, len(points), limit_mm, near)


def weigh(pairs: Paired, floor_mm: float) -> tuple[FloatArray, float]:
    """Return the weights in 1 / mm^2, Tukey's times inverse variance, and the residuals' scale in mm.

    Residuals beyond what the sensor's noise explains (curvature between samples, calibration) add the same
    variance to every pair, so that noise counts only as far as it dominates.
    """
    scale = max(mad_scale(pairs.residual_mm), floor_mm)
    typical = float(np.median(pairs.variance_mm2))
    variance = pairs.variance_mm2 + max(scale**2 - typical, 0.0)
    return tukey_weights(pairs.residual_mm, scale) / variance, scale


def iterate(
    reference: Level,
    model: Level,
    T: FloatArray,
    matcher: Matcher,
    settings: Settings,
    tell: Callable[[Iteration], None],
) -> Outcome:
    """Run the loop on one level from `T`; `tell` hears of every iteration and may raise to stop."""
    history: list[Iteration] = []
    swinging = 0
    radius = float(np.sqrt((model.points**2).sum(1).mean()))
    stopped, settled = f"{settings.iterations} iterations without standing still", False
    for _ in range(settings.iterations):
        pairs = pair(reference, model, T, matcher, settings)
        if len(pairs) < MIN_PAIRS:
            stopped = f"{len(pairs)} pairs left of {pairs.asked}; at least {MIN_PAIRS} are needed"
            break
        weights, _ = weigh(pairs, 1e-6 * reference.spacing_mm)
        middle = 0.5 * (pairs.points + pairs.partners)
        small, H = step(jacobian(middle, pairs.normals), pairs.residual_mm, weights)
        small = limited(small, MOST_TURN_RAD, radius)
        T = orthonormal(motion(small) @ T)
        turn, shift = float(np.linalg.norm(small[:3])), float(np.linalg.norm(small[3:]))
        rms = float(np.sqrt(np.average(pairs.residual_mm**2, weights=weights)))
        history.append(Iteration(rms, len(pairs), pairs.threshold_mm, turn, shift, settings.stage))
        tell(history[-1])
        errors = float(np.sqrt(small @ H @ small / 6))
        swinging = swinging + 1 if errors < settings.swing else 0
        if turn * radius + shift < settings.still * reference.spacing_mm:
            stopped, settled = f"the motion fell below {settings.still:g} of the resolution", True
            break
        if swinging == SWINGS:
            stopped, settled = f"{SWINGS} motions in a row were below {settings.swing:g} of their standard error", True
            break
    return Outcome(T, stopped, settled, tuple(history))
