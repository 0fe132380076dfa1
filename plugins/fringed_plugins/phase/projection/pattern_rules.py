"""Which shapes, shifts, grey levels and tone curves make patterns that nobody can decode.

Owns these rules, each with its reason and what to use instead; the rules for sets of frequencies are in `patterns`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.projection.patterns import MIN_CONTRAST, Greys
from fringed_plugins.phase.projection.profiles import MIN_PERIOD_PX, TWO_LEVEL, profile

Float64Array = npt.NDArray[np.float64]
_DEGREE = np.pi / 180
_JUMP = 0.1  # of the range of light, between neighbouring grey levels
_ORDER_SHARE = 0.6  # of half a period, what the shape may take of the room that noise has
_CLIPPED = 0.05  # of the range of grey levels that all give the brightest light


def check_shape(style: str, period_px: float, shifts_rad: Sequence[float], dither: str = "none") -> None:
    """Check that a style can show a period, and that its frames differ.

    Raises
    ------
    ValueError
        a period that is too short for the style, shifts of less than a pixel where there are two levels only, or
        grey levels to dither where there are none.
    """
    least = MIN_PERIOD_PX[style]
    if period_px < least - 1e-9:
        simpler = "" if style == "sinusoidal" else ", or the style sinusoidal"
        raise ValueError(
            f"a {style} fringe of {period_px:.3g} px is too short for its shape; use {least:g} px or more{simpler}"
        )
    if style in TWO_LEVEL and dither != "none":
        raise ValueError(f"dither = {dither!r} varies grey levels; the style {style} has two only: leave it at none")
    moved_px = _least_distance(shifts_rad) / (2 * np.pi) * period_px
    if style in ("binary", "binary-pulse-width") and 1e-6 < moved_px < 1 - 1e-9:
        raise ValueError(
            f"{len(shifts_rad)} steps move {style} fringes of {period_px:.3g} px by {moved_px:.2g} px, so that "
            f"patterns repeat: use fewer steps, or a period of {len(shifts_rad)} px and more"
        )


def check_shifts(shifts_rad: Sequence[float]) -> None:
    """Check that phase shifts determine background, modulation and phase.

    Raises
    ------
    ValueError
        fewer than three different ones, or three that nearly coincide.
    """
    from fringed_plugins.phase.shifts import transform

    different = {round(float(np.mod(shift, 2 * np.pi)) / _DEGREE) % 360 for shift in shifts_rad}
    if not np.isfinite(shifts_rad).all() or len(different) < 3:
        text = ", ".join(f"{shift:.4g}" for shift in shifts_rad)
        raise ValueError(
            f"shifts of ({text}) rad are {len(different)} different ones (whole turns aside); background, modulation "
            "and phase are three unknowns: give three or more, such as 0, 2.094 and 4.189"
        )
    transform(shifts_rad)


def shape_error(style: str, period_px: float, shifts_rad: Sequence[float]) -> float:
    """Return the largest error (rad) that a style in focus leaves in the least-squares phase of these shifts.

    References
    ----------
    Wyant 1975, Creath 1988 (harmonics and the phase of N steps).

    Examples
    --------
    >>> equal = [0.0, np.pi / 2, np.pi, 3 * np.pi / 2]
    >>> [round(shape_error(style, 512.0, equal), 2) for style in ("sinusoidal", "triangular", "binary")]
    [0.0, 0.07, 0.78]
    """
    from fringed_plugins.phase.shifts import transform

    phase = 2 * np.pi * (np.arange(720) + 0.5) / 720
    light = np.array([profile(style, phase + shift, period_px) for shift in shifts_rad])
    _, c, s = transform(shifts_rad)[:3] @ light
    return float(np.abs(np.angle(np.exp(1j * (np.arctan2(s, c) - phase)))).max())


def check_shape_unwraps(style: str, period_px: float, shifts_rad: Sequence[float], ratio: float) -> None:
    """Check that the phase of a coarse fringe, which no blur smooths, tells the orders of a `ratio` times finer one.

    Raises
    ------
    ValueError
        stairs of a style that come out as wrong fringe orders.
    """
    error = shape_error(style, period_px, shifts_rad)
    if ratio * error > _ORDER_SHARE * np.pi:
        raise ValueError(
            f"{len(shifts_rad)} steps of {style} fringes of {period_px:.4g} px are off by up to {error:.2g} rad, and "
            f"no blur smooths so long a period: {ratio:.3g} times finer fringes would get wrong orders. Use ratios to "
            f"{_ORDER_SHARE * np.pi / error:.2g}, more steps, the style sinusoidal or triangular, or the encoder "
            "heterodyne, whose fringes are all fine"
        )


def check_period_within(length_px: float, period_px: float) -> None:
    """Check that a wrapped phase has at least one turn on the projector.

    Raises
    ------
    ValueError
        a period longer than the projector, which nothing unwraps and nothing needs to.
    """
    if period_px > length_px * (1 + 1e-9):
        raise ValueError(
            f"a period of {period_px:g} px is longer than the projector's {length_px:g} px: the phase would tell "
            f"little more than noise; use {length_px:g} px or less (1 period or more), or the encoder multi-frequency"
        )


def check_tone(greys: Greys, style: str) -> None:
    """Check that the projector's tone curve gives light between the two grey levels, and the shape where it matters.

    Raises
    ------
    ValueError
        a curve that falls, gives next to no light in the range, or jumps; the message says what to do.
    """
    low, high = round(greys.low), round(greys.high)
    curve = greys.tone_curve
    if curve is None:
        return
    greys.of(np.zeros(1))  # a curve that falls is refused there
    rising = np.maximum.accumulate(np.asarray(curve, np.float64))
    whole, span = float(rising[-1] - rising[0]), float(rising[high] - rising[low])
    if span < whole * MIN_CONTRAST / 255:
        raise ValueError(
            f"grey levels {low} to {high} give {100 * span / whole:.2g} % of the projector's range of light, all the "
            "same to the camera: widen grey_low and grey_high"
        )
    jump = float(np.diff(rising[low : high + 1]).max()) / span
    if style not in TWO_LEVEL and jump > _JUMP:
        at = low + int(np.diff(rising[low : high + 1]).argmax())
        raise ValueError(
            f"the tone curve jumps by {100 * jump:.0f} % of the light from grey level {at} to {at + 1}, so that no "
            f"{style} fringes can be shown: measure it again, or use a binary style"
        )


def check_clipping(greys: Greys, measured: Float64Array, style: str) -> None:
    """Check that grey levels that are projected without compensation do not all give the brightest light.

    `measured` is the projector's tone curve (256,), `greys` are those in use.

    Raises
    ------
    ValueError
        fringes whose crests the projector cuts off.
    """
    low, high = round(greys.low), round(greys.high)
    rising = np.maximum.accumulate(np.asarray(measured, np.float64))
    span = float(rising[high] - rising[low])
    clipped = int(np.count_nonzero(rising[low : high + 1] >= rising[high] - 1e-3 * span)) - 1
    if style not in TWO_LEVEL and clipped > _CLIPPED * (high - low):
        raise ValueError(
            f"the projector gives the same light from grey level {high - clipped} on, so that fringes up to {high} "
            f"would be cut off: use grey_high = {high - clipped}, or precompensate = true"
        )


def check_levels(levels: Sequence[float], greys: Greys) -> None:
    """Check several shares of the light.

    Raises
    ------
    ValueError
        none, the same one twice, or one that leaves too little contrast.
    """
    if not levels or len(set(levels)) != len(levels):
        raise ValueError(f"levels {list(levels)}; give one or more, each once, such as [1.0, 0.25]")
    least = MIN_CONTRAST / (greys.high - greys.low)
    if min(levels) < least:
        raise ValueError(
            f"a level of {min(levels):g} leaves fewer than {MIN_CONTRAST:g} grey levels of contrast; use {least:.3g} "
            "or more, and a shorter exposure for what is still too bright"
        )


def _least_distance(shifts_rad: Sequence[float]) -> float:
    """Return the smallest distance (rad) of two different shifts on the circle."""
    turns = np.unique(np.round(np.mod(np.asarray(shifts_rad, float), 2 * np.pi), 9) % round(2 * np.pi, 9))
    if len(turns) < 2:
        return 0.0
    return float(np.diff(np.append(turns, turns[0] + 2 * np.pi)).min())
