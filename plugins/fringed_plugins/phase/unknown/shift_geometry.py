"""Frames as points on a circle: the first guess of unknown shifts, and what settles sign and offset.

Owns the geometry of second moments. Without their mean, frames are n points in a plane of two fringe images; where
these are of one size and uncorrelated the points lie on a circle, at their shifts. Knows no contract.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float64Array = npt.NDArray[np.float64]

_FLAT = 0.01  # second over first principal change below which frames lie on a line
_SAME_SIGN = 0.05


class DegenerateShifts(ValueError):
    """Frames that do not tell their shifts; the text says why."""


def first_guess(moments: Float64Array, noise: float) -> Float64Array:
    """Return shifts (n,) from second moments (n, n) of frames without their mean; sign and offset are open.

    `noise` is the sum over the pixels of one frame's noise variance.

    Raises
    ------
    DegenerateShifts
        frames that are all alike, or lie on a line.

    References
    ----------
    Vargas, Quiroga & Belenguer 2011 (principal components); the circle is fitted as in Kasa 1976.

    Examples
    --------
    >>> true = np.array([0.0, 1.0, 2.5, 4.0])
    >>> model = np.stack([np.cos(true), -np.sin(true)], axis=1)
    >>> model -= model.mean(axis=0)
    >>> found = first_guess(model @ model.T, 0.0)
    >>> bool(np.allclose(np.abs(np.exp(1j * (found - found[0])).imag), np.abs(np.sin(true))))
    True
    """
    count = len(moments)
    values, vectors = np.linalg.eigh(moments)
    floor = float(values[1 : count - 2].mean()) if count > 3 else noise
    strong = values[-2:] - floor
    if strong[1] < 0.05 * max(noise, 1e-12) or not strong[1] > 0:
        raise DegenerateShifts(
            "the frames are alike but for noise: they have one shift, or no fringes; is the pattern changing?"
        )
    if strong[0] < _FLAT * strong[1]:
        raise DegenerateShifts(
            "the frames differ along one direction only: their shifts take two values, or nothing but the brightness "
            "changes; three different shifts are needed"
        )
    points = vectors[:, -2:] * np.sqrt(strong)
    design = np.concatenate([2 * points, np.ones((count, 1))], axis=1)
    centre = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=None)[0][:2]
    off = points - centre
    return np.asarray(np.arctan2(off[:, 1], off[:, 0]), np.float64)


def aligned(shifts: Float64Array, asked: Float64Array) -> Float64Array:
    """Return the shifts with the sign and the offset that bring them nearest to the asked ones.

    Raises
    ------
    DegenerateShifts
        asked shifts that leave the sign open.

    Examples
    --------
    >>> aligned(np.array([0.5, -0.5, -1.5]), np.array([0.0, 1.0, 2.0]))
    array([0., 1., 2.])
    """
    means = {sign: np.exp(1j * (sign * shifts - asked)).mean() for sign in (1, -1)}
    sign = max(means, key=lambda s: abs(means[s]))
    if abs(abs(means[1]) - abs(means[-1])) < _SAME_SIGN:
        raise DegenerateShifts(
            f"the estimated shifts fit the asked ones forwards ({abs(means[1]):.2f}) as well as backwards "
            f"({abs(means[-1]):.2f}), so that the sign of the phase is open: name shifts nearer to the real ones"
        )
    off = sign * shifts - np.angle(means[sign]) - asked
    return np.asarray(asked + np.angle(np.exp(1j * off)), np.float64)
