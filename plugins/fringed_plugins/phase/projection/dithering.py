"""Few levels for many: whole levels vary from pixel to pixel so that the mean light around follows the wanted one.

Owns error diffusion and ordered dithering over the levels that a projector has; knows neither fringes nor files.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Float64Array = npt.NDArray[np.float64]
UInt8Array = npt.NDArray[np.uint8]
# 1/p and 1/p^2 with p^3 = p + 1: multiples of these fill the unit interval most evenly in two directions.
_MARGIN_PX = 16
_PLASTIC = (0.7548776662466927, 0.5698402909980532)


@njit(cache=True, nogil=True, error_model="numpy")
def _diffuse(wanted: Any, light: Any, out: Any) -> None:
    """Write the index of a level for each pixel, its error handed to the neighbours that come later."""
    height, width = wanted.shape
    last = len(light) - 1
    here = np.zeros(width + 2)
    below = np.zeros(width + 2)
    for v in range(height):
        step = 1 if v % 2 == 0 else -1
        u = 0 if step > 0 else width - 1
        for _ in range(width):
            value = wanted[v, u] + here[u + 1]
            low, high = 0, last
            while high - low > 1:
                middle = (low + high) // 2
                if light[middle] <= value:
                    low = middle
                else:
                    high = middle
            chosen = high if light[high] - value < value - light[low] else low
            out[v, u] = chosen
            sixteenth = (value - light[chosen]) / 16
            here[u + 1 + step] += 7 * sixteenth
            below[u + 1 - step] += 3 * sixteenth
            below[u + 1] += 5 * sixteenth
            below[u + 1 + step] += sixteenth
            u += step
        here, below = below, here
        below[:] = 0.0


def diffuse(wanted: Float64Array, light: Float64Array) -> UInt8Array:
    """Return for each pixel the index of a level, by error diffusion.

    Rows run to and fro, so that the dots form no slanted worms. Of Floyd & Steinberg's, Jarvis', Stucki's and
    Sierra's weights the first, narrowest ones follow fringes of 16 to 64 px best once they are blurred.

    Parameters
    ----------
    wanted
        (height, width), the light of each pixel, within the range of `light`.
    light
        (n,), n from 2 to 256, the light of each level, rising.

    Returns
    -------
    (height, width) uint8 indices into `light`.

    References
    ----------
    Floyd & Steinberg 1976; Ulichney 1988 (to and fro); Wang & Zhang 2012 (for defocused fringes).

    Examples
    --------
    >>> dots = diffuse(np.full((64, 64), 0.25), np.array([0.0, 1.0]))
    >>> round(float(dots.mean()), 2)
    0.25
    """
    # Errors that leave at a border are lost there, and the first rows have none to start with: begin outside.
    wide = np.pad(np.asarray(wanted, np.float64), ((_MARGIN_PX, 0), (_MARGIN_PX, _MARGIN_PX)), mode="symmetric")
    out = np.empty(wide.shape, np.uint8)
    _diffuse(wide, np.ascontiguousarray(light, np.float64), out)
    return np.ascontiguousarray(out[_MARGIN_PX:, _MARGIN_PX:-_MARGIN_PX])


def ordered(wanted: Float64Array, light: Float64Array) -> UInt8Array:
    """Return for each pixel the index of a level, by thresholds that no fringe repeats; arguments as `diffuse`.

    Each pixel stands by itself. The thresholds are multiples of two irrational numbers along rows and columns: unlike
    those of a small matrix they do not beat with the fringes, and each column sees all of them.

    References
    ----------
    Bayer 1973 (ordered dithering); Roberts 2018 (the sequence).

    Examples
    --------
    >>> dots = ordered(np.full((64, 64), 0.25), np.array([0.0, 1.0]))
    >>> round(float(dots.mean()), 2)
    0.25
    """
    below = np.clip(np.searchsorted(light, wanted, side="right") - 1, 0, len(light) - 2)
    gap = light[below + 1] - light[below]
    share = np.where(gap > 0, (wanted - light[below]) / np.where(gap > 0, gap, 1.0), 0.0)
    v, u = (np.arange(n, dtype=np.float64) for n in wanted.shape)
    threshold = np.mod(_PLASTIC[0] * u[None, :] + _PLASTIC[1] * v[:, None] + 0.5, 1.0)
    return np.asarray(below + (share > threshold), np.uint8)
