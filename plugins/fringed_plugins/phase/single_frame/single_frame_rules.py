"""What can be decoded from a single frame, and what cannot: refused before anything is projected.

Owns the rules for carriers and for sets of carriers in one exposure; knows no contract.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

FEWEST_PERIODS = 12
SHORTEST_PERIOD_PX = 6.0
MIN_RATIO = 1.25
_SAFE_SIGMAS = 5.0
_GOOD_SET = (40, 59, 96)


def check_carrier(length_px: int, periods: float) -> None:
    """Check that one frame of `periods` fringes across the projector's `length_px` can be decoded by itself.

    Raises
    ------
    ValueError
        so few that the fringes cannot be told from the background, or so many that their band leaves the picture.
    """
    most = int(length_px / SHORTEST_PERIOD_PX)
    if not np.isfinite(periods) or periods < FEWEST_PERIODS:
        raise ValueError(
            f"{periods:g} periods across the projector are too few for a single frame: the fringes' band, half their "
            f"frequency wide, would hold the background too; use {FEWEST_PERIODS} to {most}, such as {min(96, most)}"
        )
    if length_px / periods < SHORTEST_PERIOD_PX:
        raise ValueError(
            f"{periods:g} periods across {length_px} px are {length_px / periods:.3g} px each; a single frame needs at "
            f"least {SHORTEST_PERIOD_PX:g} px, so that a slanted surface still shows them: use at most {most} periods"
        )


def order_margin(periods: Sequence[float]) -> float:
    """Return how far apart, in turns, the phases of two columns are at least that share the finest phase nearly.

    The phases of all periods together are a point; a curve of such points runs through their unit cell. Noise
    that moves a point by half the distance of two branches makes the fringe order wrong.

    References
    ----------
    Petkovic, Pribanic & Donlic 2017 (distances in the projected lattice).

    Examples
    --------
    >>> round(order_margin([25, 40, 64]), 3)
    0.119
    """
    apart = np.linspace(0, 0.5, 1 + 400 * int(max(periods)))
    turns = np.outer(np.asarray(periods, float), apart)
    distance = np.sqrt(((turns - np.rint(turns)) ** 2).sum(axis=0))
    return float(distance[apart > 0.7 / max(periods)].min())


def check_carriers(length_px: int, periods: Sequence[int], phase_noise_rad: float) -> None:
    """Check that carriers in the channels of one exposure can be separated and unwrapped.

    Raises
    ------
    ValueError
        numbers that do not rise, bands that overlap where colours mix, or fringe orders that `phase_noise_rad`
        would make wrong.
    """
    if len(periods) != 3 or list(periods) != sorted(set(periods)):
        raise ValueError(f"periods {list(periods)}: three rising numbers are needed, such as {list(_GOOD_SET)}")
    for number in periods:
        check_carrier(length_px, number)
    for low, high in pairwise(periods):
        if high / low < MIN_RATIO:
            raise ValueError(
                f"the bands of {low} and {high} periods overlap: where colours mix, one channel's fringes would pass "
                f"the other's filter; keep a ratio of {MIN_RATIO:g} and more, such as {list(_GOOD_SET)}"
            )
    least = 2 * _SAFE_SIGMAS * phase_noise_rad / (2 * np.pi)
    margin = order_margin(periods)
    if margin < least:
        raise ValueError(
            f"with {list(periods)} periods two columns differ by only {margin:.3g} turns in all phases together; at "
            f"a phase noise of {phase_noise_rad:g} rad {least:.3g} are needed: use {list(_GOOD_SET)} "
            f"({order_margin(_GOOD_SET):.3g}), or fewer periods"
        )
