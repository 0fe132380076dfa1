"""What is left to judge a group by that always fits, such as three frames: its siblings' background, its neighbours.

Owns the comparison of groups and of consecutive frames; arrays in, arrays out.
"""

from __future__ import annotations

import numpy as np

from fringed.acquisition.sampling import Noise, per_band
from fringed.acquisition.sinusoids import MIN_PIXELS, NOISE_MARGIN, GroupFit, Misfit, relative_misfit
from fringed.data import Array, Float32Array, PatternSequence

SAME = 0.1  # the share of the expected difference below which two pictures are the same
LIT = 8.0 / 255.0  # of full scale
LAMP = 0.01  # what the lamp may change by
MIN_FRINGES = 4.0  # across the panel, below which a small object may well look the same twice


def background_error(fit: GroupFit, others: list[GroupFit]) -> tuple[Float32Array, float]:
    """Return the background minus its siblings', as the error of one of its frames, and its noise's inflation."""
    family = others if len(others) == 1 else [fit, *others]  # of three or more, the median outvotes a wrong one
    reference = np.median(np.stack([member.mean for member in family]), axis=0).astype(np.float32)
    steps = len(fit.indices)
    return (fit.mean - reference) * np.float32(steps), steps * (1.0 + steps / len(others[0].indices))


def background_misfit(fit: GroupFit, others: list[GroupFit], error: Float32Array, inflation: float) -> Misfit:
    """Return how far the group's background is from its siblings', band by band."""
    valid = fit.valid * np.prod([other.valid for other in others], axis=0, dtype=np.float32)
    energy = per_band(error * error * valid, fit.rows)[None, :]
    return relative_misfit(energy, fit, valid, np.array([[inflation]]))


def background_fringes(fit: GroupFit) -> float:
    """Return the amplitude of the group's own fringes in its background, as the error of one of its frames.

    The background knows nothing of the fringes when every frame is right. Means nothing unless many
    fringes cross the object.
    """
    keep = fit.valid > 0
    if keep.sum() < MIN_PIXELS:
        return 0.0
    mean, cosine, sine = (a[keep].astype(np.float64) for a in (fit.mean, fit.cosine, fit.sine))
    columns = np.stack([np.ones_like(mean), np.hypot(cosine, sine), cosine, sine], axis=1)
    solution = np.linalg.lstsq(columns, mean, rcond=None)[0]
    return float(len(fit.indices) * np.hypot(solution[2], solution[3]) / 2**0.5)


class Repeats:
    """Find frames that are equal to the last bit although their patterns differ: noise never repeats.

    Frames without any structure (black, or saturated) say nothing.
    """

    def __init__(self, sequence: PatternSequence) -> None:
        self._sequence = sequence
        self._prints: dict[int, float] = {}
        self._key = np.zeros(0, np.float32)

    def find(self, grid: Float32Array, index: int) -> int | None:
        """Return the frame before `index` that frame `index` repeats; call it in the frames' order."""
        flat = grid.reshape(len(grid), -1)
        if len(self._key) != flat.shape[1]:
            self._key = np.cos(np.arange(flat.shape[1], dtype=np.float32))
        mark = self._prints[index] = float(flat[index] @ self._key)
        for earlier in range(index - 1, -1, -1):
            if abs(self._prints.get(earlier, np.inf) - mark) > 1e-4 * abs(mark) + 1e-3:
                continue
            if _same_pattern(self._sequence, earlier, index) or not np.array_equal(flat[earlier], flat[index]):
                continue
            if np.ptp(flat[index]) > 0:
                return earlier
        return None


def _same_pattern(sequence: PatternSequence, one: int, other: int) -> bool:
    a, b = sequence.patterns[one], sequence.patterns[other]
    if sequence.frames[one].channel != sequence.frames[other].channel:
        return False
    shape = np.broadcast_shapes(a.shape, b.shape)
    return bool(np.array_equal(np.broadcast_to(a, shape), np.broadcast_to(b, shape)))


def same_pictures(grid: Float32Array, pair: tuple[int, int], fit: GroupFit, expected: float, noise: Noise) -> Array:
    """Return for each band 1 where the two frames of `pair` show the same, 0 where not, NaN where untold.

    `expected` is the mean squared difference of the two patterns over the squared modulation.
    """
    one, other = grid[pair[0]].ravel(), grid[pair[1]].ravel()
    variance = (noise.variance(one) + noise.variance(other)) * fit.valid
    energy = per_band((one - other) ** 2 * fit.valid, fit.rows) - per_band(variance, fit.rows)
    signal = per_band(fit.power * fit.valid, fit.rows) * expected
    told = (per_band(fit.valid, fit.rows) >= MIN_PIXELS) & (signal > 4 * per_band(variance, fit.rows))
    return np.where(told, energy < SAME * np.maximum(signal, 1e-9), np.nan)


def are_one_picture(pair: Float32Array, noise: Noise, top: float) -> bool:
    """Return whether two frames (2, rows, columns) that are lit differ by noise, and a hundredth of the light, only."""
    one, other = pair.reshape(2, -1)
    lit = (pair.max(axis=0).ravel() > LIT * top) & (pair.max(axis=0).ravel() < top)
    if lit.sum() < MIN_PIXELS:
        return False
    energy = float(((one - other)[lit] ** 2).mean())
    mean = (one + other)[lit] / 2
    return energy < 2 * NOISE_MARGIN * float(noise.variance(mean).mean()) + float(((LAMP * mean) ** 2).mean())


def unequal_light(grid: Float32Array, indices: tuple[int, ...], top: float) -> tuple[int, float]:
    """Return the frame whose light differs most from the median of its group, in any band, and by what share.

    Fringes that many of cross the object have the same mean light, however they are shifted.
    """
    frames = grid[list(indices)].reshape(len(indices), -1)
    lit = ((frames.max(axis=0) > LIT * top) & (frames.max(axis=0) < top)).astype(np.float32)
    told = per_band(lit, grid.shape[1]) >= MIN_PIXELS
    light = per_band(frames * lit, grid.shape[1])[:, told]
    if not told.any():
        return indices[0], 0.0
    brightest = np.maximum(light.max(axis=0), 1e-9)
    away = (np.abs(light - np.median(light, axis=0)) if len(indices) > 2 else brightest - light) / brightest
    worst = int(np.argmax(away.max(axis=1)))
    return indices[worst], float(away[worst].max())


def fringes_across(sequence: PatternSequence, index: int) -> float:
    """Return how many fringes of frame `index` cross the panel."""
    frame = sequence.frames[index]
    extent = sequence.width_px if frame.orientation == "columns" else sequence.height_px
    return extent / frame.period_px if frame.period_px > 0 else 0.0
