"""The last stage of the default method: all points of both views, foot to foot on smooth patches.

Owns the loop that walks to feet, weighs by noise and Tukey, and moves; and the covariance of what it finds.
It starts where an earlier stage has ended, within some resolutions. Knows nothing of guesses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fringed_plugins.registration.patch_kernels import SUMS, accumulate, walk
from fringed_plugins.registration.patches import Array, Patches
from fringed_plugins.registration.plane import motion
from fringed_plugins.registration.rejection import mad_scale
from fringed_plugins.registration.result import Iteration
from fringed_plugins.registration.surface import LEAST_COSINE
from fringed_plugins.registration.transforms import FloatArray, orthonormal

MIN_FEET = 60
STILL = 0.02  # of the motion's own standard error
SWING = 0.2  # the same for three motions in a row: feet at the rim come and go
ITERATIONS = 20
EXACT = 1e-7  # of the extent: motions below are rounding
STALLED = 3e-7  # of the extent: motions below that no longer shrink, where noise is none


@dataclass(frozen=True)
class Feet:
    """Where the loop ended: `T_reference_model` between origins, and its covariance about the reference's origin."""

    T_reference_model: FloatArray
    covariance: FloatArray | None
    settled: bool
    stopped: str
    rms_mm: float
    expected_mm: float
    history: tuple[Iteration, ...]


def refine(
    reference: Patches,
    model: Patches,
    T: FloatArray,
    tell: Callable[[Iteration], None],
    most_points: int = 40_000,
    iterations: int = ITERATIONS,
) -> Feet:
    """Return the motion that brings `model` onto `reference`, from `T` (between their origins) on.

    Residuals are distances of the model's smoothed points to the reference's smooth patches, along the normal at
    their foot: the curvature between samples is in the patch, and smoothing errs alike on both sides.

    References
    ----------
    Chen & Medioni 1992; Pottmann et al. 2006: distances to the squared distance function's patches, so that the
    loop converges quadratically.
    """
    samples, pixels, stands_for = model.sample(most_points)
    both = _Pairing(reference, samples, _variance_at(model, pixels, samples[:, 3:6]))
    history: list[Iteration] = []
    stopped, settled = f"{iterations} iterations without standing still", False
    swings, last = 0, float("inf")
    state: FloatArray | None = None
    for _ in range(iterations):
        made = both.normal_equations(T)
        if made is None:
            stopped = f"fewer than {MIN_FEET} of {len(samples)} points have a foot on the reference"
            break
        H, g, scale, count, rms = made
        state = H
        try:
            small = -np.linalg.solve(H, g)
        except np.linalg.LinAlgError:
            stopped = "the surface does not hold every direction"
            break
        T = orthonormal(motion(small) @ T)
        history.append(
            Iteration(
                rms, count, 4.685 * scale, float(np.linalg.norm(small[:3])), float(np.linalg.norm(small[3:])), "fine"
            )
        )
        tell(history[-1])
        errors = np.sqrt(max(float(small @ H @ small), 0.0) * stands_for / 6)
        tiny = float(np.linalg.norm(small[:3])) * reference.surface.diagonal_mm + float(np.linalg.norm(small[3:]))
        swings = swings + 1 if errors < SWING else 0
        stalled, last = tiny > 0.5 * last and tiny < STALLED * reference.surface.diagonal_mm, tiny
        if errors < STILL or swings == 3 or stalled or tiny < EXACT * reference.surface.diagonal_mm:
            stopped, settled = "the motion fell below its own uncertainty", True
            break
    covariance = None if state is None else _covariance(state, stands_for)
    rms = history[-1].rms_mm if history else float("nan")
    return Feet(T, covariance, settled, stopped, rms, both.expected_mm, tuple(history))


def _variance_at(side: Patches, pixels: Array, normals: FloatArray) -> FloatArray:
    """Return the variance along the normal of single points at flat `pixels`."""
    sigma: Any = side.surface.noise_mm if side.surface.sigma is None else side.surface.sigma.reshape(-1)[pixels]
    ray = side.table.reshape(-1, 15)[pixels, :3] + side.surface.origin
    length = np.sqrt(np.einsum("ij,ij->i", ray, ray))
    cosine = np.einsum("ij,ij->i", ray, normals) / np.maximum(length, 1e-12)
    cosine = np.maximum(np.abs(cosine), LEAST_COSINE)
    variance: FloatArray = np.asarray((sigma * cosine) ** 2, np.float64)
    return variance


class _Pairing:
    """Model points and the reference that they fall on."""

    def __init__(self, reference: Patches, samples: FloatArray, variance: FloatArray) -> None:
        self.reference, self.samples, self.own = reference, samples, variance
        self.found = np.full(len(samples), -1, np.int64)
        self.rows = np.empty((len(samples), 8), np.float64)
        self.expected_mm = float("nan")

    def normal_equations(self, T: FloatArray) -> tuple[FloatArray, FloatArray, float, int, float] | None:
        """Return H and g in units of the residuals' variance, the scale, how many pairs, and their RMS."""
        fixed = self.reference
        walk(self.samples, np.vstack([T, fixed.projection]), fixed.table, fixed.usable, self.found, self.rows)
        met = np.flatnonzero(self.found >= 0)
        if len(met) < MIN_FEET:
            return None
        residual = self.rows[met, 6]
        own, other = self.own[met], _variance_at(fixed, self.found[met], self.rows[met, 3:6])
        expected2 = fixed.gain * float(np.median(own + other))
        self.expected_mm = float(np.sqrt(expected2))
        scale = max(mad_scale(residual), 1e-9 * fixed.surface.spacing_mm)
        # a point of the reference meets as many of the model's as lie in its area
        variance = np.full(len(self.samples), np.inf)
        variance[met] = own + other * (self.rows[met, 7] / self.samples[met, 6])
        # what noise does not explain adds the same variance to every pair
        more = max(scale**2 - expected2, 0.0) / fixed.gain
        sums = np.zeros(SUMS)
        accumulate(self.found, self.rows, variance, scale, more + 1e-30, sums)
        H = np.zeros((6, 6))
        H[np.triu_indices(6)] = sums[:21]
        H = H + np.triu(H, 1).T
        rms = float(np.sqrt(sums[28] / sums[27])) if sums[27] > 0 else float("inf")
        return H, sums[21:27].copy(), scale, len(met), rms


def _covariance(H: FloatArray, stands_for: float) -> FloatArray | None:
    """Return the covariance of the motion: a smoothed point stands for the points around it, not for itself.

    H counts every sample once, with the variance of single points; neighbours share their points, so that
    `stands_for` of them are what a sample is worth.
    """
    try:
        inverse = np.linalg.inv(H)
    except np.linalg.LinAlgError:
        return None
    covariance = np.asarray(inverse / stands_for, np.float64)
    return 0.5 * (covariance + covariance.T)
