"""Fourier-transform profilometry: the phase of one frame from the band around its carrier.

Owns the filter, the background that is estimated along with it, and the masks. The carrier runs along the second
axis, rising to the right. Takes plain arrays; knows no contract.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import fft

from fringed_plugins.parallel import thread_count
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.single_frame.bands import Band, local_mean, noise_gain, smooth

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

SATURATED, LOW_MODULATION, RESIDUAL, OTHER = (np.uint16(flag) for flag in (1, 2, 8, 128))
_NOISE_ROWS, _QUANTISATION_DN2 = 256, 1 / 12
_MARGIN_PERIODS = 4  # beyond the borders: what leaks around the transform's circle stays there


class Analytic(NamedTuple):
    """The filtered fringes: `cosine` + i `sine` = modulation exp(i phase), their background and q of the noise.

    `continued` holds what was filtered: the fringes without background, continued into holes and beyond the
    borders, periodic and larger than the frame.
    """

    cosine: Float32Array
    sine: Float32Array
    background: Float32Array
    noise_gain: float | Float32Array
    continued: Float32Array


class SingleFrame(NamedTuple):
    """Arrays (height, width): wrapped phase and its standard deviation (NaN where dropped), the rest everywhere."""

    phase_rad: Float32Array
    sigma_rad: Float32Array
    modulation: Float32Array
    background: Float32Array
    rejected: npt.NDArray[np.uint16]


@dataclass(frozen=True)
class FrameLimits:
    """When a pixel of a single frame is dropped.

    `modulation_dn` and `modulation_snr` bound the fringes' amplitude from below; `misfit` bounds what the filter
    leaves of the fringes within about a period, as a part of the modulation, noise taken off; `support` how much of
    the filter's surroundings must have been measured.
    """

    modulation_dn: float = 3.0
    modulation_snr: float = 2.0
    misfit: float = 0.35
    support: float = 0.75


def _nothing(fraction: float) -> None:
    """Report to nobody."""


def analytic_signal(
    frame: Float32Array,
    valid: BoolArray,
    band: Band,
    background: Float32Array | None = None,
    iterations: int = 3,
    *,
    threads: int = 0,
    report: Callable[[float], None] = _nothing,
) -> Analytic:
    """Return the fringes of `frame` (height, width) within `band` as cosine and sine of their phase.

    Where nothing was measured (`valid` False, and beyond the borders) the fringes are continued: each iteration
    filters, puts the filtered fringes there, and takes the background anew from what the filter leaves of the
    frame. A `background` that was measured is kept.

    References
    ----------
    Takeda & Mutoh 1983, equations 8 to 12; Roddier & Roddier 1987 (continuation by iterated filtering).

    Examples
    --------
    >>> u = np.arange(256) / 16.0 + np.zeros((64, 1))
    >>> frame = (100 + 50 * np.cos(2 * np.pi * u)).astype(np.float32)
    >>> found = analytic_signal(frame, np.ones(frame.shape, bool), Band(1 / 16, 0.0, 0.04, 0.04))
    >>> error = np.angle((found.cosine + 1j * found.sine) * np.exp(-2j * np.pi * u))
    >>> bool(np.abs(error[:, 40:-40]).max() < 0.01)
    True
    """
    height, width = frame.shape
    workers = thread_count(threads)
    shape = _padded(frame.shape, band)
    period = max(round(band.period_px), 2)
    if height < 2 * period:  # too few rows to filter across them: each stands by itself
        band = replace(band, across=0.0, half_across=float("inf"))
    window = band.window(shape)
    weight = valid.astype(np.float32)
    share = smooth(weight, period)
    light: Float32Array = local_mean(frame * weight, period, share) if background is None else background
    canvas = np.zeros(shape, np.float32)
    canvas[:height, :width] = np.where(valid, frame - light, 0)
    for step in range(iterations + 1):
        spectrum = fft.rfft2(canvas, workers=workers, overwrite_x=True)
        spectrum *= window
        canvas = fft.irfft2(spectrum, shape, workers=workers)
        report((step + 1) / (iterations + 2))
        cosine = canvas[:height, :width]
        if step < iterations:
            if background is None:
                light = _ratio(smooth((frame - cosine) * weight, period), share)
            canvas[:height, :width] = np.where(valid, frame - light, cosine)
    spectrum *= np.complex64(-1j)
    sine = fft.irfft2(spectrum, shape, workers=workers, overwrite_x=True)[:height, :width]
    cosine = cosine.copy()
    canvas[:height, :width] = np.where(valid, frame - light, cosine)
    return Analytic(cosine, sine, light, noise_gain(window, shape[1]), canvas)


def _padded(shape: tuple[int, ...], band: Band) -> tuple[int, int]:
    """Return a size that transforms fast, with room for the filter's reach."""
    margin = int(_MARGIN_PERIODS * band.period_px)
    return fft.next_fast_len(shape[0] + margin, real=True), fft.next_fast_len(shape[1] + margin, real=True)


def _ratio(sums: Float32Array, share: Float32Array) -> Float32Array:
    return np.asarray(sums / np.maximum(share, 1e-6), np.float32)


def lit(frame: Float32Array, saturated: BoolArray, band: Band, least_dn: float) -> BoolArray:
    """Return where fringes of at least `least_dn` can be seen: what the filter may take as measured."""
    period = max(round(band.period_px), 2)
    weight = (~saturated).astype(np.float32)
    share = smooth(weight, period)
    fringes: Float32Array = (frame - _ratio(smooth(frame * weight, period), share)) * weight
    power = 2 * _ratio(smooth(fringes * fringes, period), share)
    return np.asarray((power >= least_dn**2) & ~saturated)


def single_frame(
    found: Analytic, frame: Float32Array, valid: BoolArray, saturated: BoolArray, band: Band, *,
    noise: NoiseModel, limits: FrameLimits = FrameLimits(), frame_variances: float = 1.0, shift_rad: float = 0.0,
) -> SingleFrame:  # fmt: skip
    """Return phase, noise, modulation and mask of the filtered fringes.

    `frame_variances` is the variance of `frame` over that of one exposure: 1/2 for half the difference of two, 2
    for a difference. `shift_rad` is taken off the phase. The standard deviation is
    `sigma_frame sqrt(q) / modulation`, q the window's noise bandwidth (`bands.noise_gain`); neighbouring pixels
    share their noise.
    """
    period = max(round(band.period_px), 2)
    modulation: Float32Array = np.hypot(found.cosine, found.sine)
    variance = noise.constant_dn2 + noise.slope_dn * np.maximum(found.background, 0)
    variance = (frame_variances * variance).astype(np.float32)
    weight = valid.astype(np.float32)
    share = smooth(weight, period)
    left = (frame - found.background - found.cosine) * weight
    misfit = 2 * np.maximum(_ratio(smooth(left * left, period), share) - variance, 0)
    least = np.maximum(limits.modulation_dn**2, limits.modulation_snr**2 * variance)
    rejected = np.where(saturated, SATURATED, np.uint16(0))
    rejected |= np.where((modulation**2 < least) | ~(valid | saturated), LOW_MODULATION, np.uint16(0))
    rejected |= np.where(misfit > (limits.misfit * modulation) ** 2, RESIDUAL, np.uint16(0))
    rejected |= np.where(share < limits.support, OTHER, np.uint16(0))
    phase = np.arctan2(found.sine, found.cosine)
    if shift_rad:
        phase = phase - np.float32(shift_rad)
        phase -= np.float32(2 * np.pi) * np.rint(phase / np.float32(2 * np.pi))
    deviation = np.sqrt(np.asarray(found.noise_gain, np.float32) * variance) / np.maximum(modulation, np.float32(1e-6))
    dropped = rejected != 0
    nan = np.float32(np.nan)
    sigma = np.asarray(np.where(dropped, nan, deviation), np.float32)
    phase = np.asarray(np.where(dropped, nan, phase), np.float32)
    return SingleFrame(
        phase, sigma, np.asarray(modulation, np.float32), np.ascontiguousarray(found.background), rejected
    )


def frame_noise(frame: Float32Array) -> NoiseModel:
    """Estimate one frame's noise from second differences down its fringes, which they hardly change.

    The spread of what is no outlier, on rows from the middle: a constant, right for the typical brightness.

    Examples
    --------
    >>> frame = 100 + np.random.default_rng(1).normal(0, 2, (80, 400))
    >>> round(float(np.sqrt(frame_noise(frame.astype(np.float32)).constant_dn2)), 1)
    2.0
    """
    if frame.shape[0] < 3:
        return NoiseModel(1.0, 0.0)
    first = max((len(frame) - _NOISE_ROWS) // 2, 0)
    rows = frame[first : first + _NOISE_ROWS]
    second = np.abs(rows[:-2] - 2 * rows[1:-1] + rows[2:])
    # The median of whole grey levels is a whole grey level itself: it only says what an outlier is.
    inside = second <= 6 * np.median(second) + 1
    return NoiseModel(max(float(np.mean(second[inside] ** 2)) / 6, _QUANTISATION_DN2), 0.0)
