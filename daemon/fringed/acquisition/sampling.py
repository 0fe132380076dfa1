"""What the checks look at: a coarse grid of every frame, and what the sensor's noise predicts for it.

Owns the sub-sampling and the noise model; arrays in, arrays out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fringed.data import Array, CameraSettings, Float32Array

BANDS = 16
# Of a camera that does not tell its noise [A]: full well 13,000 e- over the scale, 12 e- read noise.
ASSUMED_FULL_WELL_ELECTRONS = 13_000.0
ASSUMED_READ_NOISE_ELECTRONS = 12.0


@dataclass(frozen=True)
class Noise:
    """Variance of one pixel, in grey levels squared: `shot * value + floor`."""

    shot: float
    floor: float

    def variance(self, value: Float32Array) -> Float32Array:
        """Return the variance at grey level `value`, same shape."""
        return np.maximum(value, np.float32(0)) * np.float32(self.shot) + np.float32(self.floor)


def full_scale(settings: CameraSettings, dtype: np.dtype[np.generic]) -> float:
    """Return the highest grey level of frames of `dtype`."""
    bits = settings.bits if dtype == np.uint16 and settings.bits > 8 else 8 * dtype.itemsize
    return float(2**bits - 1)


def noise_of(settings: CameraSettings, top: float) -> Noise:
    """Return the noise that `settings` describe (shot, read, quantisation); the assumed one where they do not."""
    electrons_per_dn = settings.electrons_per_dn or ASSUMED_FULL_WELL_ELECTRONS / top
    read = settings.read_noise_electrons if settings.electrons_per_dn else ASSUMED_READ_NOISE_ELECTRONS
    return Noise(1.0 / electrons_per_dn, (read / electrons_per_dn) ** 2 + 1.0 / 12.0)


def sample(image: Array, step_px: int) -> Float32Array:
    """Return every `step_px`-th pixel of `(h, w)` as `(h', w')` float32, starting half a step in."""
    first = min(step_px // 2, image.shape[0] - 1, image.shape[1] - 1)
    return image[first::step_px, first::step_px].astype(np.float32)


def grid_step(shape: tuple[int, ...], wanted_px: int) -> int:
    """Return the step that leaves a small sensor `(h, w)` enough pixels to judge by: at most `wanted_px`."""
    return max(1, min(wanted_px, round(math.sqrt(shape[0] * shape[1] / 40_000))))


def band_edges(rows: int) -> Array:
    """Return the first row of each horizontal band."""
    count = min(BANDS, rows)
    return np.arange(count) * rows // count


def per_band(values: Float32Array, rows: int) -> Array:
    """Sum `(..., rows * columns)` over each band: `(..., bands)`."""
    by_row = values.reshape(*values.shape[:-1], rows, -1).sum(axis=-1, dtype=np.float32)
    return np.add.reduceat(by_row.astype(np.float64), band_edges(rows), axis=-1)
