"""Grey levels for a wanted light, rounded so that the phase is spared.

Owns the choice between neighbouring grey levels. Eight bits leave a tone-compensated fringe an error of some 0.1 %
of the range. Where a whole number of pixels makes a period the same error comes back in every period, and so becomes
harmonics; here it is pushed into those that the decoder does not see or that the projector's blur takes away.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]

MOST_PERIOD_PX = 256  # a longer period averages over more pixels, and its phase needs to be right to a fringe only
_MOST_ORDER = 24
_BLUR_PX = 0.8
_STRAY_WEIGHT = 0.02  # what an error costs that no order of interest sees
_MOST_MOVES = 400


def quiet_levels(
    light: Float64Array, curve: Float64Array, period_px: float, steps: int, span: tuple[int, int] = (0, 255)
) -> UInt8Array:
    """Return the grey levels (n,) whose light on `curve` (256,), rising, follows `light` (n,) with a quiet error.

    `light` repeats every `period_px` pixels and is one of `steps` equal steps. Where these move the fringe by whole
    pixels, all frames have the same error, and only harmonics m `steps` +- 1 reach the phase; else all low orders count.
    Greedy: one level, then two together, is moved by one as long as the weighted error falls. Periods that are no whole
    number of pixels, or do not fill `light`, get the nearest level, as do those above 256 px.

    Examples
    --------
    >>> curve = (np.arange(256) / 255) ** 2.2
    >>> wanted = (1 + np.cos(2 * np.pi * np.arange(64) / 16)) / 2
    >>> plain = np.abs(curve - wanted[:, None]).argmin(axis=1)
    >>> third = [abs(np.fft.fft(curve[g] - wanted)[12]) / 32 for g in (plain, quiet_levels(wanted, curve, 16, 4))]
    >>> bool(third[1] < 0.1 * third[0])
    True
    """
    low, high = span
    period = round(period_px)
    nearest = nearest_levels(light, curve, span)
    if abs(period - period_px) > 1e-9 or len(light) % period or not 4 <= period <= MOST_PERIOD_PX:
        return nearest
    waves = _waves(period, steps)
    grey = _quietened(nearest[:period].astype(np.int64), light[:period], curve, waves, (low, high))
    return np.tile(grey, len(light) // period)


def nearest_levels(light: Float64Array, curve: Float64Array, span: tuple[int, int] = (0, 255)) -> UInt8Array:
    """Return the grey levels whose light is nearest."""
    above = np.clip(np.searchsorted(curve, light), 1, 255)
    below_is_nearer = light - curve[above - 1] < curve[above] - light
    return np.asarray(np.clip(above - below_is_nearer, *span), np.uint8)


def _waves(period: int, steps: int) -> Float64Array:
    """Return the orders that matter as rows of weighted, normalised cosines and sines (2 k, period)."""
    orders = np.arange(min(period // 2, _MOST_ORDER) + 1)
    if period % steps == 0:
        orders = orders[(orders > 1) & np.isin(orders % steps, (1, steps - 1))]
    damping = np.exp(-2 * (np.pi * _BLUR_PX * orders / period) ** 2)
    u = 2 * np.pi * np.arange(period) / period
    rows = [w * wave(k * u) for k, w in zip(orders, damping, strict=True) for wave in (np.cos, np.sin)]
    return np.array(rows).reshape(-1, period) * np.sqrt(2 / period)


def _quietened(
    grey: npt.NDArray[np.int64], light: Float64Array, curve: Float64Array, waves: Float64Array, span: tuple[int, int]
) -> UInt8Array:
    gram = waves.T @ waves + _STRAY_WEIGHT * np.eye(len(light))
    for _ in range(_MOST_MOVES):
        error = curve[grey] - light
        pull = 2 * (gram @ error)
        moved = np.stack([np.clip(grey + d, *span) for d in (-1, 1)])
        change = curve[moved] - curve[grey]
        single = pull * change + np.diag(gram) * change**2
        best = np.unravel_index(int(single.argmin()), single.shape)
        if single[best] < -1e-12:
            grey[best[1]] = moved[best]
            continue
        flat, cost = change.ravel(), single.ravel()
        pairs = cost[:, None] + cost + 2 * np.tile(gram, (2, 2)) * np.outer(flat, flat)
        pairs[np.tile(np.eye(len(light), dtype=bool), (2, 2))] = 0
        one, other = np.unravel_index(int(pairs.argmin()), pairs.shape)
        if not pairs[one, other] < -1e-12:
            break
        for index in (one, other):
            grey[index % len(light)] = moved.ravel()[index]
    return grey.astype(np.uint8)
