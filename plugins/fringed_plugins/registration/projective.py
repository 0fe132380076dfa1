"""The last stage of the default method: all points of both views, foot to foot on smooth patches.

Owns the loop that walks to feet, weighs by noise, truncation and Tukey, and moves; and the covariance of what it finds.
It starts where an earlier stage has ended, within some resolutions. Knows nothing of guesses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.patch_kernels import SUMS, accumulate, variances, walk, walk_alone
from fringed_plugins.registration.patches import Array, Patches, worth
from fringed_plugins.registration.plane import motion
from fringed_plugins.registration.rejection import mad_scale
from fringed_plugins.registration.result import Iteration
from fringed_plugins.registration.transforms import FloatArray, orthonormal

MIN_FEET = 60
NEAR = 0.5  # of the motion's own standard error: from there on all points
STILL = 0.02  # the same, where the loop ends
SWING = 0.2  # the same for three motions in a row: feet at the rim come and go
ITERATIONS = 20
COME_AND_GO = 5  # steps; then points without a foot stay away
EXACT = 1e-7  # of the extent: motions below are rounding
STALLED = 3e-7  # of the extent: motions below that no longer shrink, where noise is none
ALONE = 200_000  # points that one thread takes some milliseconds for
FEW = 10_000  # points that medians are taken of


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
    their foot: the curvature between samples is in the patch. Both sides are best
    `patches.sharp` ones. At most
    `most_points` are moved until they are near; then every point tells.

    References
    ----------
    Chen & Medioni 1992; Pottmann et al. 2006: distances to the squared distance function's patches, so that the
    loop converges quadratically.
    """
    loop = _Loop(tell, iterations)
    everything = int(model.usable.sum())
    if everything > most_points:
        T = loop.run(_Pairing(reference, model, most_points), T, NEAR)
    both = _Pairing(reference, model, everything)
    T = loop.run(both, T, STILL)
    covariance = None if loop.H is None else _covariance(loop.H, both.worth)
    rms = loop.history[-1].rms_mm if loop.history else float("nan")
    return Feet(T, covariance, loop.settled, loop.stopped, rms, both.expected_mm, tuple(loop.history))


class _Loop:
    """Gauss and Newton's steps, how they ended, and the last normal matrix `H`, None where there was no foot."""

    def __init__(self, tell: Callable[[Iteration], None], iterations: int) -> None:
        self.tell, self.iterations = tell, iterations
        self.history: list[Iteration] = []
        self.H: FloatArray | None = None
        self.settled, self.stopped = False, ""

    def run(self, both: _Pairing, T: FloatArray, still: float) -> FloatArray:
        """Return where steps below `still` standard errors, or none, are left to make."""
        self.H, self.settled = None, False
        self.stopped = f"{self.iterations} iterations without standing still"
        diagonal = both.fixed.surface.diagonal_mm
        swings, last, began = 0, float("inf"), len(self.history)
        while len(self.history) < self.iterations:
            if len(self.history) >= began + COME_AND_GO:
                both.keep()
            made = both.normal_equations(T)
            if made is None:
                self.stopped = f"fewer than {MIN_FEET} of {len(both.samples)} points have a foot on the reference"
                break
            self.H, g, scale, count, rms = made
            try:
                small = -np.linalg.solve(self.H, g)
            except np.linalg.LinAlgError:
                self.stopped = "the surface does not hold every direction"
                break
            T = orthonormal(motion(small) @ T)
            turn, shift = float(np.linalg.norm(small[:3])), float(np.linalg.norm(small[3:]))
            self.history.append(Iteration(rms, count, 4.685 * scale, turn, shift, "fine"))
            self.tell(self.history[-1])
            errors = np.sqrt(max(float(small @ self.H @ small), 0.0) * both.worth / 6)
            tiny = turn * diagonal + shift
            swings = swings + 1 if errors < SWING else 0
            stalled, last = tiny > 0.5 * last and tiny < STALLED * diagonal, tiny
            if errors < still or swings == 3 or stalled or tiny < EXACT * diagonal:
                self.settled, self.stopped = True, "the motion fell below its own uncertainty"
                break
        return T


class _Pairing:
    """Every s-th of the model's points and the reference that they fall on; each has the `worth` of so many points."""

    def __init__(self, fixed: Patches, moving: Patches, most_points: int) -> None:
        self.fixed = fixed
        self.samples, pixels, stands_for = moving.sample(most_points)
        self.worth = worth(moving.window_px, round(float(np.sqrt(stands_for))))
        self.own = variance_at(moving, pixels, self.samples[:, 3:6])
        self.found = np.full(len(self.samples), -1, np.int64)
        self.rows = np.zeros((len(self.samples), 8))
        self.expected_mm = float("nan")

    def keep(self) -> None:
        """Drop the points that have no foot, for good: at the rim they would come and go for ever."""
        met = self.found >= 0
        self.samples, self.own = self.samples[met], self.own[met]
        self.found, self.rows = self.found[met], self.rows[met]

    def normal_equations(self, T: FloatArray) -> tuple[FloatArray, FloatArray, float, int, float] | None:
        """Return H and g in units of the residuals' variance, the scale, how many pairs, and their RMS."""
        fixed = self.fixed
        reach = walk_alone if len(self.samples) < ALONE else walk
        reach(self.samples, np.vstack([T, fixed.projection]), fixed.table, fixed.usable, self.found, self.rows)
        met = self.found >= 0
        count = int(met.sum())
        if count < MIN_FEET:
            return None
        other = variance_at(fixed, self.found, self.rows[:, 3:6])
        few = max(1, count // FEW)
        some = np.flatnonzero(met[::few]) * few
        expected2 = fixed.gain * float(np.median(self.own[some] + other[some]))
        self.expected_mm = float(np.sqrt(expected2))
        scale = max(mad_scale(self.rows[some, 6]), 1e-9 * fixed.surface.spacing_mm)
        # a point of the reference meets as many of the model's as lie in its area
        variance = self.own + other * (self.rows[:, 7] / self.samples[:, 6])
        # what noise does not explain adds the same variance to every pair
        more = max(scale**2 - expected2, 0.0) / fixed.gain
        sums = np.zeros(SUMS)
        accumulate(self.found, self.rows, variance, scale, more + 1e-30, sums)
        H = np.zeros((6, 6))
        H[np.triu_indices(6)] = sums[:21]
        H = H + np.triu(H, 1).T
        rms = float(np.sqrt(sums[28] / sums[27])) if sums[27] > 0 else float("inf")
        return H, sums[21:27].copy(), scale, count, rms


def variance_at(side: Patches, pixels: npt.NDArray[np.int64], normals: FloatArray) -> Array:
    """Return the variance along `normals` (n, 3) of single points at flat `pixels` (n,), with what patches cut off."""
    out = np.empty(len(pixels))
    table, errors = side.table.reshape(-1, 15), side.errors.reshape(-1, 2)
    variances(pixels, normals, table, errors, side.surface.origin, out)
    return out


def _covariance(H: FloatArray, each: float) -> FloatArray | None:
    """Return the covariance of the motion: a smoothed point stands for the points around it, not for itself.

    H counts every sample once, with the variance of single points; neighbours share their points, so that a sample is
    worth `each` of them.
    """
    try:
        inverse = np.linalg.inv(H)
    except np.linalg.LinAlgError:
        return None
    covariance = np.asarray(inverse / each, np.float64)
    return 0.5 * (covariance + covariance.T)
