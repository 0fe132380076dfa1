"""Grey levels for a wanted light, rounded so that the phase is spared.

Owns the choice between neighbouring grey levels. Eight bits leave a tone-compensated fringe an error of some 0.1 %
of the range. Where a whole number of pixels makes a period the same error comes back in every period, and so becomes
harmonics; here it is pushed into those that the decoder does not see or that the projector's blur takes away.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]

MOST_PERIOD_PX = 128  # a longer period averages over more pixels, and its phase needs to be right to a fringe only
_MOST_ORDER = 24
_BLUR_PX = 0.8
_STRAY_WEIGHT = 0.01  # what an error costs that no order of interest sees
_MOST_MOVES = 400
_LEAST_GAIN = 1e-13
_MOST_STARTS = 48


def quiet_levels(light: Float64Array, curve: Float64Array, period_px: float, steps: int = 0) -> UInt8Array:
    """Return the indices (n,) of the levels of `curve` (k,), rising, that follow `light` (n,) with a quiet error.

    `light` repeats every `period_px` pixels and is one of `steps` equal steps, 0: of others. Where these move the
    fringe by whole pixels, all frames have the same error, and only harmonics m `steps` +- 1 reach the phase; else low
    orders count.
    Greedy: one level, then two together, is moved by one as long as the weighted error falls. Periods that are no whole
    number of pixels, or do not fill `light`, get the nearest level, as do those above 128 px.

    Examples
    --------
    >>> curve = (np.arange(256) / 255) ** 2.2
    >>> wanted = (1 + np.cos(2 * np.pi * np.arange(64) / 16)) / 2
    >>> plain = np.abs(curve - wanted[:, None]).argmin(axis=1)
    >>> third = [abs(np.fft.fft(curve[g] - wanted)[12]) / 32 for g in (plain, quiet_levels(wanted, curve, 16, 4))]
    >>> bool(third[1] < 0.3 * third[0])
    True
    """
    period = round(period_px)
    nearest = nearest_levels(light, curve)
    if abs(period - period_px) > 1e-9 or len(light) % period or not 4 <= period <= MOST_PERIOD_PX:
        return nearest
    crest = _crest_px(light[:period])  # frames that are shifts of each other get levels that are shifts of each other
    turned = np.roll(light[:period], -crest).round(12) + 0.0
    grey = _quietened(turned.tobytes(), np.ascontiguousarray(curve, np.float64).tobytes(), steps)
    return np.tile(np.roll(grey, crest), len(light) // period)


def nearest_levels(light: Float64Array, curve: Float64Array) -> UInt8Array:
    """Return the indices of the levels whose light is nearest."""
    above = np.clip(np.searchsorted(curve, light), 1, len(curve) - 1)
    return np.asarray(above - (light - curve[above - 1] < curve[above] - light), np.uint8)


def _crest_px(light: Float64Array) -> int:
    """Return the pixel next to the crest of the fundamental."""
    turns = -float(np.angle(np.fft.rfft(light)[1])) / (2 * np.pi)
    return round(turns * len(light) - 1e-6)


def _waves(period: int, steps: int) -> Float64Array:
    """Return the orders that matter as rows of weighted, normalised cosines and sines (2 k, period)."""
    orders = np.arange(min(period // 2, _MOST_ORDER) + 1)
    if steps and period % steps == 0:
        orders = orders[np.isin(orders % steps, (1, steps - 1))]
    damping = np.exp(-2 * (np.pi * _BLUR_PX * orders / period) ** 2)
    u = 2 * np.pi * np.arange(period) / period
    rows = [w * wave(k * u) for k, w in zip(orders, damping, strict=True) for wave in (np.cos, np.sin)]
    return np.asarray(np.array(rows).reshape(-1, period) * np.sqrt(2 / period), np.float64)


@lru_cache(maxsize=64)
def _quietened(light_bytes: bytes, curve_bytes: bytes, steps: int) -> UInt8Array:
    """Return the best of several descents, from the nearest levels and from some drawn at random, always the same."""
    light, curve = (np.frombuffer(values, np.float64) for values in (light_bytes, curve_bytes))
    waves = _waves(len(light), steps)
    gram = waves.T @ waves + _STRAY_WEIGHT * np.eye(len(light))
    draw = np.random.default_rng(len(light))
    nearest = nearest_levels(light, curve).astype(np.int64)
    best, least = nearest, np.inf
    for number in range(max(3, min(_MOST_STARTS, 768 // len(light)))):
        moved = draw.integers(-1, 2, len(light)) if number else 0
        found = _descended(np.clip(nearest + moved, 0, len(curve) - 1), light, curve, gram)
        error = curve[found] - light
        cost = float(error @ gram @ error)
        if cost < least - 1e-15:
            best, least = found, cost
    return best.astype(np.uint8)


def _descended(
    grey: npt.NDArray[np.int64], light: Float64Array, curve: Float64Array, gram: Float64Array
) -> npt.NDArray[np.int64]:
    """Move one level, or where none helps two, by one, as long as the cost falls."""
    twice, same = np.tile(gram, (2, 2)), np.tile(np.eye(len(light), dtype=bool), (2, 2))
    for _ in range(_MOST_MOVES):
        moved = np.concatenate([np.clip(grey + d, 0, len(curve) - 1) for d in (-1, 1)])
        change = curve[moved] - np.tile(curve[grey], 2)
        cost = 2 * np.tile(gram @ (curve[grey] - light), 2) * change + np.diag(twice) * change**2
        chosen = [int(cost.argmin())]
        if cost[chosen[0]] > -_LEAST_GAIN:
            pairs = cost[:, None] + cost + 2 * twice * np.outer(change, change)
            pairs[same] = 0
            chosen = list(divmod(int(pairs.argmin()), len(cost)))
            if pairs[chosen[0], chosen[1]] > -_LEAST_GAIN:
                break
        for index in chosen:
            grey[index % len(light)] = moved[index]
    return grey
