"""A bank of Gaussian windows in the frequency plane, for windowed Fourier analysis.

Owns the windows' frequencies, and what one of them takes from a field's spectrum and gives back. Knows no contract.

A Gaussian window of sigma s has the spectrum exp(-s^2 (w - w_k)^2 / 2), so its coefficients vary no faster than
that: they are computed on a grid that is just fine enough for `_REACH / s`, some sixty times fewer numbers than pixels
at a window of 10 px, and the filtered field is put together in the frequency plane.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage

from fringed_plugins.parallel import thread_count

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
Complex64Array = npt.NDArray[np.complex64]

_REACH = 5.0  # standard deviations of a window's spectrum: 4e-6 of its height is left there
_MARGIN_SIGMAS = 3.0


@dataclass(frozen=True)
class Bank:
    """Gaussian windows of `sigma_px`, with local frequencies in radians per pixel between limits, as (low, high).

    `along` runs along the second axis, `across` along the first. Neighbours are 1 / sigma apart: the sum of
    the squared windows is then flat within 1e-4.
    """

    along: tuple[float, float]
    across: tuple[float, float]
    sigma_px: float = 10.0

    def frequencies(self) -> list[tuple[float, float]]:
        """Return (across, along) of every window, in radians per pixel.

        Raises
        ------
        ValueError
            a window of less than two pixels, or limits that do not rise or reach Nyquist.
        """
        if not 2 <= self.sigma_px <= 200:
            raise ValueError(f"a window of {self.sigma_px:g} px; 2 to 200 are allowed, 10 is a good start")
        rows, columns = (_steps(limits, self.sigma_px) for limits in (self.across, self.along))
        return [(row, column) for row in rows for column in columns]


def _steps(limits: tuple[float, float], sigma_px: float) -> Array:
    low, high = limits
    if not (-np.pi < low <= high < np.pi):
        raise ValueError(f"local frequencies from {low:.3g} to {high:.3g} rad/px; they must rise within -pi to pi")
    count = max(int(np.ceil((high - low) * sigma_px)), 0) + 1
    middle = (low + high) / 2
    return middle + (np.arange(count) - (count - 1) / 2) / sigma_px


def noise_of_coefficients(sigma: float, sigma_px: float, *, is_complex: bool) -> float:
    """Return the standard deviation of a coefficient for white noise of deviation `sigma` in each value.

    `is_complex` fields have that deviation in each of both parts.
    """
    energy = 1 / (4 * np.pi * sigma_px**2)  # of the window of unit area
    return float(sigma * np.sqrt(energy * (2 if is_complex else 1)))


class Window(NamedTuple):
    """One window in the frequency plane: its rows and columns there, and its height along both."""

    rows: Array
    columns: Array
    down: Float32Array
    right: Float32Array
    across: float
    along: float


class Plane:
    """The spectrum of a field, and what one window at a time takes from it."""

    def __init__(self, field: Array, bank: Bank, periodic: bool, threads: int) -> None:
        height, width = field.shape
        if min(height, width) < 2 * bank.sigma_px:
            raise ValueError(
                f"windows of {bank.sigma_px:g} px in a picture of {height} x {width}; they must fit twice: use at most "
                f"{min(height, width) / 2:g} px"
            )
        self.workers = thread_count(threads)
        self.bank = bank
        margin = int(_MARGIN_SIGMAS * bank.sigma_px)
        grown = fft.next_fast_len(height + margin), fft.next_fast_len(width + margin)
        self.shape = (height, width) if periodic else grown
        canvas = np.zeros(self.shape, np.complex64 if np.iscomplexobj(field) else np.float32)
        canvas[:height, :width] = field
        # One of two conjugate halves carries a real field's signal; the other half of its modulation is added here.
        self.scale = 1.0 if np.iscomplexobj(field) else 2.0
        self.spectrum = fft.fft2(canvas, workers=self.workers).astype(np.complex64, copy=False)
        bins = [min(n, int(2 * np.ceil(_REACH / bank.sigma_px * n / (2 * np.pi))) + 1) for n in self.shape]
        self.coarse_shape = fft.next_fast_len(bins[0]), fft.next_fast_len(bins[1])
        self.coarse_shape = min(self.coarse_shape[0], self.shape[0]), min(self.coarse_shape[1], self.shape[1])
        self.step_px = self.shape[0] / self.coarse_shape[0], self.shape[1] / self.coarse_shape[1]
        # The squared windows, 1 / sigma apart, add up to pi everywhere within the bank.
        self.flatness = 1 / np.pi

    def windows(self) -> Iterator[Window]:
        """Yield every window of the bank."""
        for across, along in self.bank.frequencies():
            rows, down = self._axis(across, 0)
            columns, right = self._axis(along, 1)
            yield Window(rows, columns, down, right, across, along)

    def _axis(self, frequency: float, axis: int) -> tuple[Array, Float32Array]:
        """Return the bins around a frequency, and the window's height there."""
        length, count = self.shape[axis], self.coarse_shape[axis]
        first = round(frequency / (2 * np.pi) * length) - count // 2
        bins = first + np.arange(count)
        off = 2 * np.pi * bins / length - frequency
        return bins % length, np.exp(-0.5 * (self.bank.sigma_px * off) ** 2).astype(np.float32)

    def coefficients(self, window: Window) -> Complex64Array:
        """Return the window's coefficients on the coarse grid, turned back by its first bin."""
        patch = self.spectrum[window.rows[:, None], window.columns[None, :]]
        patch *= window.down[:, None]
        patch *= window.right[None, :]
        factor = np.float32(np.prod(self.coarse_shape) / np.prod(self.shape))
        found: Complex64Array = fft.ifft2(patch, workers=self.workers, overwrite_x=True) * factor
        return found

    def add(self, total: Complex64Array, coefficients: Complex64Array, window: Window) -> None:
        """Add the window's part, from its coefficients, to the spectrum `total`."""
        patch = fft.fft2(coefficients, workers=self.workers, overwrite_x=True)
        patch *= window.down[:, None]
        patch *= window.right[None, :]
        patch *= np.float32(np.prod(self.shape) / np.prod(self.coarse_shape))
        total[window.rows[:, None], window.columns[None, :]] += patch


def spread(coarse: Array, step_px: tuple[float, float], shape: tuple[int, ...]) -> Array:
    """Return the coarse grid's values at each pixel of `shape`: those of the nearest place."""
    rows, columns = (
        np.minimum(np.rint(np.arange(n) / step).astype(int), size - 1)
        for n, step, size in zip(shape, step_px, coarse.shape, strict=True)
    )
    spread: Array = coarse[rows[:, None], columns[None, :]]
    return spread


def bank_of(field: Complex64Array, sigma_px: float) -> Bank:
    """Return the bank that holds nearly all local frequencies of a complex `field`, zero where nothing is known.

    Frequencies are taken from the phase steps between neighbours, averaged as phasors over the window.

    Raises
    ------
    ValueError
        a field without any two neighbours.
    """
    limits = []
    for axis in (1, 0):
        product = field * np.conj(np.roll(field, 1, axis=axis))
        size = max(round(2 * sigma_px), 2)
        mean = ndimage.uniform_filter(product.real, size) + 1j * ndimage.uniform_filter(product.imag, size)
        strong = np.abs(mean) > 0.25 * np.abs(mean).max()
        if not strong.any() or not np.abs(mean).max() > 0:
            raise ValueError("no two neighbours with a phase; nothing can be filtered")
        low, high = np.quantile(np.angle(mean[strong]), (0.002, 0.998))
        limits.append((max(float(low) - 1 / sigma_px, -3.0), min(float(high) + 1 / sigma_px, 3.0)))
    return Bank(limits[0], limits[1], sigma_px)
