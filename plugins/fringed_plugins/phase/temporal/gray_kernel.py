"""Inner loop of Gray code with fringes: the fringe order that the code and all phases agree on best.

Owns the cost of an order; `gray` calls it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fringed_plugins.phase.projection.graycode import Code

options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
_SOFT_CELLS, _SOFT_PX = 0.05, 2.0  # how exactly the edge of a cell is known: the lesser of both
_ZERO = np.float32(0)
_HUGE = np.float32(1e30)
_TINY = np.float32(1e-12)
_PER_TURN = np.float32(0.5 / np.pi)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to the nearest integer


class Ruler(NamedTuple):
    """How cells of the code and turns of the finest fringes lie on the projector, float32."""

    turns_per_cell: np.float32
    first_turns: np.float32  # where the first cell begins
    reach: int  # orders to try on each side
    soft2: np.float32  # variance of a cell's edge, in turns^2


def ruler(code: Code, period_px: float) -> Ruler:
    """Return the ruler for fringes of `period_px`."""
    per_cell = code.cell_px / period_px
    return Ruler(
        np.float32(per_cell),
        np.float32((code.offset_px - 0.5) / period_px),
        int(np.ceil(per_cell / 2)) + 1,
        np.float32((min(_SOFT_CELLS * code.cell_px, _SOFT_PX) / period_px) ** 2),
    )


@njit(**options)
def order_rows(start: int, stop: int, maps: Any, code: Any, rules: Any, out: Any) -> None:
    """Choose the order of the finest period near the code's position."""
    wrapped, modulation, background = maps
    search, scale = rules
    # Arrays are taken out of their tuples once: each time is counted.
    ratio, factor, initial, combine = search.ratio, search.factor, search.initial_turns, search.combine
    all_position, all_half, all_margin, all_expected = code.position, code.half_width, code.margin, code.expected
    out_turns, out_sigma, out_best, out_second = out.turns, out.sigma_turns, out.best, out.second
    count = ratio.size
    t, w, noise2 = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    for y in range(start, stop):
        for x in range(background.shape[1]):
            variance = search.noise_constant + search.noise_slope * max(background[y, x], _ZERO)
            information, spread = _ZERO, _ZERO
            for m in range(count):
                t[m] = wrapped[m, y, x] * _PER_TURN - initial[m]
                light2 = modulation[m, y, x] * modulation[m, y, x]
                noise2[m] = factor[m] * variance / (light2 + _TINY)
                w[m] = np.float32(1) / (noise2[m] + search.floor2 + _TINY)
                lever = w[m] * ratio[m]
                information += lever * ratio[m]
                spread += lever * lever * noise2[m]
            here = t[count - 1]
            coded = scale.first_turns + all_position[y, x] * scale.turns_per_cell
            half = all_half[y, x] * scale.turns_per_cell
            near = here + ((coded - here + _ROUND) - _ROUND)
            best, second, turns = _HUGE, _HUGE, near
            for k in range(-scale.reach, scale.reach + 1):
                candidate = near + np.float32(k)
                squares, lean = _ZERO, _ZERO
                for m in range(count - 1):
                    e = t[m] - ratio[m] * candidate
                    e -= (e + _ROUND) - _ROUND
                    squares += w[m] * e * e
                    lean += w[m] * e * ratio[m]
                beyond = max(abs(candidate - coded) - half, _ZERO)
                shift = lean / information
                cost = squares - lean * shift + beyond * beyond / (scale.soft2 + np.float32(1) / w[count - 1])
                if cost < best:
                    best, second, turns = cost, best, candidate + (shift if combine else _ZERO)
                else:
                    second = min(second, cost)
            # The next code: its bit would have to be wrong by what it was read as, and by what it should be.
            bit = all_margin[y, x] + all_expected[y, x]
            out_turns[y, x] = turns
            out_sigma[y, x] = np.sqrt(spread) / information if combine else np.sqrt(noise2[count - 1])
            out_best[y, x] = max(best, _ZERO)
            out_second[y, x] = min(second, bit * bit)
