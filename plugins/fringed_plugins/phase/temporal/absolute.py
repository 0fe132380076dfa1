"""Frames of several periods to an absolute phase, all periods together.

Owns what heterodyne and number-theoretic decoding share: each period's wrapped phase, the search over all orders, and
the reasons to drop a pixel. Knows no contract.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.cleaning import clean
from fringed_plugins.phase.decode import Keep, decode, readable
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.masks.limits import MaskLimits
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, phase_variance_factor
from fringed_plugins.phase.temporal.correction import SURE_SIGMAS, Evidence
from fringed_plugins.phase.temporal.joint import Orders, Search, find_orders, search_of

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

_FRINGE_ORDER = np.uint16(4)
_OUT_OF_RANGE = np.uint16(16)
_ZERO = np.float32(0)
_TWO_PI = np.float32(2 * np.pi)
_NAN = np.float32(np.nan)
_RIPPLE_PART = 0.2  # of the next order's chi^2: periods that differ by less tell the same order


class Wrapped(NamedTuple):
    """Wrapped phases of all periods, long to short, with what was found out about each pixel."""

    wrapped_rad: Float32Array  # (periods, height, width)
    modulation: Float32Array  # (periods, height, width)
    background: Float32Array  # (height, width), of the finest
    rejected: npt.NDArray[np.uint16]  # (height, width)


class Bounds(NamedTuple):
    """When an order is taken, float32."""

    sure2: np.float32  # chi^2 of the next order at least
    low_turns: np.float32
    high_turns: np.float32
    initial_rad: np.float32
    ripple_part: np.float32  # chi^2 of the one taken, over the next one's, that is no contradiction


def wrapped_phases(
    frames: Array, groups: Sequence[Group], noise: NoiseModel, thresholds: Thresholds, threads: int = 0
) -> Wrapped:
    """Decode each group by itself; the flags of all are joined."""
    alone = replace(thresholds, similar_neighbours=0, border_glow=0.0, masks=MaskLimits())
    shape = (len(groups), *frames.shape[1:])
    phases, lights = np.empty(shape, np.float32), np.empty(shape, np.float32)
    rejected = np.zeros(frames.shape[1:], np.uint16)
    for index, group in enumerate(groups):
        one = decode(frames, [group], noise, alone, keep=Keep(sigma=False, wrapped=True), threads=threads)
        phases[index], lights[index] = one.wrapped_rad, one.modulation
        rejected |= one.rejected
    return Wrapped(phases, lights, one.background, rejected)


def search_for(
    groups: Sequence[Group], noise: NoiseModel, size_px: int, *, systematic_rad: float, combine: bool
) -> Search:
    """Return the search for these groups, long period to short."""
    return search_of(
        [group.period_px for group in groups],
        size_px,
        [group.initial_rad for group in groups],
        [phase_variance_factor(group.shifts_rad) for group in groups],
        (noise.constant_dn2, noise.slope_dn),
        systematic_rad=systematic_rad,
        combine=combine,
    )


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _judge_row(found: Any, bounds: Any, flags: Any, phase: Any, sigma: Any) -> None:
    """Write phase and deviation, and flag what is unsure or off the projector."""
    turns, sigmas, best, second = found
    for x in range(flags.size):
        t, chi2, other = turns[x], best[x], second[x]
        # More misfit than noise explains is ripple as long as the next order fits far worse.
        ripple = bounds.ripple_part * other
        unsure = other < bounds.sure2 or chi2 > (ripple if ripple > bounds.sure2 else bounds.sure2)
        outside = t < bounds.low_turns or t > bounds.high_turns
        flag = flags[x]
        flag |= _FRINGE_ORDER if unsure else np.uint16(0)
        flag |= _OUT_OF_RANGE if outside else np.uint16(0)
        flags[x] = flag
        phase[x] = t * _TWO_PI + bounds.initial_rad if flag == 0 else _NAN
        sigma[x] = sigmas[x] * _TWO_PI if flag == 0 else _NAN


@njit(cache=True, nogil=True, error_model="numpy")
def _judge(start: int, stop: int, orders: Any, bounds: Any, rejected: Any, out: Any) -> None:
    phase, sigma, confidence = out
    turns, sigmas, best, second = orders.turns, orders.sigma_turns, orders.best, orders.second
    for y in range(start, stop):
        _judge_row((turns[y], sigmas[y], best[y], second[y]), bounds, rejected[y], phase[y], sigma[y])
        if confidence.shape[0] > 0:
            confidence[y] = (np.sqrt(second[y]) - np.sqrt(best[y])) / np.float32(2)


def decode_joint(
    frames: Array,
    groups: Sequence[Group],
    noise: NoiseModel,
    thresholds: Thresholds,
    size_px: int,
    *,
    combine: bool = True,
    systematic_rad: float = 0.02,
    keep: Keep = Keep(),  # noqa: B008 (frozen)
    threads: int = 0,
) -> Decoded:
    """Return the absolute phase of the last group, from the phases of all groups together.

    `groups` run from long period to short, `size_px` is the projector's width or height. A pixel is
    `FRINGE_ORDER` where the next order is less than 4.5 standard deviations away, or where even the best one is
    farther than that and not much nearer than the next. With `combine` the phase is the weighted mean of all periods.

    Raises
    ------
    ValueError
        fewer than two groups, or periods that leave columns that no phase tells apart.

    References
    ----------
    Petkovic, Pribanic & Donlic 2017; Towers, Towers & Jones 2005; Zuo et al. 2016, sections 4 and 5.
    """
    search = search_for(groups, noise, size_px, systematic_rad=systematic_rad, combine=combine)
    check_alike(search, groups, size_px)
    seen = wrapped_phases(frames, groups, noise, thresholds, threads)
    orders = find_orders(seen.wrapped_rad, seen.modulation, seen.background, search, threads)
    evidence = Evidence(readable(frames), groups, noise, size_px, combine=combine)
    return judged(seen, orders, evidence, thresholds, keep=keep, threads=threads)


def check_alike(search: Search, groups: Sequence[Group], size_px: int) -> None:
    """Check that no two columns share all phases.

    Raises
    ------
    ValueError
        they do, so that nobody can tell them apart.
    """
    from fringed_plugins.phase.temporal.sets import repeat_px

    again = repeat_px([group.period_px for group in groups], size_px)
    if again is not None:
        text = ", ".join(f"{group.period_px:.5g}" for group in groups)
        raise ValueError(
            f"with periods of {text} px, columns {again:.4g} px apart share all phases, and the projector has {size_px}"
        )


def judged(
    seen: Wrapped,
    orders: Orders,
    evidence: Evidence,
    thresholds: Thresholds,
    *,
    keep: Keep = Keep(),  # noqa: B008 (frozen)
    threads: int = 0,
) -> Decoded:
    """Return what was found as a decoded map: doubtful orders settled or dropped, neighbours compared."""
    shape, finest = seen.background.shape, evidence.groups[-1]
    edge, period, size_px = thresholds.edge_px, finest.period_px, evidence.size_px
    ripple = _RIPPLE_PART if len(evidence.groups) > 1 else 0.0
    numbers = (SURE_SIGMAS**2, (edge - 0.5) / period, (size_px - 0.5 - edge) / period, finest.initial_rad, ripple)
    bounds = Bounds(*map(np.float32, numbers))
    nothing = np.empty((0, 0), np.float32)
    out = Decoded(
        phase_rad=np.empty(shape, np.float32),
        sigma_rad=np.empty(shape, np.float32),
        modulation=seen.modulation[-1],
        background=seen.background,
        wrapped_rad=seen.wrapped_rad[-1] if keep.wrapped else nothing,
        rejected=seen.rejected,
        confidence=np.empty(shape, np.float32) if keep.confidence else nothing,
    )
    maps = (out.phase_rad, out.sigma_rad, out.confidence)
    run_rows(_judge, shape[0], orders, bounds, out.rejected, maps, threads=threads)
    clean(out, finest, thresholds, size_px, threads, evidence=evidence)
    return out
