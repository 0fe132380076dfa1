"""Three patterns in one exposure: unmixed colours, their balance on coloured surfaces, and their phase.

Owns the choice of gains and the order of the steps; the loops are in `colour_kernel`. Takes plain arrays.

A surface that reflects red, green and blue by parts r_j turns projector light p into camera channels X (r p), X being
the crosstalk (`crosstalk`). X^-1 gives r p; three phase steps in three colours are right only where the
r_j are equal, or are divided out: from a white frame at each pixel, from means over a period of the fringes, or as one
number for each channel of the whole picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from fringed_plugins.parallel import run_rows
from fringed_plugins.phase.colours import colour_kernel
from fringed_plugins.phase.colours.crosstalk import checked_condition
from fringed_plugins.phase.decoded import Decoded, Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import transform
from fringed_plugins.phase.single_frame.bands import find_carrier, local_mean

Array = npt.NDArray[Any]
Float32Array = npt.NDArray[np.float32]
Balance = Literal["none", "global", "local", "white"]


@dataclass(frozen=True)
class Colours:
    """How camera channels see projector channels: `crosstalk` (3, 3) and the black levels (3,) in grey levels."""

    crosstalk: Array
    black_dn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def inverse(self) -> Float32Array:
        """Return the unmixing matrix.

        Raises
        ------
        ValueError
            channels that cannot be told apart.
        """
        checked_condition(self.crosstalk)
        return np.linalg.inv(np.asarray(self.crosstalk, np.float64)).astype(np.float32)


def unmix(frames: Array, colours: Colours, threads: int = 0) -> Float32Array:
    """Return the projector's channels (3, height, width) float32 of camera channels (3, height, width).

    The black level is taken off. Noise of variance s_c^2 in the camera's channels becomes
    sum_c inverse_jc^2 s_c^2 in channel j (`noise_of_unmixed`), and is shared between channels.

    Raises
    ------
    ValueError
        channels that cannot be told apart, or not three of them.

    References
    ----------
    Caspi, Kiryati & Shamir 1998.

    Examples
    --------
    >>> colours = Colours(np.array([[0.9, 0.1, 0.0], [0.1, 0.8, 0.1], [0.0, 0.1, 0.9]]))
    >>> unmix(np.array([90, 10, 0], np.uint8).reshape(3, 1, 1), colours).round(3).ravel() + 0
    array([100.,   0.,   0.], dtype=float32)
    """
    if frames.ndim != 3 or len(frames) != 3:
        raise ValueError(f"channels have shape {frames.shape}; expected (3, height, width)")
    stack = _readable(frames)
    out = np.empty(stack.shape, np.float32)
    run_rows(colour_kernel.unmix_rows, stack.shape[1], stack, _mixing(colours), out, threads=threads)
    return out


def noise_of_unmixed(colours: Colours, noise: NoiseModel) -> tuple[NoiseModel, ...]:
    """Return a noise model for each unmixed channel, right where the camera's channels are equally bright."""
    gains = (colours.inverse().astype(np.float64) ** 2).sum(axis=1)
    return tuple(NoiseModel(float(g * noise.constant_dn2), float(g * noise.slope_dn)) for g in gains)


def three_steps(
    frames: Array,
    shifts_rad: Sequence[float],
    colours: Colours,
    noise: NoiseModel,
    thresholds: Thresholds,
    *,
    gains: Float32Array | None = None,
    white: Array | None = None,
    threads: int = 0,
) -> Decoded:
    """Return the wrapped phase of three steps in the camera's channels `frames` (3, height, width).

    `gains` (3, height, width) are what each unmixed channel is divided by, None for 1 (see `balance`); `white` is the
    raw white frame (3, height, width) they come from, if one was taken, whose noise is counted. `sigma_rad` follows
    the noise of each camera channel through unmixing, gains and arctangent.

    Raises
    ------
    ValueError
        channels that cannot be told apart, or shifts that determine no phase.

    References
    ----------
    Huang, Hu, Jin & Chiang 1999; Caspi, Kiryati & Shamir 1998.
    """
    stack = _readable(frames)
    shape = stack.shape[1:]
    unmixed = unmix(stack, colours, threads)
    fit = np.ascontiguousarray(transform(shifts_rad)[1:3], np.float32)
    mixing = _mixing(colours, noise, thresholds, fit)
    even = np.ones(unmixed.shape, np.float32) if gains is None else np.ascontiguousarray(gains, np.float32)
    light = _readable(np.zeros((3, 0, shape[1]), stack.dtype) if white is None else white)
    level = unmix(light, colours, threads).mean(axis=0) if white is not None else np.zeros((0, 0), np.float32)
    out = Decoded(
        phase_rad=np.empty(shape, np.float32),
        sigma_rad=np.empty(shape, np.float32),
        modulation=np.empty(shape, np.float32),
        background=np.empty(shape, np.float32),
        wrapped_rad=np.empty((0, 0), np.float32),
        rejected=np.empty(shape, np.uint16),
    )
    maps = (out.phase_rad, out.sigma_rad, out.modulation, out.background, out.rejected)
    fields = (stack, unmixed, even, light, level)
    run_rows(colour_kernel.phase_rows, shape[0], fields, mixing, maps, threads=threads)
    return out


def balance(
    unmixed: Float32Array, method: Balance, *, white: Float32Array | None = None, period_px: float = 0.0
) -> Float32Array | None:
    """Return the gains (3, height, width) that make the unmixed channels of a coloured surface alike, or None.

    "white" divides by an unmixed white frame, pixel by pixel; "local" by each channel's mean over periods of
    `period_px` camera pixels around the pixel, which smooth colours allow; "global" by each channel's contrast over the
    lit part of the picture (the grey-world assumption), which a surface of one colour allows. All gains have a
    mean of 1 over the three channels, so that modulations stay in grey levels.

    Raises
    ------
    ValueError
        "white" without a white frame, "local" without a period.

    Examples
    --------
    >>> channels = np.array([2.0, 1.0, 1.0], np.float32).reshape(3, 1, 1) * np.ones((3, 4, 4), np.float32)
    >>> balance(channels, "white", white=channels)[:, 0, 0]
    array([1.5 , 0.75, 0.75], dtype=float32)
    """
    if method == "none":
        return None
    if method == "white":
        if white is None:
            raise ValueError("balance by a white frame, and the set has none: take it with white = true, or use local")
        gains = white
    elif method == "local":
        if not period_px > 0:
            raise ValueError("local balance needs the fringes' period in camera pixels")
        gains = np.stack([local_mean(channel, max(round(period_px), 2)) for channel in unmixed])
    else:
        gains = _contrasts(unmixed)[:, None, None] * np.ones_like(unmixed)
    floor = np.float32(1e-3) * np.maximum(gains.max(), np.float32(1e-6))
    gains = np.maximum(gains, floor)
    return np.asarray(gains / gains.mean(axis=0), np.float32)


def _contrasts(unmixed: Float32Array) -> Float32Array:
    """Return the standard deviation (3,) of each channel over the brighter half of the picture.

    Brightness is taken from wide surroundings: that of a single pixel goes with its phase.
    """
    light = ndimage.uniform_filter(unmixed.mean(axis=0), max(min(unmixed.shape[1:]) // 10, 1))
    lit = light >= 0.5 * np.median(light)
    return np.array([channel[lit].std() for channel in unmixed], np.float32)


def carrier_period_px(unmixed: Float32Array, expected: float) -> float:
    """Return the fringes' period in camera pixels, along the second axis; `expected` is its frequency, roughly.

    Raises
    ------
    ValueError
        no fringes stand out.
    """
    return 1 / find_carrier(unmixed[1], expected)[0]


def _readable(frames: Array) -> Array:
    """Return C-ordered native read-only uint8, uint16 or float32."""
    kind = frames.dtype.newbyteorder("=")
    stack = np.ascontiguousarray(frames, kind if kind in (np.uint8, np.uint16) else np.float32).view()
    stack.flags.writeable = False
    return stack


def _mixing(
    colours: Colours,
    noise: NoiseModel = NoiseModel(0.0, 0.0),  # noqa: B008 (frozen)
    thresholds: Thresholds = Thresholds(),  # noqa: B008 (frozen)
    fit: Float32Array | None = None,
) -> colour_kernel.Mixing:
    return colour_kernel.Mixing(
        inverse=colours.inverse(),
        black=np.asarray(colours.black_dn, np.float32),
        fit=np.zeros((2, 3), np.float32) if fit is None else fit,
        noise_constant=np.float32(noise.constant_dn2),
        noise_slope=np.float32(noise.slope_dn),
        saturation=np.float32(thresholds.saturation_dn),
        modulation=np.float32(thresholds.modulation_dn),
        modulation_snr2=np.float32(thresholds.modulation_snr**2),
    )
