"""How blurred the fringes are at every pixel, from the modulations of two frequencies.

Owns the indicator; knows nothing of what it is good for. The surface's colour and the camera are in both modulations
and cancel; blur takes more of the fine one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Complex64Array = npt.NDArray[np.complex64]

WINDOW_PX = 15
_RIPPLES = 4
_MOST_PIXELS = 60_000


def blur_indicator(
    fine: tuple[Complex64Array, int], coarse: tuple[Complex64Array, int], valid: npt.NDArray[np.bool_]
) -> Float32Array:
    """Return the logarithm of fine over coarse modulation (height, width), averaged over 15 x 15 `valid` pixels.

    Each frequency is its vector, modulation exp(i wrapped phase), and its number of steps N. Harmonics that N steps do
    not see apart leave ripples in a modulation, even and of period 2 pi / N in its own wrapped phase: they are fitted
    over the whole view and taken off first. 0 where no pixel near is valid.
    """
    from scipy.ndimage import uniform_filter

    good = valid & (np.abs(fine[0]) > 0) & (np.abs(coarse[0]) > 0)
    ratio = np.zeros(valid.shape, np.float32)
    ratio[good] = np.log(np.abs(fine[0][good]) / np.abs(coarse[0][good]))
    phases = [(np.angle(vector[good]), steps) for vector, steps in (fine, coarse)]
    ratio[good] -= _ripple(phases, ratio[good])
    weight = uniform_filter(good.astype(np.float32), WINDOW_PX, mode="constant")
    total = uniform_filter(ratio, WINDOW_PX, mode="constant")
    return np.asarray(np.where(weight > 1e-4, total / np.maximum(weight, np.float32(1e-4)), 0.0), np.float32)


def _ripple(phases: list[tuple[Float32Array, int]], ratio: Float32Array) -> Float32Array:
    """Return the part of the logarithm that repeats with N times either phase."""
    if len(ratio) < 4 * _RIPPLES:
        return np.zeros_like(ratio)
    chosen = slice(None, None, -(-len(ratio) // _MOST_PIXELS))
    waves = [np.cos(k * steps * phase) for phase, steps in phases for k in range(1, _RIPPLES + 1)]
    columns = np.stack([wave[chosen] for wave in (*waves, np.ones_like(ratio))], axis=1).astype(np.float64)
    solution = np.linalg.lstsq(columns, ratio[chosen].astype(np.float64), rcond=1e-6)[0].astype(np.float32)
    found = np.zeros_like(ratio)
    for amplitude, wave in zip(solution[:-1], waves, strict=True):
        found += amplitude * wave
    return found
