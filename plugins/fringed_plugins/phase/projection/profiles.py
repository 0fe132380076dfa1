"""Shapes of fringes: one period of each style, as it is put on a projector's pixels.

Owns the shapes, their Fourier series and the shortest period that shows them; knows no grey level and no projector.
Every style has the fundamental `fundamental(style) cos(phase)` around 1/2. Sinusoids are taken at the pixel's
centre, sloped shapes are averaged over the pixel, and what has two levels only takes that of the pixel's centre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise, product

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]

STYLES = (
    "sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary", "binary-pulse-width", "binary-dithered",
)  # fmt: skip
TWO_LEVEL = ("binary", "binary-pulse-width", "binary-dithered")
MIN_PERIOD_PX = {
    "sinusoidal": 4.0, "sawtooth": 8.0, "triangular": 8.0, "trapezoidal": 12.0, "binary": 4.0,
    "binary-pulse-width": 18.0, "binary-dithered": 12.0,
}  # fmt: skip
# Knots (phase in turns, value); straight lines between them.
_KNOTS: dict[str, tuple[tuple[float, float], ...]] = {
    "sawtooth": ((0.0, 0.75), (0.25, 1.0), (0.25, 0.0), (1.0, 0.75)),
    "triangular": ((0.0, 1.0), (0.5, 0.0), (1.0, 1.0)),
    "trapezoidal": ((0.0, 1.0), (1 / 6, 1.0), (1 / 3, 0.0), (2 / 3, 0.0), (5 / 6, 1.0), (1.0, 1.0)),
}
# Edges within a quarter of a period that leave no harmonic 3, none of 3 and 5, none of 3, 5 and 7. Each solves
# 1 + 2 sum_i (-1)^i cos(k edge_i) = 0 for these k, with the largest fundamental.
_NOTCHES: tuple[tuple[float, ...], ...] = (
    (0.3490658503988659,),
    (0.4126821275630428, 0.5816777403707902),
    (0.2440266145343956, 0.6499252731525638, 0.7438695482285400),
)


def profile(style: str, phase_rad: Float64Array, period_px: float) -> Float64Array:
    """Return the relative light (0 to 1) of pixels with these phases at their centres.

    Parameters
    ----------
    style
        one of `STYLES`; "binary-dithered" has the light that its dots stand for, a sinusoid.
    phase_rad
        any shape, rad.
    period_px
        length of the period, which sets the width of a pixel.

    References
    ----------
    Huang, Zhang & Chiang 2005 (trapezoidal); Wang & Zhang 2010 (pulse width); Wyant 1975 and Creath 1988 (harmonics).

    Examples
    --------
    >>> profile("binary", np.arange(8) * np.pi / 4 + np.pi / 8, 8.0).tolist()
    [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]
    """
    if style in ("sinusoidal", "binary-dithered"):
        return (1 + np.cos(phase_rad)) / 2
    if style == "binary":
        return (np.mod(phase_rad + np.pi / 2 + 1e-9, 2 * np.pi) < np.pi).astype(np.float64)
    if style == "binary-pulse-width":
        return _pulse_width(phase_rad, notches(period_px))
    turns = np.asarray(phase_rad, np.float64) / (2 * np.pi)
    half = 0.5 / period_px
    area = _area(style, turns + half) - _area(style, turns - half)
    return np.asarray(np.clip(area / (2 * half), 0.0, 1.0), np.float64)


def offset_rad(style: str, period_px: float) -> float:
    """Return the phase to add so that edges fall between pixels where there are two levels only.

    It is half a pixel, or nothing where a quarter of the period ends with half a pixel. With periods of an even
    number of pixels and shifts of whole pixels the fundamental's phase is then exactly what the frames say.
    """
    if style not in ("binary", "binary-pulse-width") or math.isclose(period_px % 4, 2):
        return 0.0
    return math.pi / period_px


@lru_cache(maxsize=256)
def notches(period_px: float) -> tuple[float, ...]:
    """Return the edges (rad) within a quarter of a period that leave the least of the harmonics 3 to 11.

    No pulse is narrower than a pixel. In periods of an even number of pixels the edges lie between pixels; the few
    places around the continuous solution are compared. Harmonics count by 1/k^3, as blur will take the higher ones.

    Examples
    --------
    >>> [len(notches(p)) for p in (18.0, 38.0, 256.0)]
    [1, 2, 3]
    """
    unit = 2 * math.pi / period_px
    whole = period_px % 2 == 0
    candidates: list[tuple[float, ...]] = []
    for edges in _NOTCHES:
        near = [tuple(round(e / unit) + d for d in (-2, -1, 0, 1, 2)) if whole else (e / unit,) for e in edges]
        kept = (c for c in product(*near) if _narrowest(c) >= 1 and 4 * c[-1] < period_px)
        candidates += [tuple(e * unit for e in c) for c in kept]
    return min(candidates, key=_ripple, default=_NOTCHES[0])


def _narrowest(edges_px: Sequence[float]) -> float:
    return min(b - a for a, b in pairwise((0.0, *edges_px)))


def _ripple(edges: tuple[float, ...]) -> float:
    amplitude = [harmonic("binary-pulse-width", k, edges) for k in (1, 3, 5, 7, 9, 11)]
    total = sum((a / k**3) ** 2 for a, k in zip(amplitude[1:], (3, 5, 7, 9, 11), strict=True))
    return total / max(amplitude[0], 1e-3) ** 2


def harmonic(style: str, order: int, edges: Sequence[float] = _NOTCHES[0]) -> float:
    """Return the amplitude a of `a cos(order phase + some phase)` in one period of ideal light, mean 1/2.

    For "binary-pulse-width" it depends on the `edges` that `notches` gives; "binary-dithered" has the harmonics of a
    sinusoid, and noise.

    Examples
    --------
    >>> [round(harmonic("triangular", k), 4) for k in (1, 2, 3)]
    [0.4053, 0.0, 0.045]
    """
    odd = order % 2
    if style in ("sinusoidal", "binary-dithered"):
        return 0.5 if order == 1 else 0.0
    if style == "sawtooth":
        return 1 / (math.pi * order)
    if style == "triangular":
        return odd * 4 / (math.pi * order) ** 2
    if style == "trapezoidal":
        ramp = math.pi * order / 6
        return odd * 2 / (math.pi * order) * abs(math.sin(ramp) / ramp)
    if style == "binary":
        return odd * 2 / (math.pi * order)
    total = 1 + 2 * sum((-1) ** (i + 1) * math.cos(order * edge) for i, edge in enumerate(edges))
    return float(odd * 2 / (math.pi * order) * abs(total))


def fundamental(style: str, period_px: float) -> float:
    """Return the amplitude of the fundamental, of a full range of light 1: a sinusoid has 1/2."""
    return harmonic(style, 1, notches(period_px))


def _area(style: str, turns: Float64Array) -> Float64Array:
    """Return the integral of a sloped shape from 0."""
    where = np.array([knot[0] for knot in _KNOTS[style]])
    value = np.array([knot[1] for knot in _KNOTS[style]])
    width = np.diff(where)
    sums = np.concatenate([[0.0], np.cumsum(width * (value[1:] + value[:-1]) / 2)])
    whole = np.floor(turns)
    rest = turns - whole
    piece = np.clip(np.searchsorted(where, rest, side="right") - 1, 0, len(width) - 1)
    into = rest - where[piece]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(width > 0, (value[1:] - value[:-1]) / width, 0.0)
    return np.asarray(whole * sums[-1] + sums[piece] + into * (value[piece] + slope[piece] * into / 2), np.float64)


def _pulse_width(phase_rad: Float64Array, edges: tuple[float, ...]) -> Float64Array:
    """Return the two-level shape: quarter-wave symmetric, switching at `edges` counted from where a cosine is zero."""
    folded = np.abs(np.angle(np.exp(1j * (np.asarray(phase_rad, np.float64) + 1e-9))))
    rising = folded <= np.pi / 2
    from_zero = np.abs(np.pi / 2 - folded)
    switched = np.searchsorted(np.asarray(edges), from_zero) % 2
    first = 1 if len(edges) % 2 == 0 else 0  # the level of the last piece, at the crest, is bright
    bright = (switched == 0) == bool(first)
    return np.asarray(bright == rising, np.float64)
