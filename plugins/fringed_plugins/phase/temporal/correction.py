"""Fringe orders of doubtful pixels, from what is sure around them.

Owns which pixels are doubtful and who settles their order: first their sure neighbours, then, where too many are
doubtful for that, the windows of `windows`. Knows no contract. The wrapped phase itself is never touched: only its
whole number of turns is chosen, and only where the chosen one fits the pixel's own frames within the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, phase_variance_factor
from fringed_plugins.phase.temporal import windows
from fringed_plugins.phase.temporal.joint import Search, search_of

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

LOW_MODULATION, FRINGE_ORDER, OUT_OF_RANGE = 2, 4, 16
DENSE_SHARE = 0.01  # of the pixels that stay doubtful: more are worth the windows
SURE_SIGMAS = 4.5
_SYSTEMATIC_RAD = 0.05
_HALO = 2 * windows.RADIUS
_BAND = 64
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract"}}

_ZERO = np.float32(0)
_ONE = np.float32(1)
_HALF = np.float32(0.5)
_TWO_PI = np.float32(2 * np.pi)
_PER_TURN = np.float32(0.5 / np.pi)
_ROUND = np.float32(12582912.0)
_HUGE = np.float32(1e30)
_BENT_TURNS2 = np.float32(0.03**2)  # what a surface may differ from a plane within a window
_PLENTY = np.float32(200.0)
_MARGIN_WEIGHT = np.float32(0.1)


class Rules(NamedTuple):
    """Numbers of the correction, float32."""

    noise_constant: np.float32
    noise_slope: np.float32
    factor: np.float32  # variance of the finest phase (turns^2): factor * noise variance / modulation^2
    least_snr2: np.float32  # smallest squared modulation of a window over the noise's variance
    least_dn: np.float32
    sure2: np.float32
    low_turns: np.float32
    high_turns: np.float32
    initial_rad: np.float32


@njit(**_options)
def _doubtful_rows(start: int, stop: int, decoded: Any, rules: Any, counts: Any) -> None:
    """Count the doubtful pixels of each row: dropped for noise alone, with fringes left in them."""
    settled = np.uint16(0xFFFF - LOW_MODULATION - FRINGE_ORDER - OUT_OF_RANGE)
    for y in range(start, stop):
        rejected, modulation = decoded.rejected[y], decoded.modulation[y]
        total = 0
        for x in range(rejected.size):
            flags = rejected[x]
            doubtful = flags != 0 and (flags & settled) == 0 and modulation[x] >= rules.least_dn
            total += 1 if doubtful else 0
        counts[y] = total


@njit(**_options)
def _measure(i: int, j: int, parts: Any, search: Any, variance: np.float32, own: Any) -> None:
    """Write the pixel's own phases (turns) and their inverse variances."""
    cosine, sine = parts
    for m in range(search.ratio.size):
        c, s = cosine[m, i, j], sine[m, i, j]
        own[0, m] = fast_atan2(s, c) * _PER_TURN - search.initial_turns[m]
        own[1, m] = (c * c + s * s) / (search.factor[m] * variance + np.float32(1e-12))


@njit(**_options)
def _misfit(own: Any, ratio: Any, turns: np.float32) -> np.float32:
    """Return how badly the absolute phase `turns` fits the pixel's own phases, in variances."""
    total = _ZERO
    for m in range(ratio.size):
        off = own[0, m] - ratio[m] * turns
        off -= (off + _ROUND) - _ROUND
        total += off * off * own[1, m]
    return total


@njit(**_options)
def _settle(place: Any, own: Any, view: Any, ratio: Any, rules: Any) -> Any:
    """Return the pixel's absolute phase by the best window that holds it, and how well it fits; or a huge misfit."""
    i, j, variance = place
    height, width = view.turns.shape
    here = own[0, ratio.size - 1]
    least, found = _HUGE, _ZERO
    for y in range(i - windows.RADIUS, i + windows.RADIUS + 1, windows.RADIUS):
        for x in range(j - windows.RADIUS, j + windows.RADIUS + 1, windows.RADIUS):
            if y < 0 or y >= height or x < 0 or x >= width:
                continue
            light2 = view.modulation[y, x] * view.modulation[y, x]
            sure = view.best[y, x] < rules.sure2 and view.second[y, x] > rules.sure2
            if not sure or light2 < rules.least_snr2 * variance:
                continue
            right, down = np.float32(j - x) * view.slope_x[y, x], np.float32(i - y) * view.slope_y[y, x]
            predicted = view.turns[y, x] + right + down
            turns = here + ((predicted - here + _ROUND) - _ROUND)
            off2 = (predicted - turns) * (predicted - turns)
            misfit = _misfit(own, ratio, turns) + off2 / (rules.factor * variance / light2 + _BENT_TURNS2)
            margin = min(view.second[y, x] - view.best[y, x], _PLENTY)
            score = misfit - _MARGIN_WEIGHT * margin
            if misfit < rules.sure2 and score < least:
                least, found = score, turns
    return least, found


@njit(**_options)
def _settle_rows(rows: Any, decoded: Any, parts: Any, view: Any, search: Any, rules: Any) -> None:
    """Take the windows' word in `rows` (first, last, and the first row of `parts`)."""
    settled = np.uint16(0xFFFF - LOW_MODULATION - FRINGE_ORDER - OUT_OF_RANGE)
    first, stop, offset = rows
    own = np.empty((2, search.ratio.size), np.float32)
    for y in range(first, stop):
        for x in range(decoded.rejected.shape[1]):
            flags = decoded.rejected[y, x]
            if flags == 0 or (flags & settled) != 0 or decoded.modulation[y, x] < rules.least_dn:
                continue
            level = max(decoded.background[y, x], _ZERO)
            variance = rules.noise_constant + rules.noise_slope * level
            _measure(y - offset, x, parts, search, variance, own)
            least, turns = _settle((y - offset, x, variance), own, view, search.ratio, rules)
            if least >= _HUGE:
                decoded.rejected[y, x] |= np.uint16(FRINGE_ORDER)
                continue
            outside = turns < rules.low_turns or turns > rules.high_turns
            decoded.rejected[y, x] = np.uint16(OUT_OF_RANGE) if outside else np.uint16(0)
            if not outside:
                decoded.phase_rad[y, x] = turns * _TWO_PI + rules.initial_rad
                decoded.sigma_rad[y, x] = _TWO_PI / np.sqrt(own[1, search.ratio.size - 1])


def correct(
    decoded: Decoded,
    frames: Array,
    groups: Sequence[Group],
    noise: NoiseModel,
    thresholds: Thresholds,
    size_px: int,
    threads: int = 0,
) -> int:
    """Give doubtful pixels of `decoded`, in place, the order that what surrounds them is sure of.

    Doubtful are pixels that were dropped as `LOW_MODULATION`, `FRINGE_ORDER` or `OUT_OF_RANGE` and for nothing
    else. Those that stay so are `FRINGE_ORDER` too. Returns how many were doubtful.

    References
    ----------
    Zuo et al. 2016, section 6 (errors of fringe orders); Kuwahara et al. 1976 (windows beside an edge).
    """
    height = decoded.rejected.shape[0]
    rules = _rules(groups[-1], noise, thresholds, size_px)
    counts = np.zeros(height, np.int64)
    run_rows(_doubtful_rows, height, decoded, rules, counts, threads=threads)
    doubtful = int(counts.sum())
    if doubtful > DENSE_SHARE * decoded.rejected.size:
        search = search_of(
            [group.period_px for group in groups],
            size_px,
            [group.initial_rad for group in groups],
            [phase_variance_factor(group.shifts_rad) for group in groups],
            (noise.constant_dn2, noise.slope_dn),
            systematic_rad=_SYSTEMATIC_RAD,
        )
        bands = -(-height // _BAND)

        def work(start: int, stop: int) -> None:
            for band in range(start, stop):
                rows = (band * _BAND, min((band + 1) * _BAND, height))
                if counts[rows[0] : rows[1]].any():
                    _by_windows(rows, decoded, frames, groups, search, rules)

        run_rows(work, bands, threads=threads)
    return doubtful


def _by_windows(
    rows: tuple[int, int], decoded: Decoded, frames: Array, groups: Sequence[Group], search: Search, rules: Rules
) -> None:
    top, bottom = max(rows[0] - _HALO, 0), min(rows[1] + _HALO, decoded.rejected.shape[0])
    useless = np.uint16(0xFFFF - LOW_MODULATION - FRINGE_ORDER - OUT_OF_RANGE)
    keep = ((decoded.rejected[top:bottom] & useless) == 0).astype(np.float32)
    parts = windows.phasors(frames[:, top:bottom], groups, keep)
    view = windows.look(parts, decoded.background[top:bottom], keep, search)
    _settle_rows((rows[0], rows[1], top), decoded, (parts.cosine, parts.sine), view, search, rules)


def _rules(finest: Group, noise: NoiseModel, thresholds: Thresholds, size_px: int) -> Rules:
    period, edge = finest.period_px, thresholds.edge_px
    numbers = (
        noise.constant_dn2,
        noise.slope_dn,
        phase_variance_factor(finest.shifts_rad) / (2 * np.pi) ** 2,
        1.0,
        thresholds.modulation_dn,
        SURE_SIGMAS**2,
        (edge - 0.5) / period,
        (size_px - 0.5 - edge) / period,
        finest.initial_rad,
    )
    return Rules(*map(np.float32, numbers))
