"""Which pairs count, and how much: Zhang's adaptive limit, normals, Tukey's weights.

Owns the statistics on pairs' distances and residuals. Knows nothing of where pairs come from.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
TUKEY = 4.685  # 95 % efficiency on normal noise
_BINS = 40


def zhang_limit(distance_mm: Array, resolution_mm: float) -> float:
    """Return the largest distance at which a pair still counts.

    Parameters
    ----------
    distance_mm
        (n,) distances of the pairs of this iteration.
    resolution_mm
        distance of neighbours in the frames, D.

    References
    ----------
    Zhang: Iterative point matching for registration of free-form curves and surfaces, IJCV 1994, as in
    the thesis, section 4.4.4: mu + 3, 2 or 1 sigma while mu < D, 3 D, 6 D, else the valley after the
    highest peak of the distances' histogram.

    Examples
    --------
    >>> round(zhang_limit(np.array([0.1, 0.2, 0.3]), 1.0), 3)
    0.445
    """
    mu, sigma = float(distance_mm.mean()), float(distance_mm.std())
    for factor, sigmas in ((1.0, 3.0), (3.0, 2.0), (6.0, 1.0)):
        if mu < factor * resolution_mm:
            return mu + sigmas * sigma
    return _valley(distance_mm)


def _valley(distance_mm: Array) -> float:
    count, edges = np.histogram(distance_mm, bins=_BINS)
    smooth = np.convolve(count, [0.25, 0.5, 0.25], mode="same")
    peak = int(smooth.argmax())
    rising = np.flatnonzero(np.diff(smooth[peak:]) > 0)
    low = smooth[peak:] <= 0.6 * smooth[peak]
    for step in rising:
        if low[step]:
            return float(edges[peak + step + 1])
    return float(edges[-1])


def mad_scale(residual_mm: Array) -> float:
    """Return the standard deviation of normal noise that has the residuals' median magnitude."""
    return 1.4826 * float(np.median(np.abs(residual_mm))) if residual_mm.size else 0.0


def tukey_weights(residual_mm: Array, scale_mm: float) -> Array:
    """Return Tukey's biweight of residuals at `scale_mm`: 1 at zero, 0 beyond 4.685 scales.

    Examples
    --------
    >>> tukey_weights(np.array([0.0, 1.0, 5.0]), 1.0).round(3)
    array([1.   , 0.911, 0.   ])
    """
    u = residual_mm / (TUKEY * scale_mm)
    weights: Array = np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0)
    return weights
