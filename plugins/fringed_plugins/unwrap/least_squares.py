"""Weighted least-squares spatial unwrapping of one wrapped phase map.

Owns the conjugate gradients and what is made of their solution; the loops are in `poisson`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.unwrap import poisson
from fringed_plugins.unwrap.checking import check_range, sealed, weights, wrapped_phase
from fringed_plugins.unwrap.finishing import finish
from fringed_plugins.unwrap.regions import connected_regions

Float32Array = npt.NDArray[np.float32]
Told = Callable[[int, float], None]


class LeastSquares(NamedTuple):
    """An unwrapped phase, its regions as in `Unwrapped`, and how the iteration ended.

    `residual` is that of the equation over its right side. Where it did not converge, `phase_rad` is what
    the last iteration gave.
    """

    phase_rad: npt.NDArray[np.floating[Any]]
    regions: npt.NDArray[np.int32]
    sizes: tuple[int, ...]
    converged: bool
    reason: str
    iterations: int
    residual: float


class Limits(NamedTuple):
    """When to stop: `residual` over the right side, or after so many `iterations`."""

    residual: float = 1e-4
    iterations: int = 200


_DEFAULT = Limits()


def unwrap_least_squares(
    wrapped_rad: npt.NDArray[Any],
    quality: npt.NDArray[Any] | None = None,
    min_region_px: int = 1,
    *,
    congruent: bool = True,
    limits: Limits = _DEFAULT,
    told: Told | None = None,
    threads: int = 0,
) -> LeastSquares:
    """Unwrap a phase (height, width) in [-pi, pi] rad so that its differences fit the wrapped ones best.

    The weighted sum of squared misfits is minimised by conjugate gradients, preconditioned by the
    unweighted equation's solution (cosine transforms). Weights are 0 where the phase is unknown, else
    `quality` over its median, at most 1. `congruent` adds to the wrapped phase the multiples of 2 pi that
    come nearest to the solution; otherwise the smooth solution itself is returned, which noise flattens.
    `told` is called with iteration and residual; what it raises ends the work.

    Raises
    ------
    ValueError
        arrays of other shapes; a phase beyond [-pi, pi].

    References
    ----------
    Ghiglia, Romero 1994, J. Opt. Soc. Am. A 11, 107, algorithm 3.

    Examples
    --------
    >>> ramp = np.linspace(0, 20, 50)[None, :] + np.zeros((5, 1))
    >>> result = unwrap_least_squares(np.angle(np.exp(1j * ramp)))
    >>> bool(np.ptp(result.phase_rad - ramp) < 1e-5), result.converged
    (True, True)
    """
    original = wrapped_phase(wrapped_rad)
    factors = weights(quality, original.shape)
    phase = sealed(original.astype(np.float32))
    weight, largest = np.empty_like(phase), np.empty(phase.shape[0], np.float32)
    run_rows(poisson.weight_rows, phase.shape[0], phase, factors, weight, largest, threads=threads)
    check_range(float(largest.max()))
    solution, ending = _solve(phase, weight, limits, told or _ignore, threads)
    known = np.isfinite(phase)
    first = connected_regions(known) - np.int32(1)
    count = int(first.max(initial=-1)) + 1
    misfit = np.where(known, solution - phase, 0) if congruent else solution
    if congruent:
        misfit -= np.append(_offsets(misfit, first, count), 0)[first]
    turns = np.rint(misfit / (2 * np.pi)).astype(np.int32)
    source = original if congruent else sealed((solution - 2 * np.pi * turns).astype(original.dtype))
    alone = (count, np.arange(count, dtype=np.int32), np.zeros(count, np.int32))
    done = finish(source, (first, turns), alone, min_region_px, threads)
    return LeastSquares(done.phase_rad, done.regions, done.sizes, *ending)


def _ignore(iteration: int, residual: float) -> None:
    """Take no notice of how far the work is."""


def _solve(
    phase: Float32Array, weight: Float32Array, limits: Limits, told: Told, threads: int
) -> tuple[Float32Array, tuple[bool, str, int, float]]:
    """Return the solution, and whether it converged, why it ended, after how many iterations, with what residual."""
    height, sums = phase.shape[0], np.empty(phase.shape[0])
    across, down = np.empty((2, *phase.shape), np.float32), np.empty((2, *phase.shape), np.float32)
    residual, solution = np.empty_like(phase), np.zeros_like(phase)
    run_rows(poisson.gradient_rows, height, phase, weight, across, down, threads=threads)
    run_rows(poisson.divergence_rows, height, across, down, residual, sums, threads=threads)
    start, misfit = float(sums.sum()), 1.0
    if start == 0:
        return solution, (True, "nothing to unwrap: no phase differs from its neighbours", 0, 0.0)
    inverse = poisson.inverse_eigenvalues((height, phase.shape[1]))
    direction, image, before = np.zeros_like(phase), np.empty_like(phase), 0.0
    for iteration in range(1, limits.iterations + 1):
        guess = poisson.solve_unweighted(residual, inverse, threads)
        run_rows(poisson.dot_rows, height, residual, guess, sums, threads=threads)
        power = float(sums.sum())
        run_rows(
            poisson.turn_rows, height, np.float32(power / before if before else 0), guess, direction, threads=threads
        )
        run_rows(poisson.operator_rows, height, direction, (across, down), image, sums, threads=threads)
        bend = float(sums.sum())
        if not bend > 0:
            return solution, (False, "the equation is singular to rounding", iteration, misfit)
        fields, before = (solution, residual, direction, image), power
        run_rows(poisson.step_rows, height, np.float32(power / bend), fields, sums, threads=threads)
        misfit = float(np.sqrt(sums.sum() / start))
        told(iteration, misfit)
        if misfit <= limits.residual:
            return solution, (True, f"the residual fell below {limits.residual:g}", iteration, misfit)
    return solution, (False, f"no convergence in {limits.iterations} iterations", limits.iterations, misfit)


def _offsets(misfit: Float32Array, first: npt.NDArray[np.int32], count: int) -> npt.NDArray[np.float32]:
    """Return for each region the mean direction of what the solution misses of the wrapped phase, rad."""
    numbers = first.ravel() + 1
    sine = np.bincount(numbers, np.sin(misfit).ravel(), count + 1)[1:]
    cosine = np.bincount(numbers, np.cos(misfit).ravel(), count + 1)[1:]
    return np.arctan2(sine, cosine).astype(np.float32)
