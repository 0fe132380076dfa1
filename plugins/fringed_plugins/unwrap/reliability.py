"""How much each pixel of a wrapped phase can be trusted, from its neighbourhood.

Owns the measure that orders the pairs of neighbours; knows nothing of how they are joined.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

PER_TURN = np.float32(0.5 / np.pi)
TWO_PI = np.float32(2 * np.pi)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to an integer
_NAN = np.float32(np.nan)
_ZERO, _ONE, _HALF, _FEW = np.float32(0), np.float32(1), np.float32(0.5), np.float32(1e-6)
_LONE_BEND = np.float32(9.0)  # rad^2, where no second difference is known
_LEAST_WEIGHT, _GREATEST_WEIGHT = np.float32(0.5), np.float32(10.0)
_KNOWN = 4  # rows 0 to 3 of a stack are differences, rows 4 to 7 are 1 where they are known
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def turns_between(difference: Any) -> Any:
    """Return the whole turns, as a float, that are nearest to a difference in rad; NaN stays NaN."""
    return (difference * PER_TURN + _ROUND) - _ROUND


@njit(**_options)
def _differences(before: Any, after: Any, out: Any, known: Any) -> None:
    """Write the wrapped differences `after - before`, 0 where unknown, and 1 where they are known."""
    for x in range(out.size):
        raw = after[x] - before[x]
        wrapped = raw - TWO_PI * turns_between(raw)
        fine = not np.isnan(wrapped)
        out[x] = wrapped if fine else _ZERO
        known[x] = _ONE if fine else _ZERO


@njit(**_options)
def _fill(phase: Any, row: int, stack: Any) -> None:
    """Write into `stack` (8, width + 2) what belongs to `row` and the row below.

    Entry x of rows 0 to 3: the difference from pixel x - 1 to x; from pixel x - 1 to the one below it;
    falling, from (row, x - 1) to (row + 1, x); rising, from (row, x) to (row + 1, x - 1).
    """
    height, width = phase.shape
    stack[:] = _ZERO
    if row < 0 or row >= height:
        return
    here = phase[row]
    _differences(here[: width - 1], here[1:], stack[0, 1:width], stack[_KNOWN, 1:width])
    if row + 1 < height:
        below = phase[row + 1]
        _differences(here, below, stack[1, 1 : width + 1], stack[_KNOWN + 1, 1 : width + 1])
        _differences(here[: width - 1], below[1:], stack[2, 1:width], stack[_KNOWN + 2, 1:width])
        _differences(here[1:], below[: width - 1], stack[3, 1:width], stack[_KNOWN + 3, 1:width])


@njit(**_options)
def _variance(sums: Any, squares: Any, counts: Any, value: Any, known: Any) -> None:
    """Add a row of differences to running sums."""
    for x in range(sums.size):
        sums[x] += value[x]
        squares[x] += value[x] * value[x]
        counts[x] += known[x]


@njit(**_options)
def _spread(sums: Any, squares: Any, counts: Any, first: int, offsets: int, out: Any) -> None:
    """Add to `out` the variance of the differences in `offsets` columns from `first`; 0 where there is none."""
    for x in range(out.size):
        total, square, count = _ZERO, _ZERO, _FEW
        for i in range(offsets):
            total += sums[x + first + i]
            square += squares[x + first + i]
            count += counts[x + first + i]
        mean = total / count
        out[x] += max(square / count - mean * mean, _ZERO)


@njit(**_options)
def _bends(above: Any, here: Any, out: Any) -> None:
    """Write four times the mean square of the known second differences of a row, rad^2."""
    a0, a1, k0, k1 = here[0], here[0, 1:], here[_KNOWN], here[_KNOWN, 1:]
    b0, b1, l0, l1 = above[1, 1:], here[1, 1:], above[_KNOWN + 1, 1:], here[_KNOWN + 1, 1:]
    c0, c1, m0, m1 = above[2], here[2, 1:], above[_KNOWN + 2], here[_KNOWN + 2, 1:]
    d0, d1, n0, n1 = above[3, 1:], here[3], above[_KNOWN + 3, 1:], here[_KNOWN + 3]
    for x in range(out.size):
        a, ka = a1[x] - a0[x], k0[x] * k1[x]
        b, kb = b1[x] - b0[x], l0[x] * l1[x]
        c, kc = c1[x] - c0[x], m0[x] * m1[x]
        d, kd = d1[x] - d0[x], n0[x] * n1[x]
        known = ka + kb + kc + kd
        square = a * a * ka + b * b * kb + c * c * kc + d * d * kd
        out[x] = np.float32(4) * square / known if known > _ZERO else _LONE_BEND


@njit(**_options)
def _finish(phase: Any, weight: Any, bends: Any, cost: Any) -> Any:
    """Turn variances in `cost` into costs, NaN where the phase is unknown; return the largest |phase|."""
    largest = _ZERO
    for x in range(cost.size):
        value = np.float32(2) * np.sqrt(cost[x]) + _HALF * np.sqrt(bends[x])
        size = abs(phase[x])
        fine = size < np.float32(np.inf)
        cost[x] = value * weight[x] if fine else _NAN
        size = size if fine else _ZERO
        largest = size if size > largest else largest
    return largest


@njit(**_options)
def _weigh(quality: Any, middle: Any, weight: Any) -> None:
    """Write factors of the cost: 1 at the middle quality, more where it is lower or unknown."""
    for x in range(weight.size):
        factor = _HALF + _HALF * middle / quality[x]
        factor = factor if factor < _GREATEST_WEIGHT else _GREATEST_WEIGHT
        factor = factor if quality[x] > _ZERO else _GREATEST_WEIGHT
        weight[x] = factor if factor > _LEAST_WEIGHT else _LEAST_WEIGHT


@njit(**_options)
def cost_rows(start: int, stop: int, phase: Any, factors: Any, cost: Any, largest: Any) -> None:
    """Write how little each pixel of rows `start` to `stop` can be trusted, 0 the best; NaN where unknown.

    `2 s + D / 2`: s^2 is the variance of the wrapped differences along rows plus that along columns, of
    the 3 x 3 pixels around (Pritt's phase derivative variance); D^2 the sum of squared second
    differences along row, column and diagonals (Herraez et al. 2002). `factors` are the quality that
    weighs it (0 rows: none) and its middle. `largest` gets each row's greatest |phase|.
    """
    quality, middle = factors
    width = phase.shape[1]
    stacks = np.zeros((3, 8, width + 2), np.float32)
    sums = np.zeros((6, width + 2), np.float32)
    bends, weight = np.empty(width, np.float32), np.ones(width, np.float32)
    _fill(phase, start - 1, stacks[0])
    _fill(phase, start, stacks[1])
    for row in range(start, stop):
        above, here, below = stacks[(row - start) % 3], stacks[(row - start + 1) % 3], stacks[(row - start + 2) % 3]
        _fill(phase, row + 1, below)
        sums[:] = _ZERO
        for stack in (above, here, below):
            _variance(sums[0], sums[1], sums[2], stack[0], stack[_KNOWN])
        for stack in (above, here):
            _variance(sums[3], sums[4], sums[5], stack[1], stack[_KNOWN + 1])
        cost[row] = _ZERO
        _spread(sums[0], sums[1], sums[2], 0, 2, cost[row])
        _spread(sums[3], sums[4], sums[5], 0, 3, cost[row])
        _bends(above, here, bends)
        if quality.size > 0:
            _weigh(quality[row], middle, weight)
        largest[row] = _finish(phase[row], weight, bends, cost[row])
