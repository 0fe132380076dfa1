"""Three carriers in one exposure to an absolute phase: three single frames, unwrapped together.

Owns the order of the steps; filters are in `fourier`, orders in `temporal`. Takes plain arrays; knows no contract.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from fringed_plugins.phase.cleaning import clean
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group
from fringed_plugins.phase.single_frame.bands import Band, band_around, find_carrier
from fringed_plugins.phase.single_frame.fourier import (
    RESIDUAL,
    FrameLimits,
    SingleFrame,
    analytic_signal,
    lit,
    single_frame,
)
from fringed_plugins.phase.temporal.joint import Orders, find_orders, search_of

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

_SURE_SIGMAS = 4.5
_FRINGE_ORDER, _OUT_OF_RANGE, _ISOLATED = np.uint16(4), np.uint16(16), np.uint16(32)
_ISLAND_PERIODS2 = 2.0  # squared periods of the coarsest carrier


class Carrier(NamedTuple):
    """One channel's fringes, `2 pi u / period_px + initial_rad` at column u, and the channel's noise."""

    period_px: float
    initial_rad: float
    noise: NoiseModel


@dataclass(frozen=True)
class Filters:
    """How each carrier is filtered and judged.

    `carrier_period_px` is the finest carrier's period in the picture, 0 to search it; widths are parts of each
    carrier's frequency. `systematic_rad` is what no filtered phase is better than, for the fringe orders.
    """

    carrier_period_px: float = 0.0
    bandwidth: float = 0.9
    cross_bandwidth: float = 0.9
    flat: float = 0.5
    iterations: int = 3
    systematic_rad: float = 0.05
    limits: FrameLimits = FrameLimits()  # noqa: RUF009 (frozen)


def _nothing(fraction: float) -> None:
    """Report to nobody."""


def three_carriers(
    channels: Float32Array,
    saturated: Array,
    carriers: Sequence[Carrier],
    size_px: int,
    *,
    filters: Filters = Filters(),
    threads: int = 0,
    report: Callable[[float], None] = _nothing,
) -> Decoded:
    """Return the absolute phase of the finest carrier from unmixed `channels` (n, height, width).

    `saturated` (height, width) is joint. The carrier of the finest
    fringes is searched in the picture, the others follow from it. What a channel drops is dropped; so is where
    the phases together do not tell the order.

    Raises
    ------
    ValueError
        no carrier that stands out, or bands that a picture cannot hold.

    Examples
    --------
    >>> u = np.linspace(100, 900, 640) + np.zeros((64, 1))
    >>> carriers = [Carrier(1024 / n, 0.0, NoiseModel(1.0, 0.0)) for n in (40, 59, 96)]
    >>> frames = np.array([100 + 80 * np.cos(2 * np.pi * u / c.period_px) for c in carriers], np.float32)
    >>> found = three_carriers(frames, np.zeros(u.shape, bool), carriers, 1024)
    >>> bool(np.nanmax(np.abs(found.phase_rad * 1024 / 96 / (2 * np.pi) - u)[:, 40:-40]) < 0.1)
    True

    References
    ----------
    Takeda & Mutoh 1983; Petkovic, Pribanic & Donlic 2017.
    """
    ranked = sorted(range(len(carriers)), key=lambda i: -carriers[i].period_px)
    groups = [Group((i,), (0.0,), carriers[i].period_px, carriers[i].initial_rad) for i in ranked]
    bands = _bands(channels[ranked[-1]], [group.period_px for group in groups], size_px, filters)
    shape = channels.shape[1:]
    phases, lights = (np.empty((len(ranked), *shape), np.float32) for _ in range(2))
    rejected = np.zeros(shape, np.uint16)
    gains, background = [], np.empty(shape, np.float32)
    for place, (index, band) in enumerate(zip(ranked, bands, strict=True)):
        channel = channels[index]
        valid = lit(channel, saturated, band, filters.limits.modulation_dn)
        found = analytic_signal(channel, valid, band, None, filters.iterations, threads=threads)
        noise = carriers[index].noise
        alone = single_frame(found, channel, valid, saturated, band, noise=noise, limits=filters.limits)
        phases[place] = np.arctan2(found.sine, found.cosine)
        lights[place], background = alone.modulation, alone.background
        # A coarse carrier only helps with the order, and the search finds out where it is wrong.
        rejected |= alone.rejected if index == ranked[-1] else alone.rejected & ~RESIDUAL
        gains.append(float(found.noise_gain) * noise.constant_dn2 / carriers[ranked[-1]].noise.constant_dn2)
        report((place + 1) / (len(ranked) + 1))
    search = search_of(
        [group.period_px for group in groups], size_px, [group.initial_rad for group in groups], gains,
        (noise.constant_dn2, noise.slope_dn), systematic_rad=filters.systematic_rad,
        combine=False,
    )  # fmt: skip
    orders = find_orders(phases, lights, background, search, threads)
    decoded = _judged(orders, alone._replace(rejected=rejected), groups[-1], size_px)
    clean(decoded, groups[-1], Thresholds(border_glow=0.0), size_px, threads)
    _drop_islands(decoded, bands[0].period_px)
    return decoded


def _confidence(orders: Orders) -> Float32Array:
    """Return how many standard deviations the next order is from being taken."""
    best, second = np.maximum(orders.best, 0), np.maximum(orders.second, 0)
    return np.asarray((np.sqrt(second) - np.sqrt(best)) / 2, np.float32)


def _drop_islands(decoded: Decoded, period_px: float) -> None:
    """Drop, in place, connected regions that are smaller than what the coarsest filter can see.

    Neighbours are connected where their phases differ by less than half a turn: a patch of wrong orders, as a filter
    leaves them beside a step, stands by itself.
    """
    phase = decoded.phase_rad
    joined = np.zeros((2 * phase.shape[0] - 1, 2 * phase.shape[1] - 1), bool)  # pixels, and links between them
    kept = decoded.rejected == 0
    joined[::2, ::2] = kept
    joined[::2, 1::2] = np.abs(np.diff(phase, axis=1)) < np.pi  # False beside NaN
    joined[1::2, ::2] = np.abs(np.diff(phase, axis=0)) < np.pi
    labels = ndimage.label(joined)[0][::2, ::2]
    small = np.bincount(labels.ravel()) < _ISLAND_PERIODS2 * period_px**2
    lost = kept & small[labels]
    decoded.rejected[lost] |= _ISOLATED
    decoded.phase_rad[lost] = np.nan
    decoded.sigma_rad[lost] = np.nan


def _judged(orders: Orders, finest: SingleFrame, group: Group, size_px: int) -> Decoded:
    """Return the absolute phase of the finest carrier; what is unsure or off the projector is dropped."""
    rejected = finest.rejected
    column = orders.turns * np.float32(group.period_px)
    unsure = (orders.second < _SURE_SIGMAS**2) | (orders.best > _SURE_SIGMAS**2)
    rejected |= np.where(unsure, _FRINGE_ORDER, np.uint16(0))
    rejected |= np.where((column < 0) | (column > size_px - 1), _OUT_OF_RANGE, np.uint16(0))
    kept, nan = rejected == 0, np.float32(np.nan)
    phase = orders.turns * np.float32(2 * np.pi) + np.float32(group.initial_rad)
    return Decoded(
        phase_rad=np.where(kept, phase, nan),
        sigma_rad=np.where(kept, finest.sigma_rad, nan),
        modulation=finest.modulation,
        background=finest.background,
        wrapped_rad=np.empty((0, 0), np.float32),
        rejected=rejected,
        confidence=_confidence(orders),
    )


def _bands(finest: Float32Array, periods_px: Sequence[float], size_px: int, filters: Filters) -> list[Band]:
    """Return the carriers' bands, long period to short; the finest is searched, where it is not given."""
    if filters.carrier_period_px:
        carrier = (1 / filters.carrier_period_px, 0.0)
    else:
        # Other carriers may shine through from other channels: half an octave keeps them out.
        carrier = find_carrier(finest, size_px / periods_px[-1] / finest.shape[1], reach=1.5)
    return [
        band_around(
            (carrier[0] * periods_px[-1] / period, carrier[1] * periods_px[-1] / period),
            filters.bandwidth, filters.cross_bandwidth, filters.flat,
        )
        for period in periods_px
    ]  # fmt: skip
