"""Windowed Fourier filtering and ridges: noise taken out of fringes where each local frequency stands by itself.

Owns what is kept of the windows' coefficients, and the ridge; the windows are in `window_bank`. Takes a real frame
whose background is gone, or the complex exp(i phase) of a wrapped map. Knows no contract.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy import fft, ndimage

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.single_frame.window_bank import Bank, Plane, spread

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
Complex64Array = npt.NDArray[np.complex64]


class Filtered(NamedTuple):
    """The filtered field (height, width) complex64, and q of its noise: sigma_phase^2 = q sigma^2 / modulation^2."""

    field: Complex64Array
    noise_gain: Float32Array
    kept: float  # part of the coefficients that stood out of the noise


class Ridge(NamedTuple):
    """Height, phase and local frequency of the strongest window at every pixel, float32 (height, width)."""

    amplitude: Float32Array
    phase_rad: Float32Array
    along: Float32Array
    across: Float32Array


def _nothing(fraction: float) -> None:
    """Report to nobody."""


def filtered(
    field: Array,
    bank: Bank,
    threshold: float,
    *,
    periodic: bool = False,
    threads: int = 0,
    report: Callable[[float], None] = _nothing,
) -> Filtered:
    """Return what stands out of `field` (height, width): coefficients of at least `threshold`, put together again.

    A real field gives its analytic signal, modulation exp(i phase), where `bank` holds frequencies of one sign only.
    `threshold` is three standard deviations of `noise_of_coefficients` by custom; a sinusoid's coefficient is
    half its modulation. `noise_gain` is an upper bound: kept windows count as if their bands did not overlap. For a
    complex field it multiplies the variance of the phase that went in. Beyond a field's borders there is nothing,
    unless it is `periodic`.

    Raises
    ------
    ValueError
        a bank whose limits do not rise, or windows wider than the field.

    References
    ----------
    Kemao 2004, equations 5 and 9; Kemao 2007, section 2.

    Examples
    --------
    >>> u = np.arange(160) / 16.0 + np.zeros((120, 1))
    >>> noise = np.random.default_rng(1).normal(0, 0.4, u.shape)
    >>> kept = filtered(np.cos(2 * np.pi * u) + noise, Bank((0.25, 0.55), (-0.15, 0.15)), 0.15)
    >>> error = np.angle(kept.field * np.exp(-2j * np.pi * u))[30:-30, 30:-30]
    >>> bool(np.std(error) < 0.03)
    True
    """
    plane = Plane(field, bank, periodic, threads)
    total = np.zeros(plane.shape, np.complex64)
    gain: Array = np.zeros(plane.coarse_shape, np.float32)
    windows = list(plane.windows())
    kept = 0
    for number, window in enumerate(windows):
        coefficients = plane.coefficients(window)
        strong = np.abs(coefficients) >= threshold
        kept += int(strong.sum())
        coefficients *= strong
        gain += strong
        plane.add(total, coefficients, window)
        report((number + 1) / (len(windows) + 1))
    total *= np.float32(plane.flatness * plane.scale)
    result = fft.ifft2(total, workers=plane.workers, overwrite_x=True)[: field.shape[0], : field.shape[1]]
    one = plane.flatness * plane.scale / (4 * np.pi * bank.sigma_px**2)  # q of one window, from above
    noise_gain = (one * spread(gain, plane.step_px, field.shape)).astype(np.float32)
    return Filtered(np.ascontiguousarray(result), noise_gain, kept / max(len(windows) * gain.size, 1))


def ridges(
    field: Array, bank: Bank, *, periodic: bool = False, threads: int = 0, report: Callable[[float], None] = _nothing
) -> Ridge:
    """Return the strongest window at every pixel of `field` (height, width): its height, phase and frequencies.

    The phase is corrected for the curvature c of the phase within the window, by atan(sigma^2 c) / 2 along each
    axis; local frequencies are those of the corrected phase, in radians per pixel. The amplitude of a real field is
    the modulation, less where frequencies change within the window; next to nothing is a weak ridge, whose phase
    means nothing.

    Raises
    ------
    ValueError
        a bank whose limits do not rise, or windows wider than the field.

    References
    ----------
    Kemao 2007, section 3 (ridges, and the error of a quadratic phase).

    Examples
    --------
    >>> u = np.arange(160) / 16.0 + np.zeros((120, 1))
    >>> ridge = ridges(np.cos(2 * np.pi * u), Bank((0.25, 0.55), (-0.15, 0.15)))
    >>> error = np.angle(np.exp(1j * (ridge.phase_rad - 2 * np.pi * u)))[40:-40, 40:-40]
    >>> bool(np.abs(error).max() < 0.01)
    True
    """
    plane = Plane(field, bank, periodic, threads)
    best = np.zeros(field.shape, np.float32)
    strongest = np.zeros(field.shape, np.complex64)
    windows = list(plane.windows())
    for number, window in enumerate(windows):
        spectrum = np.zeros(plane.shape, np.complex64)
        patch = plane.spectrum[window.rows[:, None], window.columns[None, :]]
        patch *= window.down[:, None]
        patch *= window.right[None, :]
        spectrum[window.rows[:, None], window.columns[None, :]] = patch
        response = fft.ifft2(spectrum, workers=plane.workers, overwrite_x=True)
        run_rows(_keep_strongest, field.shape[0], response, strongest, best, threads=threads)
        report((number + 1) / (len(windows) + 1))
    phase, along, across = _uncurved(np.angle(strongest), bank.sigma_px)
    return Ridge(np.float32(plane.scale) * np.sqrt(best), phase, along, across)


@njit(cache=True, nogil=True, error_model="numpy")
def _keep_strongest(start: int, stop: int, response: Any, strongest: Any, best: Any) -> None:
    for y in range(start, stop):
        row, kept, top = response[y], strongest[y], best[y]
        for x in range(top.size):
            power = row[x].real * row[x].real + row[x].imag * row[x].imag
            if power > top[x]:
                top[x] = power
                kept[x] = row[x]


def _uncurved(phase: Float32Array, sigma_px: float) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return the phase without its error from curvature, and the local frequencies along and across."""
    frequencies: list[Float32Array] = []
    corrected = phase.copy()
    for axis in (1, 0):
        step = np.diff(phase, axis=axis, append=phase.take([-1], axis=axis))
        step -= np.float32(2 * np.pi) * np.rint(step / np.float32(2 * np.pi))
        length = max(round(2 * sigma_px), 2)  # shorter, and the frequency's noise would outdo the correction
        frequency = ndimage.uniform_filter(ndimage.uniform_filter(step, length, mode="nearest"), length, mode="nearest")
        curvature = np.gradient(frequency, axis=axis) if phase.shape[axis] > 1 else np.zeros_like(phase)
        corrected -= (0.5 * np.arctan(sigma_px**2 * curvature)).astype(np.float32)
        frequencies.append(np.asarray(frequency, np.float32))
    return corrected, frequencies[0], frequencies[1]
