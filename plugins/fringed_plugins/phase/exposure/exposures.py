"""Which exposures a scene needs, from fringes that were taken with one or more of them.

Owns the brightness of each pixel per microsecond and the choice of exposures. A pixel is served by an exposure that
does not saturate it and lets its modulation reach the wanted multiple of the noise: an interval. The fewest
exposures that serve the wanted share of the pixels are found exactly, by dynamic programming over these intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
STEPS_PER_OCTAVE = 12
CERTAIN = 5.0  # standard deviations of its own from which a modulation is seen
SAMPLE = 200_000


class SensorModel(NamedTuple):
    """What a pixel can show: its black level, its highest grey level, and variance `constant + slope value`."""

    black_dn: float
    full_dn: float
    noise_constant_dn2: float
    noise_slope_dn: float


class Wanted(NamedTuple):
    """What is asked for: modulation over noise, the peak as a part of full scale, the share of pixels, and limits.

    Pixels dimmer than `dimmest` times the brightest hundredth are not asked for: a black backdrop has fringes too.
    """

    snr: float = 20.0
    peak: float = 0.92
    share: float = 0.99
    dimmest: float = 0.01
    most: int = 4
    shortest_us: float = 10.0
    longest_us: float = 1e6


@dataclass(frozen=True)
class Brightness:
    """Light of the lit pixels, grey levels per microsecond: brightest value and modulation, each `(p,)`.

    `lit`, `dark` and `blinded` are the shares of all pixels that have these numbers, that show no fringes, and that
    even the shortest exposure saturated; `hidden_per_us` is what the blinded ones give at least.
    """

    peak_per_us: Float64Array
    modulation_per_us: Float64Array
    lit: float
    dark: float
    blinded: float
    hidden_per_us: float


@dataclass(frozen=True)
class Suggestion:
    """Exposures, and the share of the pixels that one of them serves, that all saturate, and that are too dark.

    The shares are of the lit pixels without those that are not asked for; `dimmer` is these' share of the lit ones.
    """

    exposures_us: tuple[float, ...]
    served: float
    too_bright: float
    too_dark: float
    dimmer: float
    reason: str


def brightness(stacks: Sequence[npt.NDArray[Any]], exposures_us: Sequence[float], sensor: SensorModel) -> Brightness:
    """Return the light of each pixel from frames `(n, height, width)` of equal phase steps over whole periods.

    Each pixel is taken from the longest exposure that does not saturate it: mean and modulation are those of the
    fitted sinusoid, `sqrt(2)` times the standard deviation over the steps.

    Raises
    ------
    ValueError
        no frames, fewer than three steps, or exposures that are none.
    """
    if not stacks or len(stacks) != len(exposures_us) or min(exposures_us) <= 0:
        raise ValueError(
            f"{len(stacks)} stacks of frames with exposures {list(exposures_us)}; give one for each, over 0"
        )
    if any(stack.ndim != 3 or len(stack) < 3 or stack.shape[1:] != stacks[0].shape[1:] for stack in stacks):
        raise ValueError(
            f"stacks of shape {[stack.shape for stack in stacks]}; expected three or more frames of one size"
        )
    step = max(1, int(np.sqrt(stacks[0][0].size / SAMPLE)))
    peak = np.full(stacks[0][0, ::step, ::step].size, np.nan)
    modulation, blind = np.full(peak.shape, np.nan), np.ones(peak.shape, bool)
    for index in np.argsort(exposures_us):
        frames = stacks[index][:, ::step, ::step].reshape(len(stacks[index]), -1).astype(np.float64)
        free = frames.max(axis=0) < sensor.full_dn
        mean, swing = frames.mean(axis=0), np.sqrt(2) * frames.std(axis=0)
        variance = sensor.noise_constant_dn2 + sensor.noise_slope_dn * np.maximum(mean, 0)
        seen = free & (swing > CERTAIN * np.sqrt(2 * variance / len(frames)))
        blind &= ~free
        for out, value in ((peak, mean - sensor.black_dn + swing), (modulation, swing)):
            out[seen] = value[seen] / exposures_us[index]
    lit = np.isfinite(peak) & (peak > 0)
    hidden = (sensor.full_dn - sensor.black_dn) / min(exposures_us)
    shares = [float(flags.mean()) for flags in (lit, ~lit & ~blind, blind)]
    return Brightness(peak[lit], modulation[lit], shares[0], shares[1], shares[2], hidden)


def suggest_exposures(
    light: Brightness, sensor: SensorModel, wanted: Wanted | None = None, exactly: int = 0
) -> Suggestion:
    """Return the fewest exposures that serve the wanted share of the lit pixels, or `exactly` so many.

    Raises
    ------
    ValueError
        no pixel shows fringes: nothing can be suggested.

    Examples
    --------
    >>> sensor = SensorModel(2.0, 255.0, 0.2, 0.02)
    >>> light = Brightness(np.geomspace(0.003, 0.3, 500), np.geomspace(0.0014, 0.14, 500), 1.0, 0.0, 0.0, 10.0)
    >>> suggestion = suggest_exposures(light, sensor, Wanted(snr=20))
    >>> len(suggestion.exposures_us), suggestion.served > 0.99
    (3, True)
    """
    wanted = wanted or Wanted()
    if not light.peak_per_us.size:
        word = "saturated" if light.blinded > light.dark else "dark"
        raise ValueError(
            f"no pixel shows fringes: {light.blinded:.0%} are saturated and {light.dark:.0%} are dark; "
            f"{'shorten the exposure' if word == 'saturated' else 'is the projector on, and its lens cap off'}"
        )
    asked = light.peak_per_us >= wanted.dimmest * np.quantile(light.peak_per_us, 0.99)
    shortest, longest = (window[asked] for window in _windows(light, sensor, wanted))
    grid = _grid(wanted)
    low, high = np.searchsorted(grid, shortest), np.searchsorted(grid, longest, side="right") - 1
    servable = low <= high
    counts = np.zeros((len(grid), len(grid)))
    np.add.at(counts, (low[servable], high[servable]), 1.0)
    total = max(len(shortest), 1)
    chosen: list[int] = []
    for count in range(exactly or 1, (exactly or wanted.most) + 1):
        chosen, served = _best(counts, count)
        if served >= wanted.share * total:
            break
    exposures = tuple(_rounded(float(grid[i])) for i in chosen)
    served = float(
        np.mean([np.any([(s <= e) & (e <= t) for e in exposures]) for s, t in zip(shortest, longest, strict=True)])
    )
    too_bright = float(np.mean(longest < min(exposures)))
    too_dark = max(1.0 - served - too_bright, 0.0)
    dimmer = float(1 - asked.mean())
    reason = _reason((exposures, served), wanted, shortest) + _left_out(light, dimmer, wanted)
    return Suggestion(exposures, served, too_bright, too_dark, dimmer, reason)


def _windows(light: Brightness, sensor: SensorModel, wanted: Wanted) -> tuple[Float64Array, Float64Array]:
    """Return the shortest and the longest exposure that serves each pixel.

    Modulation b E over noise sqrt(c + s (black + a E)) reaches w where b^2 E^2 - w^2 s a E - w^2 (c + s black) = 0.
    """
    longest = (wanted.peak * sensor.full_dn - sensor.black_dn) / light.peak_per_us
    mean, w2 = light.peak_per_us - light.modulation_per_us, wanted.snr**2
    linear = w2 * sensor.noise_slope_dn * np.maximum(mean, 0)
    constant = w2 * (sensor.noise_constant_dn2 + sensor.noise_slope_dn * sensor.black_dn)
    square = light.modulation_per_us**2
    shortest = (linear + np.sqrt(linear**2 + 4 * square * constant)) / (2 * square)
    return shortest, longest


def _grid(wanted: Wanted) -> Float64Array:
    octaves = np.log2(wanted.longest_us / wanted.shortest_us)
    return np.geomspace(wanted.shortest_us, wanted.longest_us, max(2, int(octaves * STEPS_PER_OCTAVE) + 1))


def _best(counts: Float64Array, points: int) -> tuple[list[int], float]:
    """Return the grid's places that hit most intervals, and how many; `counts[i, j]` intervals go from i to j."""
    size = len(counts)
    right = np.cumsum(counts[:, ::-1], axis=1)[:, ::-1]  # from i, to j or beyond
    below = np.concatenate([np.zeros((1, size)), np.cumsum(right, axis=0)])  # [i, j]: from before i, to j or beyond
    # new[y, x]: intervals that x hits and no place up to y - 1 does; y = 0 for none before.
    place = np.arange(size)
    new = below[place + 1, place][None, :] - below[:size, place]
    value, path = new[0].copy(), np.zeros((points, size), int)
    for turn in range(1, points):
        options = np.where(
            place[:, None] < place[None, :], value[:, None] + new[np.minimum(place + 1, size - 1)], value[None, :]
        )
        path[turn] = options.argmax(axis=0)
        value = options.max(axis=0)
    last = int(size - 1 - value[::-1].argmax())  # the longest of equals: it has the most light
    served, chosen = float(value[last]), [last]
    for turn in range(points - 1, 0, -1):
        chosen.append(int(path[turn][chosen[-1]]))
    return sorted(set(chosen)), served


def _rounded(exposure_us: float) -> float:
    """Return two digits of it, never more than it is."""
    unit = 10.0 ** (np.floor(np.log10(exposure_us)) - 1)
    return float(round(np.floor(exposure_us / unit + 1e-9) * unit, 6))


def _reason(chosen: tuple[tuple[float, ...], float], wanted: Wanted, shortest: Float64Array) -> str:
    exposures, served = chosen
    text = f"{served:.1%} of the pixels reach {wanted.snr:g} times the noise unsaturated"
    number = "one exposure" if len(exposures) == 1 else f"{len(exposures)} exposures"
    one = len(exposures) == 1
    if served >= wanted.share - 0.005:
        return f"{number} {'is' if one else 'are'} enough: {text}"
    never = float(np.mean(shortest > wanted.longest_us))
    lost = f"; {never:.1%} never can" if never > 0.001 else ""
    return f"{number} {'does' if one else 'do'} not cover the range: {text}{lost}"


def _left_out(light: Brightness, dimmer: float, wanted: Wanted) -> str:
    text = ""
    if dimmer > 0.001:
        text += f"; {dimmer:.1%} are dimmer than {wanted.dimmest:g} of the brightest and left out: a backdrop?"
    if light.blinded > 0.001:
        text += (
            f"; {light.blinded:.1%} of all pixels were saturated even by the shortest exposure: measure again below it"
        )
    return text
