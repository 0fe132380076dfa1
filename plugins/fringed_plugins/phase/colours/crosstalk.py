"""What each camera channel sees of each projector colour, measured on uniform red, green, blue and white.

Owns the robust estimate of the 3 x 3 matrix, the black levels, and what is told about both. Takes plain arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float64Array = npt.NDArray[np.float64]

MOST_CONDITION = 15.0
MIN_LIT = 0.01
_MIN_LIGHT = 0.05  # of full scale: what the sum of the primaries must add
_OUTLIER_SIGMAS = 4.0
_FEWEST = 20


@dataclass(frozen=True)
class Crosstalk:
    """Camera channels (rows) by projector channels (columns), and how well that is known.

    `matrix` (3, 3) has a mean row sum of 1; rows that differ are gains of the camera's channels, or a coloured
    target. `sigma` (3, 3) is the standard error, `spread` (3, 3) the standard deviation over the field
    of view, noise included. `black_dn` (3,) is what each channel shows of black. `additivity` is white minus the
    sum of red, green and blue, as a part of white: zero for a projector that mixes colours by adding them. `condition`
    is how much unmixing can amplify noise.
    """

    matrix: Float64Array
    sigma: Float64Array
    spread: Float64Array
    black_dn: Float64Array
    additivity: float
    condition: float
    lit: float


def measure_crosstalk(bars: Array, full_scale_dn: float) -> Crosstalk:
    """Return the crosstalk from `bars` (5, 3, height, width): black, red, green, blue, white in channels R, G, B.

    Each pixel gives a matrix, divided by its mean light, so that the target's brightness does not matter as long as
    it is grey; of these the mean is taken, weighted by the light, without outliers. Pixels that are saturated or dark
    are left out.

    Raises
    ------
    ValueError
        next to no pixel with enough light, or channels that cannot be told apart.

    References
    ----------
    Caspi, Kiryati & Shamir 1998.

    Examples
    --------
    >>> mix = np.array([[0.9, 0.08, 0.02], [0.07, 0.85, 0.08], [0.01, 0.09, 0.9]])
    >>> light = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
    >>> bars = 2 + 180 * (light @ mix.T)[:, :, None, None] * np.ones((6, 8))
    >>> bool(np.allclose(measure_crosstalk(bars, 255.0).matrix, mix))
    True
    """
    if bars.ndim != 4 or bars.shape[:2] != (5, 3):
        raise ValueError(f"bars have shape {bars.shape}; expected (5, 3, height, width)")
    step = max(1, int(np.sqrt(bars.shape[2] * bars.shape[3] / 200_000)))
    seen = bars[:, :, ::step, ::step].reshape(5, 3, -1).astype(np.float64)
    light = seen[1:4] - seen[0]  # (projector, camera, pixels)
    total = light.sum(axis=(0, 1)) / 3
    lit = (seen.max(axis=(0, 1)) < full_scale_dn) & (total > _MIN_LIGHT * full_scale_dn)
    share = float(lit.mean())
    if share < MIN_LIT or lit.sum() < _FEWEST:
        saturated = float((seen.max(axis=(0, 1)) >= full_scale_dn).mean())
        raise ValueError(
            f"{share:.1%} of the pixels are lit and not saturated ({saturated:.1%} are saturated); at least "
            f"{MIN_LIT:.0%} are needed: change the exposure, and fill the view with a grey surface"
        )
    light, total = light[:, :, lit], total[lit]
    ratio = light / total
    middle = np.median(ratio, axis=2, keepdims=True)
    scatter = np.median(np.abs(ratio - middle), axis=2, keepdims=True) / 0.6745
    inside = (np.abs(ratio - middle) <= _OUTLIER_SIGMAS * scatter + 1e-9).all(axis=(0, 1))
    matrix = light[:, :, inside].sum(axis=2) / total[inside].sum()
    matrix = matrix.T * (3 / matrix.sum())
    spread = scatter[:, :, 0].T
    white = seen[4][:, lit][:, inside] - seen[0][:, lit][:, inside]
    missing = white - light[:, :, inside].sum(axis=0)
    return Crosstalk(
        matrix=matrix,
        sigma=spread / np.sqrt(inside.sum()),
        spread=spread,
        black_dn=seen[0][:, lit].mean(axis=1),
        additivity=float(missing.sum() / white.sum()),
        condition=checked_condition(matrix),
        lit=share,
    )


def checked_condition(matrix: Array) -> float:
    """Return the condition number of a crosstalk matrix.

    Raises
    ------
    ValueError
        numbers that are not finite, or channels that cannot be told apart.
    """
    values = np.asarray(matrix, np.float64)
    condition = float(np.linalg.cond(values)) if np.isfinite(values).all() else float("inf")
    if condition > MOST_CONDITION:
        raise ValueError(
            "the camera's channels cannot be told apart: the crosstalk matrix has a condition number of "
            f"{condition:.3g}, at most {MOST_CONDITION:g} is allowed; is this a colour camera, and does the projector "
            "show red, green and blue?"
        )
    return condition
