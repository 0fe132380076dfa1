"""How bent the light of a set of fringes is, seen in what least squares leave of it.

Owns the guess of the projector's gamma from a few pixels of the frames, for thresholds; what measures a tone curve, or
corrects a phase, is in `nonlinear`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.projection.profiles import profile
from fringed_plugins.phase.shifts import Group, transform

_PLACES = 1024
_LIT = 0.3  # of the strong pixels' modulation
_STEP = 0.1  # guesses are rounded up to multiples: plans are made once for each


def gamma_of(frames: npt.NDArray[Any], groups: Sequence[Group], most: float = 2.6) -> float:
    """Return the gamma whose harmonics explain the residual of most lit pixels, 1 to `most`.

    The coarsest group of more than three frames is asked, whose harmonics blur has left; a group of three fits
    anything, so that a set of nothing else gives `most`. What moves in less than half of the picture changes little.

    Parameters
    ----------
    frames
        (n, height, width), the groups' frames in their places.
    groups
        coarse to fine.

    Examples
    --------
    >>> steps = np.arange(5)[:, None, None] * 2 * np.pi / 5
    >>> bent = 200 * ((1 + np.cos(np.arange(90.0)[None, None] + steps)) / 2) ** 1.75
    >>> gamma_of(bent, [Group((0, 1, 2, 3, 4), tuple(steps.ravel()), 2 * np.pi)])
    1.8
    """
    group = next((group for group in groups if len(group.frames) > 3), None)
    if group is None or most <= 1:
        return most
    height, width = frames.shape[1:]
    skip = max(int(np.sqrt(height * width / _PLACES)), 1)
    samples = np.stack([np.asarray(frames[i, ::skip, ::skip], np.float32).ravel() for i in group.frames])
    samples = samples[:, np.isfinite(samples).all(axis=0)]
    gammas, medians, matrix = _table(group.style, group.shifts_rad, group.period_px, most)
    fitted = matrix @ samples
    light2 = fitted[1] ** 2 + fitted[2] ** 2
    lit = light2 > _LIT**2 * np.percentile(light2, 95) if light2.size else np.zeros(0, bool)
    if not lit.any():
        return most
    seen = float(np.median((fitted[3:, lit] ** 2).sum(axis=0) / light2[lit]))
    return float(gammas[min(int(np.searchsorted(medians, seen)), len(gammas) - 1)])


@lru_cache(maxsize=32)
def _table(
    style: str, shifts_rad: tuple[float, ...], period_px: float, most: float
) -> tuple[tuple[float, ...], tuple[float, ...], npt.NDArray[np.float32]]:
    """Return gammas, of each the median over all phases of squared residual over squared modulation, and the fit."""
    phase = 2 * np.pi * (np.arange(360) + 0.5) / 360
    light = np.asarray(profile(style, phase + np.asarray(shifts_rad)[:, None], period_px))
    matrix = transform(shifts_rad)
    gammas = [*np.arange(1.0, most - 1e-6, _STEP), most]
    fits = [matrix @ light**gamma for gamma in gammas]
    medians = [float(np.median((f[3:] ** 2).sum(axis=0) / (f[1] ** 2 + f[2] ** 2))) for f in fits]
    return tuple(round(float(g), 3) for g in gammas), tuple(np.maximum.accumulate(medians)), matrix.astype(np.float32)
