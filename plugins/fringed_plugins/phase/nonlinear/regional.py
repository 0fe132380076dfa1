"""Harmonics of the phase error from the maps of several frequencies alone, following the blur over the field.

Owns what is fitted and how it is taken off; the least squares are in `regional_fit`. The wrapped phases of two
frequencies are the same column in two scales, but for their errors; these have other periods, N times their fringes',
so that one fit tells both apart. No calibration and no second surface is needed: what is corrected is the very scan.

How strong a harmonic is depends on the blur, and that on the surface. The ratio of the fine fringes' modulation to the
coarse ones' tells the blur of every pixel, whatever the surface's colour; each harmonic is a polynomial of its
logarithm. No shape of the blur is assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.nonlinear.blur import blur_indicator
from fringed_plugins.phase.nonlinear.correct_kernel import remove_rows
from fringed_plugins.phase.nonlinear.regional_fit import Fit, Fringes

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

_ROUNDS = 12
_PLAIN_ROUNDS = 3  # with the same harmonics everywhere, so that wrong orders are out before details count
_BLUR_RATIO = 8.0  # how much coarser the fringes are, ideally, whose modulation the fine one's is compared with
_SETTLED_RAD = 1e-4


@dataclass(frozen=True)
class RegionalHarmonics:
    """The error of the finest fringes: `series` (3, 3), multiples of N by powers of the blur indicator.

    `indicator` (height, width) is the logarithm of fine over coarse modulation, smoothed; it enters as
    `(indicator - centre) / spread`, within -1 to 1. `rms_rad` is the RMS of the error over the pixels, `deviation_rad`
    the standard deviation of the correction from the noise of the maps, `disagreement_rad` the RMS difference of the
    maps, in phase of the coarser ones, before and after.
    """

    series: Float64Array
    steps: int
    indicator: Float32Array
    centre: float
    spread: float
    rms_rad: float
    deviation_rad: float
    disagreement_rad: tuple[float, float]
    pixels: int
    converged: bool
    reason: str


def estimate_harmonics(
    phase_rad: Float32Array, fine: Fringes, coarser: Sequence[Fringes], blur_terms: int = 3
) -> RegionalHarmonics:
    """Return the harmonics of the error of `fine`, whose absolute phase is `phase_rad` (height, width), NaN where none.

    Measured = true + angle(1 + sum_k q_k exp(-i k N true)), k = 1, 2, 3, which holds for an error of any size and any
    odd shape that leaves the measured phase rising; q_k is a polynomial of `blur_terms` (1 to 3) coefficients in the
    blur indicator. Gauss-Newton on the differences of `coarser` to what `phase_rad` predicts for them; outliers, such
    as wrong fringe orders, are left out.

    Raises
    ------
    ValueError
        no second frequency, or fewer than 500 pixels.

    References
    ----------
    Xing & Guo 2018 (harmonics from the maps of a multi-frequency scan), with two differences: the error is not taken to
    first order, and its size follows the measured blur instead of being one for the whole field.

    Examples
    --------
    >>> u = np.linspace(100, 900, 60000).reshape(200, 300)
    >>> bend = lambda phase: phase + np.angle(1 + 0.2 * np.exp(-3j * phase))  # three steps, B_2 / B_1 = 0.2
    >>> maps = [Fringes(np.exp(1j * bend(2 * np.pi * u / p)).astype(np.complex64), 3, p) for p in (16.0, 128.0)]
    >>> found = estimate_harmonics(bend(2 * np.pi * u / 16).astype(np.float32), maps[0], maps[1:])
    >>> found.converged, round(float(found.series[0, 0]), 3)
    (True, 0.2)
    """
    if not coarser:
        raise ValueError(
            "one frequency cannot tell its error from the surface; scan with two or more, or compensate with a tone "
            "curve before projecting"
        )
    if blur_terms not in (1, 2, 3):
        raise ValueError(f"{blur_terms} blur terms; 1 (the same everywhere), 2 or 3")
    fit = Fit((fine, *coarser), phase_rad)
    nearest = min(coarser, key=lambda group: abs(float(np.log(group.period_px / fine.period_px / _BLUR_RATIO))))
    pair = [(group.vector, group.steps) for group in (fine, nearest)]
    indicator = blur_indicator(pair[0], pair[1], np.isfinite(phase_rad))
    fit.place_blur(indicator)
    before, reason = _settled(fit, fine.steps, blur_terms)
    return RegionalHarmonics(
        series=fit.series[0].copy(),
        steps=fine.steps,
        indicator=indicator,
        centre=fit.centre,
        spread=fit.spread,
        rms_rad=float(np.sqrt(np.mean(fit.error_rad**2))),
        deviation_rad=fit.deviation_rad,
        disagreement_rad=(before, fit.disagreement_rad[1]),
        pixels=fit.pixels,
        converged=not reason,
        reason=reason,
    )


def _settled(fit: Fit, steps: int, blur_terms: int) -> tuple[float, str]:
    """Run the rounds; return the maps' disagreement (rad) before any correction, and why the fit failed, if it did."""
    before, reason = 0.0, f"it still changes after {_ROUNDS} rounds"
    for number in range(_ROUNDS):
        fit.settled = number > _PLAIN_ROUNDS + 1
        change = fit.improve(1 if number < _PLAIN_ROUNDS else blur_terms)
        before = before or fit.disagreement_rad[0]
        if number > _PLAIN_ROUNDS and change < max(_SETTLED_RAD, 0.1 * fit.deviation_rad):
            reason = ""
            break
    limit = 1 / (steps + 1)
    if fit.largest() > limit:
        reason = (
            f"the strongest harmonic is {fit.largest():.2f} of the fundamental; from {limit:.2f} on the phase of "
            f"{steps} steps rises and falls within a ripple, and several columns share one measured phase: take more "
            "steps, or compensate with a tone curve before projecting"
        )
    return before, reason


def remove(phase_rad: Float32Array, harmonics: RegionalHarmonics, threads: int = 0) -> Float32Array:
    """Return the phase (height, width), wrapped or absolute, without the error; NaN stays.

    Raises
    ------
    ValueError
        a phase of another size than the one that the harmonics were found on.
    """
    if phase_rad.shape != harmonics.indicator.shape:
        raise ValueError(f"a phase of shape {phase_rad.shape} for harmonics of {harmonics.indicator.shape}")
    out = np.empty(phase_rad.shape, np.float32)
    numbers = (np.float32(harmonics.steps), np.float32(harmonics.centre), np.float32(harmonics.spread))
    maps = (_locked(phase_rad), _locked(harmonics.indicator))
    run_rows(remove_rows, len(out), maps, _locked(harmonics.series), numbers, out, threads=threads)
    return out


def _locked(array: npt.NDArray[np.floating]) -> Float32Array:
    """Return a C-ordered read-only float32 view: one compiled kernel for whatever is given."""
    view = np.ascontiguousarray(array, np.float32).view()
    view.flags.writeable = False
    return view
