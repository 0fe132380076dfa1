"""Fringes as grey levels, compensated for the projector's tone curve, and which of them cannot be decoded.

Owns the way from relative light to grey levels and the rules for sets of frequencies; the shapes of fringes are in
`profiles`, the rules for their shapes and for tone curves in `pattern_rules`. Knows no projector and no contract.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]

MIN_PERIOD_PX = 4.0
MIN_CONTRAST = 16.0
_SAFE_SIGMAS = 5.0


def sinusoid(length_px: int, period_px: float, phase_rad: float) -> Float64Array:
    """Return (1 + cos(2 pi u / period_px + phase_rad)) / 2 for u = 0 ... length_px - 1.

    Examples
    --------
    >>> sinusoid(4, 4.0, 0.0).round(3)
    array([1. , 0.5, 0. , 0.5])
    """
    u = np.arange(length_px, dtype=np.float64)
    return (1 + np.cos(2 * np.pi * u / period_px + phase_rad)) / 2


def grey_levels(
    relative: Float64Array, grey_low: float, grey_high: float, tone_curve: Float64Array | None = None
) -> UInt8Array:
    """Return the grey levels (uint8) whose light follows `relative` (0 to 1) between two grey levels.

    `tone_curve` (256,) is the light of each grey level; for each wanted light the nearest one is
    taken. Without it the grey levels themselves follow `relative`.

    Raises
    ------
    ValueError
        a tone curve that does not rise, so that no grey level stands for a light.
    """
    if tone_curve is None:
        return np.rint(grey_low + (grey_high - grey_low) * relative).astype(np.uint8)
    curve = _rising(np.asarray(tone_curve, np.float64))
    low, high = round(grey_low), round(grey_high)
    light = curve[low] + (curve[high] - curve[low]) * relative
    above = np.clip(np.searchsorted(curve, light), 1, 255)
    nearer_below = light - curve[above - 1] < curve[above] - light
    return np.asarray(np.clip(above - nearer_below, low, high), np.uint8)


def _rising(curve: Float64Array) -> Float64Array:
    if curve.shape != (256,) or not np.isfinite(curve).all():
        raise ValueError(
            f"a tone curve is 256 finite numbers, one for each grey level; this one has shape {curve.shape}"
        )
    rising = np.maximum.accumulate(curve)
    span = float(rising[-1] - rising[0])
    dip = float((rising - curve).max())
    if span <= 0 or dip > 0.02 * span:
        raise ValueError(
            f"the tone curve falls by up to {dip:.4g} of a range of {span:.4g}; it must rise with the grey level: "
            "measure it again, or drop it from the calibration"
        )
    return rising


@dataclass(frozen=True)
class Greys:
    """Which grey levels fringes may have: the range, the light of each level (256,) if known, and the share of it.

    `level` is the light over that of the whole range, 0 to 1; what the projector gives at grey level 0 stays.
    """

    low: float = 0.0
    high: float = 255.0
    tone_curve: Float64Array | None = None
    level: float = 1.0

    def of(self, relative: Float64Array, dither: str = "none") -> UInt8Array:
        """Return the grey levels (uint8) whose light follows `relative` (0 to 1, any shape; two axes to dither).

        Parameters
        ----------
        dither
            "none": the nearest level; "ordered", "error-diffusion": levels vary so that their mean follows.

        Raises
        ------
        ValueError
            a tone curve that does not rise.
        """
        if dither == "none" and self.level == 1.0:
            return grey_levels(relative, self.low, self.high, self.tone_curve)
        first, light, wanted = self._light(relative)
        if dither == "none":
            above = np.clip(np.searchsorted(light, wanted), 1, len(light) - 1)
            return np.asarray(first + above - (wanted - light[above - 1] < light[above] - wanted), np.uint8)
        from fringed_plugins.phase.projection import dithering

        index = dithering.ordered(wanted, light) if dither == "ordered" else dithering.diffuse(wanted, light)
        return np.asarray(index + first, np.uint8)

    def sparing(self, relative: Float64Array, period_px: float, steps: int = 0) -> UInt8Array:
        """Return the grey levels of a line (n,) of fringes, rounded so that the phase of `steps` equal steps is spared.

        Raises
        ------
        ValueError
            a tone curve that does not rise.
        """
        from fringed_plugins.phase.nonlinear.rounding import quiet_levels

        first, light, wanted = self._light(relative)
        return np.asarray(first + quiet_levels(wanted, light, period_px, steps), np.uint8)

    def complement(self, relative: Float64Array, grey: UInt8Array, dither: str = "none") -> UInt8Array:
        """Return the grey levels whose light and that of `grey` (made of `relative`) add up to a constant.

        Without a tone curve, and of two levels only, the grey levels themselves add up to the same number everywhere.
        """
        ends = self.of(np.array([0.0, 1.0]))
        if self.tone_curve is None or np.isin(relative, (0.0, 1.0)).all():
            return np.asarray(int(ends[0]) + int(ends[1]) - grey.astype(np.int16), np.uint8)
        return self.of(1 - relative, dither)

    def _light(self, relative: Float64Array) -> tuple[int, Float64Array, Float64Array]:
        """Return the first level in use, the light of each level from there, and the wanted light."""
        curve = np.arange(256.0) if self.tone_curve is None else _rising(np.asarray(self.tone_curve, np.float64))
        low, high = round(self.low), round(self.high)
        span = curve[low] - curve[0] + (curve[high] - curve[low]) * relative
        first = low if self.level == 1.0 else 0
        return first, curve[first : high + 1], curve[0] + self.level * span


def check_greys(grey_low: float, grey_high: float) -> None:
    """Check the range of grey levels.

    Raises
    ------
    ValueError
        a range outside 0 to 255 or with too little contrast.
    """
    if not 0 <= grey_low < grey_high <= 255 or grey_high - grey_low < MIN_CONTRAST:
        raise ValueError(
            f"grey levels from {grey_low:g} to {grey_high:g} make no fringes; they must lie within 0 to 255, "
            f"at least {MIN_CONTRAST:g} apart: use 0 and 255"
        )


def check_steps(steps: float) -> None:
    """Check the number of phase steps.

    Raises
    ------
    ValueError
        fewer than three, which leave background, modulation and phase undetermined.
    """
    if steps < 3:
        raise ValueError(
            f"{steps:g} phase steps cannot be decoded: background, modulation and phase are three unknowns for each "
            "pixel; use 3 or more, 4 if in doubt"
        )


def check_period(length_px: int, periods: float) -> None:
    """Check the length of a period.

    Raises
    ------
    ValueError
        not positive, or shorter than the projector shows as a sinusoid.
    """
    if not (np.isfinite(periods) and periods > 0):
        raise ValueError(f"{periods} periods across the projector; the number must be above 0")
    if length_px / periods < MIN_PERIOD_PX:
        raise ValueError(
            f"{periods:g} periods across {length_px} px are {length_px / periods:.3g} px each; below "
            f"{MIN_PERIOD_PX:g} px a projector shows no sinusoid: use at most {int(length_px / MIN_PERIOD_PX)} periods"
        )


def check_frequencies(length_px: int, periods: Sequence[float], steps: Sequence[float], snr: float) -> None:
    """Check that a set of frequencies can be unwrapped from coarse to fine; steps that are not equal count as fewer.

    `snr` is the modulation over the noise of one frame that is expected; a coarse phase, times the
    ratio to the next frequency, must tell its fringe order apart with five standard deviations.

    Raises
    ------
    ValueError
        with the reason, and what to use instead.
    """
    if list(periods) != sorted(set(periods)):
        raise ValueError(f"periods {list(periods)} must rise from coarse to fine, such as [1, 8, 64]")
    if len(steps) != len(periods):
        raise ValueError(
            f"{len(steps)} numbers of steps for {len(periods)} frequencies; give one number, or one for each"
        )
    for count, number in zip(steps, periods, strict=True):
        if isinstance(count, int):
            check_steps(count)
        check_period(length_px, number)
    if periods[0] > 1:
        raise ValueError(
            f"the coarsest frequency has {periods[0]:g} periods across the projector, so that several columns share "
            f"every phase and no unwrapping can tell them apart: start with 1, as in {[1, *periods]}"
        )
    for coarse, fine, count in zip(periods[:-1], periods[1:], steps[:-1], strict=True):
        most = largest_ratio(count, snr)
        if fine / coarse > most:
            between = round(float(np.sqrt(coarse * fine)))
            raise ValueError(
                f"from {coarse:g} to {fine:g} periods is a ratio of {fine / coarse:.3g}; with {count:g} steps and a "
                f"modulation of {snr:g} times the noise orders are safe up to {most:.3g}: add a frequency of about "
                f"{between} periods, or more steps"
            )


def largest_ratio(steps: float, snr: float) -> float:
    """Return the largest ratio of two frequencies whose fringe order is right at five sigma.

    The difference of prediction and measurement has the deviation sqrt(1 + ratio^2) sqrt(2/steps)/snr
    (rad) and must stay within pi.

    Examples
    --------
    >>> round(largest_ratio(4, 20.0), 1)
    17.7
    """
    sigma_rad = np.sqrt(2 / steps) / snr
    return float(np.sqrt(max((np.pi / (_SAFE_SIGMAS * sigma_rad)) ** 2 - 1, 0)))
