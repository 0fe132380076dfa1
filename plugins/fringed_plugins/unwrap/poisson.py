"""The weighted Poisson equation of least-squares unwrapping: its operator and its preconditioner.

Owns the loops over rows and the cosine transforms; `least_squares` iterates. Sums are kept by row, so that
they do not depend on how rows are spread over threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows
from fringed_plugins.unwrap.reliability import TWO_PI, turns_between

Float32Array = npt.NDArray[np.float32]

_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def weight_rows(start: int, stop: int, phase: Any, factors: Any, weight: Any, largest: Any) -> None:
    """Write the weights of some rows: 0 where the phase is unknown, else the quality over its middle, at most 1.

    `factors` are (quality, middle); a quality of 0 rows is none.
    """
    quality, middle = factors
    for row in range(start, stop):
        most = np.float32(0)
        for x in range(phase.shape[1]):
            size = abs(phase[row, x])
            fine = size < np.float32(np.inf)
            value = np.float32(1)
            if quality.size > 0:
                value = min(quality[row, x] / middle, np.float32(1)) if quality[row, x] > 0 else np.float32(0)
            weight[row, x] = value if fine else np.float32(0)
            most = max(most, size) if fine else most
        largest[row] = most


@njit(**_options)
def gradient_rows(start: int, stop: int, phase: Any, weight: Any, across: Any, down: Any) -> None:
    """Write weights and weighted wrapped differences to the right (2, height, width) and downwards, 0 at the end."""
    height, width = phase.shape
    for row in range(start, stop):
        across[:, row, width - 1] = 0
        for x in range(width - 1):
            w = min(weight[row, x], weight[row, x + 1])
            raw = phase[row, x + 1] - phase[row, x]
            across[0, row, x] = w * w
            across[1, row, x] = w * w * (raw - TWO_PI * turns_between(raw)) if w > 0 else np.float32(0)
        for x in range(width):
            w = min(weight[row, x], weight[row + 1, x]) if row + 1 < height else np.float32(0)
            raw = phase[min(row + 1, height - 1), x] - phase[row, x]
            down[0, row, x] = w * w
            down[1, row, x] = w * w * (raw - TWO_PI * turns_between(raw)) if w > 0 else np.float32(0)


@njit(**_options)
def divergence_rows(start: int, stop: int, across: Any, down: Any, out: Any, squares: Any) -> None:
    """Write minus the divergence of the weighted differences, and each row's sum of squares."""
    for row in range(start, stop):
        total = 0.0
        for x in range(out.shape[1]):
            value = -across[1, row, x] - down[1, row, x]
            value += across[1, row, x - 1] if x > 0 else np.float32(0)
            value += down[1, row - 1, x] if row > 0 else np.float32(0)
            out[row, x] = value
            total += np.float64(value) * value
        squares[row] = total


@njit(**_options)
def operator_rows(start: int, stop: int, field: Any, weights: Any, out: Any, products: Any) -> None:
    """Write minus the weighted Laplacian of `field`, and each row's sum of `field * out`."""
    across, down = weights
    height, width = field.shape
    for row in range(start, stop):
        total = 0.0
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        for x in range(width):
            here = field[row, x]
            value = across[0, row, x] * (here - field[row, min(x + 1, width - 1)])
            value += down[0, row, x] * (here - field[below, x])
            value += down[0, above, x] * (here - field[above, x]) if row > 0 else np.float32(0)
            value += across[0, row, x - 1] * (here - field[row, x - 1]) if x > 0 else np.float32(0)
            out[row, x] = value
            total += np.float64(value) * here
        products[row] = total


@njit(**_options)
def step_rows(start: int, stop: int, size: Any, fields: Any, squares: Any) -> None:
    """Go `size` along the direction: change solution and residual, and sum each row's squared residual."""
    solution, residual, direction, image = fields
    for row in range(start, stop):
        total = 0.0
        for x in range(solution.shape[1]):
            solution[row, x] += size * direction[row, x]
            left = residual[row, x] - size * image[row, x]
            residual[row, x] = left
            total += np.float64(left) * left
        squares[row] = total


@njit(**_options)
def dot_rows(start: int, stop: int, a: Any, b: Any, products: Any) -> None:
    """Write each row's sum of products."""
    for row in range(start, stop):
        total = 0.0
        for x in range(a.shape[1]):
            total += np.float64(a[row, x]) * b[row, x]
        products[row] = total


@njit(**_options)
def turn_rows(start: int, stop: int, factor: Any, guess: Any, direction: Any) -> None:
    """Replace the direction by the guess plus `factor` times the direction before."""
    for row in range(start, stop):
        for x in range(guess.shape[1]):
            direction[row, x] = guess[row, x] + factor * direction[row, x]


def solve_unweighted(right: Float32Array, inverse: Float32Array, threads: int) -> Float32Array:
    """Return the field whose unweighted minus Laplacian is `right` (height, width), but for a constant.

    `inverse` is that of `eigenvalues`. Both transforms are done along rows, then along columns, in bands.
    """
    from scipy.fft import dct, idct

    field = np.empty_like(right)

    def rows(start: int, stop: int, transform: Any, source: Float32Array) -> None:
        field[start:stop] = transform(source[start:stop], axis=1)

    def columns(start: int, stop: int, transform: Any) -> None:
        field[:, start:stop] = transform(field[:, start:stop], axis=0)

    height, width = right.shape
    run_rows(rows, height, dct, right, threads=threads)
    run_rows(columns, width, dct, threads=threads)
    np.multiply(field, inverse, out=field)
    run_rows(columns, width, idct, threads=threads)
    run_rows(rows, height, idct, field, threads=threads)
    return field


def inverse_eigenvalues(shape: tuple[int, int]) -> Float32Array:
    """Return one over the eigenvalues of minus the Laplacian with free edges, 0 for the constant."""
    vertical, horizontal = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in shape)
    values = vertical[:, None] + horizontal
    values[0, 0] = np.inf
    return np.asarray(1 / values, np.float32)
