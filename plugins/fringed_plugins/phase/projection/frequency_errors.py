"""How often noise makes a fringe order wrong, for three ways to unwrap in time.

Owns the closed-form error model of sets of frequencies; knows neither patterns nor images. A frequency with n periods
across the projector, N equal steps and a modulation of `snr` times a frame's noise has the phase noise
sqrt(2 / N) / snr (Zuo et al. 2018, equation 21). The probabilities are those of one pixel inside the projector's
picture; what lies within a few deviations of its border may come out on the other side, and is dropped there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]


def phase_noise(steps: Sequence[int], snr: float) -> Float64Array:
    """Return the standard deviation (rad) of each frequency's wrapped phase.

    Examples
    --------
    >>> phase_noise([3, 8], 10.0).round(4)
    array([0.0816, 0.05  ])
    """
    return np.sqrt(2 / np.asarray(steps, np.float64)) / snr


def beyond(deviation_rad: float) -> float:
    """Return the probability that a Gaussian error of this deviation leaves (-pi, pi].

    Examples
    --------
    >>> round(beyond(math.pi), 4)
    0.3173
    """
    return math.erfc(math.pi / (math.sqrt(2) * deviation_rad)) if deviation_rad > 0 else 0.0


def hierarchical_failure(periods: Sequence[float], steps: Sequence[int], snr: float) -> float:
    """Return the probability of a wrong order when each frequency unwraps the next finer one.

    `periods` run from coarse to fine. The prediction from level i, times the ratio r, and the phase of level
    i + 1 differ with the deviation sqrt(r^2 sigma_i^2 + sigma_(i+1)^2); the order is wrong beyond half a period.
    The levels' probabilities are added, which is at most a little too much.

    References
    ----------
    Zuo et al. 2016, section 3; Zhang 2009.

    Examples
    --------
    >>> hierarchical_failure([1, 8, 64], [4, 4, 4], 20.0) < 1e-20
    True
    """
    sigma = phase_noise(steps, snr)
    ratio = np.asarray(periods[1:], float) / np.asarray(periods[:-1], float)
    return sum(beyond(float(d)) for d in np.hypot(ratio * sigma[:-1], sigma[1:]))


def heterodyne_failure(periods: Sequence[float], steps: Sequence[int], snr: float) -> float:
    """Return the probability of a wrong order when beats with the finest frequency unwrap one another.

    The finest phase minus that of each other frequency is a beat of `finest - n` periods across the projector; the
    beats are taken from the longest to the shortest, and the last one unwraps the finest phase. All beats share
    the finest phase's error, which the deviations account for.

    References
    ----------
    Towers, Towers & Jones 2003 and 2005; Zuo et al. 2016, section 3.2.

    Examples
    --------
    >>> heterodyne_failure([56, 63, 64], [4, 4, 4], 20.0) < 1e-9
    True
    """
    sigma = phase_noise(steps, snr)
    beats = [*sorted((periods[-1] - n, s) for n, s in zip(periods[:-1], sigma[:-1], strict=True)), (periods[-1], 0.0)]
    total = 0.0
    for (coarse, error), (fine, next_error) in pairwise(beats):
        ratio = fine / coarse
        total += beyond(math.hypot((ratio - 1) * sigma[-1], ratio * error, next_error))
    return total


def number_theoretic_failure(periods: Sequence[float], steps: Sequence[int], snr: float) -> float:
    """Return the probability that the most likely combination of orders is a wrong one.

    The wrapped phases of a pixel, each over its noise, lie on a line on a torus; another turn of that line is
    another set of orders. The distance d of two turns, at the closest column of each other turn, makes the
    probability erfc(d / sqrt(8)) / 2; these are added over all turns.

    References
    ----------
    Gushov & Solodkin 1991; Petkovic et al. 2017 (the orthographic projection in which turns are points).

    Examples
    --------
    >>> number_theoretic_failure([49, 57, 64], [4, 4, 4], 20.0) < 1e-12
    True
    >>> number_theoretic_failure([32, 64], [4, 4], 20.0)  # a common divisor: columns share all phases
    1.0
    """
    return float(lattice_failures(np.array([periods], np.float64), phase_noise(steps, snr))[0])


def lattice_failures(sets: Float64Array, sigma_rad: Float64Array) -> Float64Array:
    """Return the probability of a wrong combination for many `sets` (n, frequencies), the finest last."""
    from scipy.special import erfc

    finest = sets[:, -1:]
    turn = np.arange(1, int(finest.max()))
    real = turn[None, :] < finest
    weight = (2 * np.pi / sigma_rad) ** 2
    order = np.rint(sets[:, :, None] * (turn[None, None, :] / finest[:, :, None]))  # nearest column of that turn
    square = np.einsum("i,nij->nj", weight, order**2)
    along = np.einsum("i,ni,nij->nj", weight, sets, order)
    length = (sets**2) @ weight
    distance = np.sqrt(np.maximum(square - along**2 / length[:, None], 0.0))
    failures = np.where(real, erfc(distance / np.sqrt(8)) / 2, 0.0).sum(axis=1)
    return np.asarray(np.minimum(failures, 1.0), np.float64)


def position_noise(length_px: float, periods: Sequence[float], steps: Sequence[int], snr: float) -> float:
    """Return the deviation (px) of the projector column from the finest frequency alone.

    Examples
    --------
    >>> round(position_noise(1024, [1, 8, 64], [4, 4, 4], 20.0), 4)
    0.09
    """
    return float(length_px / periods[-1] * phase_noise(steps[-1:], snr)[0] / (2 * np.pi))


def combined_position_noise(length_px: float, periods: Sequence[float], steps: Sequence[int], snr: float) -> float:
    """Return the deviation (px) of the projector column when all frequencies are averaged by their weights.

    Examples
    --------
    >>> round(combined_position_noise(1024, [56, 63, 64], [4, 4, 4], 20.0), 4)
    0.0544
    """
    information = float(((np.asarray(periods, float) / phase_noise(steps, snr)) ** 2).sum())
    return length_px / (2 * math.pi * math.sqrt(information))
