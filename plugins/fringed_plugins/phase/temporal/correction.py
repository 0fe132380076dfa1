"""Fringe orders of doubtful pixels, from what is sure around them.

Owns which pixels are doubtful and who settles their order: their sure neighbours where few are doubtful, the
windows of `windows` where many are. Knows no contract. The wrapped phase itself is never touched: only its
whole number of turns is chosen, and only where the chosen one fits the pixel's own frames within the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, phase_variance_factor, transform
from fringed_plugins.phase.temporal import settle_kernel, support_kernel, windows
from fringed_plugins.phase.temporal.joint import Search, search_of

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
View = Callable[[Array, windows.Phasors, Float32Array, Float32Array], Float32Array]

DENSE_SHARE = 0.01  # of the pixels that are doubtful: more are worth the windows
SURE_SIGMAS = 4.5
_SYSTEMATIC_RAD = 0.05
_HALO = 2 * windows.RADIUS
_BAND = 64


@dataclass(frozen=True)
class Evidence:
    """The frames behind a decoded map: what windows are made of.

    `view` makes `windows` of a part of the image from phasors, frames, background and `keep`; without one, the orders
    of the sums over all `groups` are used. Without `windows` only neighbours are asked.
    With `combine` windows average the phase over all groups.
    """

    frames: Array
    groups: Sequence[Group]
    noise: NoiseModel
    size_px: int
    view: View | None = None
    windows: bool = True
    combine: bool = False


def correct(decoded: Decoded, evidence: Evidence, thresholds: Thresholds, threads: int = 0) -> int:
    """Give doubtful pixels of `decoded`, in place, the order that what surrounds them is sure of.

    Doubtful are pixels that were dropped as `LOW_MODULATION`, `FRINGE_ORDER` or `OUT_OF_RANGE` and for nothing
    else. Those that stay so keep their reasons. Returns how many were doubtful.

    References
    ----------
    Zuo et al. 2016, section 6 (errors of fringe orders); Kuwahara et al. 1976 (windows beside an edge).
    """
    height = decoded.rejected.shape[0]
    rules = _rules(evidence, thresholds)
    counts = np.zeros(height, np.int64)
    run_rows(settle_kernel.doubtful_rows, height, decoded, rules, counts, threads=threads)
    doubtful = int(counts.sum())
    if doubtful == 0:
        return 0
    finest = evidence.groups[-1:]
    if doubtful <= DENSE_SHARE * decoded.rejected.size or not evidence.windows:
        group = finest[0]
        weights = transform(group.shifts_rad)[1:3].astype(np.float32)
        initial = np.float32(group.initial_rad / (2 * np.pi))
        fit = (evidence.frames, np.array(group.frames, np.int64), weights, initial)
        maps = (decoded, decoded.rejected.copy(), counts)
        run_rows(support_kernel.neighbour_rows, height, fit, maps, rules, threads=threads)
        return doubtful
    groups = evidence.groups if evidence.view is None else finest
    search = _search(groups, evidence)
    useful = (decoded.rejected & settle_kernel.SETTLED) == 0

    def work(start: int, stop: int) -> None:
        for band in range(start, stop):
            rows = (band * _BAND, min((band + 1) * _BAND, height))
            if counts[rows[0] : rows[1]].any():
                _by_windows(rows, decoded, useful, evidence, (groups, search, rules))

    run_rows(work, -(-height // _BAND), threads=threads)
    return doubtful


def _search(groups: Sequence[Group], evidence: Evidence) -> Search:
    return search_of(
        [group.period_px for group in groups],
        evidence.size_px,
        [group.initial_rad for group in groups],
        [phase_variance_factor(group.shifts_rad) for group in groups],
        (evidence.noise.constant_dn2, evidence.noise.slope_dn),
        systematic_rad=_SYSTEMATIC_RAD,
    )


def _by_windows(
    rows: tuple[int, int],
    decoded: Decoded,
    useful: Any,
    evidence: Evidence,
    plan: tuple[Sequence[Group], Search, settle_kernel.Rules],
) -> None:
    groups, search, rules = plan
    top, bottom = max(rows[0] - _HALO, 0), min(rows[1] + _HALO, decoded.rejected.shape[0])
    keep = useful[top:bottom].astype(np.float32)
    frames, background = evidence.frames[:, top:bottom], decoded.background[top:bottom]
    parts = windows.phasors(frames, groups, keep)
    if evidence.view is None:
        view = windows.look(parts, background, keep, search)
    else:
        view = evidence.view(frames, parts, background, keep)
    settle_kernel.settle_rows((rows[0], rows[1], top), decoded, (parts.cosine, parts.sine), view, search, rules)


def _rules(evidence: Evidence, thresholds: Thresholds) -> settle_kernel.Rules:
    finest, noise, edge = evidence.groups[-1], evidence.noise, thresholds.edge_px
    factor = phase_variance_factor(finest.shifts_rad)
    return settle_kernel.Rules(
        noise_constant=np.float32(noise.constant_dn2),
        noise_slope=np.float32(noise.slope_dn),
        factor=np.float32(factor / (2 * np.pi) ** 2),
        noise_power=np.float32(2 * factor),
        least_snr2=np.float32(thresholds.window_snr**2),
        least_dn=np.float32(thresholds.modulation_dn),
        sure2=np.float32(SURE_SIGMAS**2),
        low_turns=np.float32((edge - 0.5) / finest.period_px),
        high_turns=np.float32((evidence.size_px - 0.5 - edge) / finest.period_px),
        initial_rad=np.float32(finest.initial_rad),
        combine=evidence.combine,
    )
