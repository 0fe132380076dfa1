"""Pass-bands around a fringe carrier, and the smoothing that goes with them.

Owns windows in the frequency plane, their noise bandwidth, and the search for the carrier in a picture. The
carrier runs along the second axis: who has fringes along rows transposes first. Knows no contract.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage

from fringed_plugins.phase.single_frame.triangle_kernel import triangle_mean

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]

MIN_PERIOD_CAMERA_PX = 4.0  # shorter periods reach Nyquist with half their band
MIN_PERIODS_IN_VIEW = 6.0  # fewer cannot be told from the background's own variation
_SEARCH_ROWS = 256


@dataclass(frozen=True)
class Band:
    """An elliptical pass-band: centre and half widths in cycles per pixel, along and across the carrier.

    The window is 1 within the part `flat` of the half width and falls as a cosine to 0 at its end: a Tukey
    window, with `flat` = 0 a Hann window.
    """

    along: float
    across: float
    half_along: float
    half_across: float
    flat: float = 0.5

    @property
    def period_px(self) -> float:
        """Length of a period along the carrier, in camera pixels."""
        return 1 / self.along

    def window(self, shape: tuple[int, int]) -> Float32Array:
        """Return the window on the half plane that `scipy.fft.rfft2` of an array of `shape` gives."""
        down = (fft.fftfreq(shape[0]) - self.across) / self.half_across
        right = (fft.rfftfreq(shape[1]) - self.along) / self.half_along
        rows, columns = np.flatnonzero(np.abs(down) < 1), np.flatnonzero(np.abs(right) < 1)
        distance = np.hypot(down[rows, None], right[None, columns])
        part = np.clip((distance - self.flat) / max(1 - self.flat, 1e-6), 0, 1)
        window = np.zeros((len(down), len(right)), np.float32)
        window[np.ix_(rows, columns)] = 0.5 * (1 + np.cos(np.pi * part))
        window[:, [0, -1]] = 0.0  # neither the mean nor Nyquist has a phase
        return window


def band_around(carrier: tuple[float, float], bandwidth: float, cross_bandwidth: float, flat: float) -> Band:
    """Return the band around a carrier (along, across) in cycles per pixel; widths are parts of its frequency.

    Raises
    ------
    ValueError
        a carrier that a picture cannot hold, or a band that includes the background.

    Examples
    --------
    >>> band_around((0.0625, 0.0), 0.5, 0.5, 0.5).period_px
    16.0
    """
    along, across = carrier
    if not 0 < along <= 1 / MIN_PERIOD_CAMERA_PX:
        raise ValueError(
            f"the carrier has {1 / along if along else np.inf:.3g} camera pixels a period; single-frame methods need "
            f"at least {MIN_PERIOD_CAMERA_PX:g}: project fewer periods"
        )
    if not 0 < bandwidth <= 1 or not 0 < cross_bandwidth <= 1:
        raise ValueError(
            f"half widths of {bandwidth:g} along and {cross_bandwidth:g} across the carrier; each must be above 0 "
            "and at most 1, where the band reaches the background: use 0.6"
        )
    return Band(along, across, bandwidth * along, cross_bandwidth * along, flat)


def noise_gain(window: Float32Array, columns: int) -> float:
    """Return q of sigma_phase^2 = q sigma_frame^2 / modulation^2 for a half-plane `window` of `columns` samples.

    White noise of variance s^2 leaves s^2 mean(window^2) over the full plane in each quadrature of the filtered
    signal; the half plane counts twice. N-step least squares has q = 2/N.
    """
    return float(2 * np.sum(window.astype(np.float64) ** 2) / (window.shape[0] * columns))


def smooth(values: Float32Array, length_px: int, threads: int = 0) -> Float32Array:
    """Return `values` under a triangle of twice `length_px` along both axes, zero beyond the borders.

    A box as long as a period has no fringe left; two in a row, a triangle, leave none of its slope either.
    """
    return triangle_mean(values, length_px, threads)


def local_mean(values: Float32Array, length_px: int, share: Float32Array | None = None) -> Float32Array:
    """Return the mean of `values` over periods of `length_px`; near the second axis' ends that of the last whole one.

    `share` is what `smooth` makes of the weights that `values` were multiplied with, None for all ones.
    """
    weight = smooth(np.ones_like(values), length_px) if share is None else share
    mean = np.asarray(smooth(values, length_px) / np.maximum(weight, 1e-6), np.float32)
    inner = min(length_px, (values.shape[1] - 1) // 2)
    mean[:, :inner] = mean[:, inner : inner + 1]
    mean[:, mean.shape[1] - inner :] = mean[:, -inner - 1 : mean.shape[1] - inner]
    return mean


def find_carrier(picture: Array, expected: float, reach: float = 3.0) -> tuple[float, float]:
    """Return the carrier (along, across) in cycles per pixel: the centre of the strongest band near `expected`.

    `picture` (height, width) has fringes along its second axis; frequencies from `expected / reach` to
    `expected * reach` are searched, within 45 degrees of that axis.

    Raises
    ------
    ValueError
        a picture that shows less than six periods, or no carrier above its surroundings.

    References
    ----------
    Takeda & Mutoh 1983, section II; the centre is the centroid of the band's power.

    Examples
    --------
    >>> picture = 100 + 50 * np.cos(2 * np.pi * np.arange(256) / 16.0) + np.zeros((64, 1))
    >>> round(1 / find_carrier(picture, 1 / 12)[0], 1)
    16.0
    """
    width = picture.shape[1]
    lowest = max(expected / reach, MIN_PERIODS_IN_VIEW / width)
    highest = min(expected * reach, 0.5)
    if lowest >= highest:
        raise ValueError(
            f"about {expected * width:.3g} periods across the picture's {width} px; a single frame needs at least "
            f"{MIN_PERIODS_IN_VIEW:g}, each of {MIN_PERIOD_CAMERA_PX:g} px and more: project other periods"
        )
    down, right, power = _power(picture)
    inside = (right >= lowest) & (right <= highest) & (np.abs(down) <= right)
    # Weighting with the squared frequency keeps the background's own slope from passing for fringes.
    weighted = np.where(inside, power * right**2, 0)
    place = np.unravel_index(np.argmax(weighted), power.shape)
    peak = np.hypot(right, 0)[0, place[1]], np.asarray(down)[place[0], 0]
    near = inside & (np.hypot(right - peak[0], down - peak[1]) < 0.4 * peak[0])
    floor = float(np.median(power[inside]))
    if weighted[place] <= 0 or power[place] < 30 * floor:
        raise ValueError(
            "no fringes stand out in the picture: the strongest frequency has "
            f"{power[place] / max(floor, 1e-12):.3g} times the median power, at least 30 is needed; look at the "
            "exposure and the focus, or name the carrier's period"
        )
    total = power[near].sum()
    along = float((power * right)[near].sum() / total)
    return along, float((power * down)[near].sum() / total)


def _power(picture: Array) -> tuple[Array, Array, Array]:
    """Return frequencies down (n, 1) and right (1, m), and the power of the tapered picture, lightly smoothed."""
    step = max(1, picture.shape[0] // _SEARCH_ROWS)
    rows = picture[: picture.shape[0] // step * step].reshape(-1, step, picture.shape[1])
    image = rows.mean(axis=1, dtype=np.float32)  # fringes run down the rows, so that their mean keeps them
    height, width = image.shape
    taper = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[None, 1:-1]
    image = (image - np.float32((image * taper).sum() / taper.sum())) * taper.astype(np.float32)
    shape = fft.next_fast_len(height, real=True), fft.next_fast_len(width, real=True)
    power = np.abs(fft.rfft2(image, shape)) ** 2
    power = ndimage.uniform_filter(power, size=3, mode="nearest")
    return fft.fftfreq(shape[0], step)[:, None], fft.rfftfreq(shape[1])[None, :], power
