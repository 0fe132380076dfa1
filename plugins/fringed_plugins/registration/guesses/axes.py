"""Guesses by principal axes: both views' means and axes brought together, with the four signs that are rotations.

Owns the method's place among the others; `starts` does the work.
"""

from __future__ import annotations

import numpy as np

from fringed_plugins.registration.guesses.common import Guess, overlaps, ranked, thinned
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.starts import principal_axes as four
from fringed_plugins.registration.surface import Level

NAME = "principal-axes"
SCORING_POINTS = 900
TOLERANCE = 3.0  # of the overlap, in sides of the thinned cubes: means of partial views are off by more than others


def principal_axes(
    reference: Level, model: Level, options: None, rng: np.random.Generator, threads: int, *, report: Report = silent
) -> list[Guess]:
    """Return the four alignments of principal axes of `model` to `reference`, most overlap first.

    Right where both views show nearly the same, wrong by what one of them lacks otherwise. There are no options, and
    `rng` chooses nothing.

    Returns
    -------
    list
        at most 4 guesses, their scores the overlap (0 to 1).

    Raises
    ------
    ValueError
        a view without 50 points with normals, or with points that are not finite.

    References
    ----------
    Thesis, section 4.4.1; Chung, Yun, Lee: Registration of multiple-range views using the reverse-calibration
    technique, Pattern Recognition 1998.
    """
    report(0.0, "principal axes")
    p, q = (thinned(level, SCORING_POINTS) for level in (reference, model))  # a grid is dense where it faces the sensor
    T = np.array(four(p.points, q.points))
    return ranked(T, overlaps(reference, q, T, TOLERANCE * q.side, threads) + 1e-9, NAME)
