"""Fringe orders from several periods at once: the most likely column among all that the finest phase allows.

Owns the search for heterodyne and number-theoretic sets and for whatever else has wrapped phases of several periods;
knows no frames. For a finest phase t (turns) every order k is a candidate column T = t + k. Another period m
expects r_m T there, r_m being the finest period over its own, and measures t_m; with e_m the difference wrapped to
(-1/2, 1/2] and w_m the inverse variance, the finest phase being wrong by d costs

    chi^2(k) = min over d of  sum_m w_m (e_m - r_m d)^2 = sum w e^2 - (sum w r e)^2 / sum w r^2.

The least one is the maximum-likelihood order (Petkovic et al. 2017 find it in a projection of the same lattice); its d
is the weighted mean of all periods, which has less noise than the finest one alone. Beats are a way to narrow
the candidates down (Towers et al. 2005): they never know more than all the phases together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

Float32Array = npt.NDArray[np.float32]

_BLOCK = 256
_ZERO = np.float32(0)
_ONE = np.float32(1)
_HALF = np.float32(0.5)
_HUGE = np.float32(1e30)
_TINY = np.float32(1e-12)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding and subtracting it rounds to the nearest integer
_PER_TURN = np.float32(0.5 / np.pi)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


class Search(NamedTuple):
    """What the kernel needs of a set of periods, the finest one last; see `search_of`."""

    ratio: Float32Array  # (periods,) finest period over this one
    advance: Float32Array  # (orders, periods) turns of each period at an order, without the whole ones
    initial_turns: Float32Array  # (periods,)
    factor: Float32Array  # (periods,) variance of a phase: factor * noise variance / modulation^2, in turns^2
    floor2: np.float32  # variance that is always added: what is wrong with every phase
    noise_constant: np.float32
    noise_slope: np.float32
    cut_turns: np.float32  # where the finest phase is cut
    circle_turns: np.float32  # length of the circle that columns are on, or 0
    combine: bool


class Orders(NamedTuple):
    """Result of the search, `(height, width)` float32 each."""

    turns: Float32Array  # absolute phase of the finest period
    sigma_turns: Float32Array
    best: Float32Array  # chi^2 of the order taken
    second: Float32Array  # ... of the next one


def search_of(
    periods_px: Sequence[float],
    size_px: int,
    initial_rad: Sequence[float],
    variance_factors: Sequence[float],
    noise: tuple[float, float] = (0.0, 0.0),
    *,
    systematic_rad: float = 0.02,
    combine: bool = True,
) -> Search:
    """Return the search over `size_px` columns for `periods_px`, coarse to fine.

    `variance_factors` are those of `shifts.phase_variance_factor`, for each period; `noise` the variance of a frame,
    constant and slope. `systematic_rad` is what no phase is better than, whatever the noise.

    Raises
    ------
    ValueError
        no period.
    """
    if len(periods_px) == 0:
        raise ValueError("no periods; two or more tell fringe orders, one has none to tell")
    periods = np.asarray(periods_px, np.float64)
    ratio = periods[-1] / periods
    counts = size_px / periods
    circular = bool(np.all(np.abs(counts - np.rint(counts)) < 1e-4))
    margin = 0.0 if circular else 0.25
    orders = round(counts[-1]) if circular else int(np.ceil(counts[-1] + 2 * margin))
    advance = ratio[None] * np.arange(orders)[:, None]
    return Search(
        ratio=ratio.astype(np.float32),
        advance=(advance - np.rint(advance)).astype(np.float32),
        initial_turns=(np.asarray(initial_rad, np.float64) / (2 * np.pi)).astype(np.float32),
        factor=(np.asarray(variance_factors, np.float64) / (2 * np.pi) ** 2).astype(np.float32),
        floor2=np.float32((systematic_rad / (2 * np.pi)) ** 2),
        noise_constant=np.float32(noise[0]),
        noise_slope=np.float32(noise[1]),
        cut_turns=np.float32(-0.5 / periods[-1] - margin),
        circle_turns=np.float32(orders if circular else 0.0),
        combine=combine,
    )


@njit(**_options)
def _weigh(rows: Any, search: Any, m: int, turns: Any, weight: Any) -> None:
    """Write the turns of period `m` and their inverse variance."""
    phase, light, background = rows
    slope, constant, floor2 = search.noise_slope, search.noise_constant, search.floor2
    factor, initial = search.factor[m], search.initial_turns[m]
    for x in range(phase.size):
        level = background[x] if background[x] > _ZERO else _ZERO
        variance = factor * (constant + slope * level) / (light[x] * light[x] + _TINY) + floor2
        weight[x] = _ONE / (variance + _TINY)
        turns[x] = phase[x] * _PER_TURN - initial


@njit(**_options)
def _relate(base: Any, weight: Any, search: Any, information: Any) -> None:
    """Cut the finest phase, and write what each other one differs from it at order 0."""
    last = search.ratio.size - 1
    fine, heavy = base[last], weight[last]
    for x in range(fine.size):
        below = fine[x] - search.cut_turns
        fine[x] -= (below - _HALF + _ROUND) - _ROUND
        information[x] = heavy[x]
    for m in range(last):
        row, other, ratio = base[m], weight[m], search.ratio[m]
        for x in range(fine.size):
            row[x] -= ratio * fine[x]
            information[x] += other[x] * ratio * ratio
    for x in range(fine.size):
        information[x] = _ONE / information[x]


@njit(**_options)
def _costs_two(base: Any, weight: Any, search: Any, k: int, information: Any, cost: Any) -> None:
    """Write chi^2 at order `k` with two other periods: the usual case, in one loop."""
    r0, r1, a0, a1 = search.ratio[0], search.ratio[1], search.advance[k, 0], search.advance[k, 1]
    b0, b1, w0, w1 = base[0], base[1], weight[0], weight[1]
    for x in range(cost.size):
        e0 = b0[x] - a0
        e0 -= (e0 + _ROUND) - _ROUND
        e1 = b1[x] - a1
        e1 -= (e1 + _ROUND) - _ROUND
        we0, we1 = w0[x] * e0, w1[x] * e1
        lean = r0 * we0 + r1 * we1
        cost[x] = we0 * e0 + we1 * e1 - lean * lean * information[x]


@njit(**_options)
def _costs(base: Any, weight: Any, search: Any, k: int, information: Any, sums: Any) -> None:
    """Write chi^2 at order `k` with any number of other periods."""
    cost, leans = sums[0], sums[1]
    cost[:] = _ZERO
    leans[:] = _ZERO
    for m in range(search.ratio.size - 1):
        r, a, row, heavy = search.ratio[m], search.advance[k, m], base[m], weight[m]
        for x in range(cost.size):
            e = row[x] - a
            e -= (e + _ROUND) - _ROUND
            we = heavy[x] * e
            cost[x] += we * e
            leans[x] += r * we
    for x in range(cost.size):
        cost[x] -= leans[x] * leans[x] * information[x]


@njit(**_options)
def _keep_best(cost: Any, order: np.float32, best: Any, second: Any, orders: Any) -> None:
    # A loop of its own: with more arrays in it the compiler cannot see that they are apart, and gives up on vectors.
    for x in range(cost.size):
        c, b, s = cost[x], best[x], second[x]
        other = b if c < b else c
        second[x] = other if other < s else s
        orders[x] = order if c < b else orders[x]
        best[x] = c if c < b else b


@njit(**_options)
def _shifts(base: Any, weight: Any, search: Any, information: Any, found: Any) -> None:
    """Write, at the order taken, by how much all periods together move the finest phase."""
    orders, shift = found[2], found[3]
    shift[:] = _ZERO
    for m in range(search.ratio.size - 1):
        r, row, heavy = search.ratio[m], base[m], weight[m]
        for x in range(shift.size):
            e = row[x] - search.advance[int(orders[x]), m]
            e -= (e + _ROUND) - _ROUND
            shift[x] += r * heavy[x] * e
    for x in range(shift.size):
        shift[x] *= information[x]


@njit(**_options)
def _search_rows(start: int, stop: int, fields: Any, search: Any, out: Any) -> None:
    wrapped, modulation, background = fields
    count, width = search.ratio.size, background.shape[1]
    # Whole blocks, the last one padded: a part of a two-dimensional array has strides that the compiler does not know.
    base, weight = np.zeros((count, _BLOCK), np.float32), np.ones((count, _BLOCK), np.float32)
    sums, found = np.empty((2, _BLOCK), np.float32), np.empty((4, _BLOCK), np.float32)
    information = np.empty(_BLOCK, np.float32)
    for y in range(start, stop):
        for left in range(0, width, _BLOCK):
            right = min(left + _BLOCK, width)
            for m in range(count):
                rows = (wrapped[m, y, left:right], modulation[m, y, left:right], background[y, left:right])
                _weigh(rows, search, m, base[m], weight[m])
            _relate(base, weight, search, information)
            found[:2] = _HUGE
            found[2] = _ZERO
            for k in range(search.advance.shape[0]):
                if count == 3:
                    _costs_two(base, weight, search, k, information, sums[0])
                else:
                    _costs(base, weight, search, k, information, sums)
                _keep_best(sums[0], np.float32(k), found[0], found[1], found[2])
            _shifts(base, weight, search, information, found)
            _write((base[count - 1], weight[count - 1], information), found, search, y, left, out)


@njit(**_options)
def _write(fields: Any, found: Any, search: Any, y: int, left: int, out: Any) -> None:
    fine, weight, information = fields
    circle = search.circle_turns
    for x in range(min(fine.size, out.turns.shape[1] - left)):
        t = fine[x] + found[2, x] + (found[3, x] if search.combine else _ZERO)
        rounds = (t - search.cut_turns) / circle if circle > _ZERO else _HALF
        out.turns[y, left + x] = t - circle * ((rounds - _HALF + _ROUND) - _ROUND)
        out.sigma_turns[y, left + x] = np.sqrt(information[x] if search.combine else _ONE / weight[x])
        out.best[y, left + x] = found[0, x] if found[0, x] > _ZERO else _ZERO
        out.second[y, left + x] = found[1, x]


def find_orders(
    wrapped_rad: Float32Array,
    modulation: Float32Array,
    background: Float32Array,
    search: Search,
    threads: int = 0,
) -> Orders:
    """Return the most likely absolute phase of the finest period.

    `wrapped_rad` and `modulation` are (periods, height, width) float32, the finest period last; `background`
    is (height, width), for the noise. Where the noise is unknown (all zero) only `systematic_rad` weighs.

    References
    ----------
    Petkovic, Pribanic & Donlic 2017; Towers, Towers & Jones 2005; Zuo et al. 2016, sections 4 and 5.

    Examples
    --------
    >>> u = np.linspace(0, 1023, 200, dtype=np.float32)[None]
    >>> periods = (1024 / 49, 1024 / 57, 16.0)
    >>> phases = np.array([np.angle(np.exp(2j * np.pi * u / p)) for p in periods], np.float32)
    >>> found = find_orders(phases, np.ones_like(phases), u * 0, search_of(periods, 1024, (0, 0, 0), (0.5,) * 3))
    >>> bool(np.abs(found.turns * 16 - u).max() < 1e-3)
    True
    """
    shape = background.shape
    out = Orders(*(np.empty(shape, np.float32) for _ in Orders._fields))
    run_rows(_search_rows, shape[0], (wrapped_rad, modulation, background), search, out, threads=threads)
    return out
