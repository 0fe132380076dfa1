"""The best frequencies and steps for a projector, a number of frames and a noise.

Owns the three designs and what they promise; the search is in `frequency_search`, the error model in
`frequency_errors`. Each design has the least noise of the projector column
among those whose fringe orders are wrong less often than asked. The finest period is bounded by `min_period_px`: with a
Gaussian blur of b px (standard deviation) in projector and camera, a fringe of p px keeps exp(-2 (pi b / p)^2) of its
modulation, and the least noise is at p = 2 pi b.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

from fringed_plugins.phase.projection import frequency_errors as errors
from fringed_plugins.phase.projection import frequency_search as search
from fringed_plugins.phase.projection.frequency_search import MIN_STEPS, Wanted

FAILURE = 1e-6
MIN_PERIOD_PX = 12.0
_MOST_FREQUENCIES = 4  # number-theoretic: each further one gains little and doubles the search


@dataclass(frozen=True)
class Design:
    """Frequencies and their steps, coarse to fine, and what they promise.

    `failure` is the probability that a pixel's fringe order is wrong, `sigma_px` the deviation of the projector column
    from the finest frequency alone, `combined_sigma_px` from all of them averaged by their weights.
    """

    method: str
    periods: tuple[int, ...]
    steps: tuple[int, ...]
    failure: float
    sigma_px: float
    combined_sigma_px: float

    @property
    def frames(self) -> int:
        """How many frames it takes."""
        return sum(self.steps)


@lru_cache(maxsize=64)
def design_hierarchical(
    length_px: float, frames: int, snr: float, min_period_px: float = MIN_PERIOD_PX, failure: float = FAILURE
) -> Design:
    """Return the best set from one period across the projector to many.

    Parameters
    ----------
    length_px
        the projector's width (fringes that count columns) or height.
    frames
        how many frames may be taken, all steps of all frequencies together.
    snr
        modulation over the noise of one frame that the weakest wanted pixel has.
    min_period_px
        the shortest period.
    failure
        largest probability of a wrong fringe order.

    Raises
    ------
    ValueError
        numbers that leave no design, with the reason.

    References
    ----------
    Zuo et al. 2016, section 3; Zhang 2009.

    Examples
    --------
    >>> best = design_hierarchical(1024, 12, 20.0)
    >>> best.periods, best.steps
    ((1, 9, 85), (3, 3, 6))
    """
    wanted = _checked(length_px, frames, snr, min_period_px, failure, least=MIN_STEPS)
    return _best(wanted, "hierarchical", search.hierarchical_sets(wanted), errors.hierarchical_failure)


@lru_cache(maxsize=64)
def design_heterodyne(
    length_px: float, frames: int, snr: float, min_period_px: float = MIN_PERIOD_PX, failure: float = FAILURE
) -> Design:
    """Return the best set of neighbouring frequencies whose beats unwrap them; parameters and errors as above.

    The beats with the finest frequency follow a geometric series where noise asks for it.

    References
    ----------
    Towers, Towers & Jones 2003 and 2005.

    Examples
    --------
    >>> best = design_heterodyne(1024, 12, 20.0)
    >>> best.periods, best.steps
    ((76, 84, 85), (3, 3, 6))
    """
    wanted = _checked(length_px, frames, snr, min_period_px, failure, least=2 * MIN_STEPS)
    return _best(wanted, "heterodyne", search.heterodyne_sets(wanted), errors.heterodyne_failure)


@lru_cache(maxsize=64)
def design_number_theoretic(
    length_px: float, frames: int, snr: float, min_period_px: float = MIN_PERIOD_PX, failure: float = FAILURE
) -> Design:
    """Return the best set for a decoder that weighs all combinations of orders; parameters and errors as above.

    Such a decoder uses all phases, so the design has the least `combined_sigma_px`. Sets of two and three frequencies
    are searched whole, sets of four among the 32 numbers of periods below the finest.

    References
    ----------
    Gushov & Solodkin 1991; Petkovic et al. 2017.

    Examples
    --------
    >>> best = design_number_theoretic(1024, 12, 20.0)
    >>> best.combined_sigma_px < design_hierarchical(1024, 12, 20.0).combined_sigma_px
    True
    """
    wanted = _checked(length_px, frames, snr, min_period_px, failure, least=2 * MIN_STEPS)
    sets = (
        found
        for count in range(2, min(_MOST_FREQUENCIES, frames // MIN_STEPS) + 1)
        if (found := search.lattice_set(wanted, count)) is not None
    )
    return _best(wanted, "number-theoretic", sets, errors.number_theoretic_failure)


def _checked(length_px: float, frames: int, snr: float, min_period_px: float, failure: float, *, least: int) -> Wanted:
    positive = {"length_px": length_px, "snr": snr, "min_period_px": min_period_px, "failure": failure}
    wrong = [f"{name} is {value:g}" for name, value in positive.items() if not (math.isfinite(value) and value > 0)]
    if wrong or failure >= 0.5:
        raise ValueError(f"{', '.join(wrong) or f'failure is {failure:g}'}; all are above 0, failure below 0.5")
    if frames < least:
        raise ValueError(f"{frames} frames; {MIN_STEPS} for each frequency, {least} at least, are needed")
    if length_px / min_period_px < 2:
        raise ValueError(
            f"a shortest period of {min_period_px:g} px on {length_px:g} px leaves nothing to unwrap: allow shorter "
            f"ones, such as {length_px / 64:.3g} px"
        )
    return Wanted(length_px, frames, snr, min_period_px, failure)


def _best(
    wanted: Wanted,
    method: str,
    sets: Iterator[tuple[tuple[int, ...], tuple[int, ...]]],
    failure_of: Callable[[tuple[int, ...], tuple[int, ...], float], float],
) -> Design:
    designs = []
    for periods, steps in sets:
        failure = failure_of(periods, steps, wanted.snr)
        if failure <= wanted.failure:
            place = (wanted.length_px, periods, steps, wanted.snr)
            noise = errors.position_noise(*place), errors.combined_position_noise(*place)
            designs.append(Design(method, periods, steps, failure, *noise))
    if not designs:
        raise ValueError(
            f"no {method} set of {wanted.frames} frames has fringe orders wrong less often than "
            f"{wanted.failure:g} at a modulation of {wanted.snr:g} times the noise: take more frames, more light, or "
            "the hierarchical method"
        )
    finest = method != "number-theoretic"
    return min(designs, key=lambda d: (round(d.sigma_px if finest else d.combined_sigma_px, 12), d.failure))
