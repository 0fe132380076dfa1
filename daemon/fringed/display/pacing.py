"""Whether flips follow the display's refresh, from their times alone.

A driver's word for it proves nothing: many answer "yes" where there is no refresh to wait for. Flips that follow a
refresh come at one phase of it, however long one pauses before asking; others come when they are asked for. Pure
arithmetic: no clock, no window.
"""

from __future__ import annotations

import cmath
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import tau

BURST = 30
TRIALS = 12
LOCKED = 0.85
"""Length of the mean phase vector: 1 for perfect flips; times at random pass 12 trials once in 6,000."""
DEEPEST = 2
FASTEST = 2.5
"""Flips that many times as frequent as the refresh that is told or assumed wait for none."""
_GOLDEN = 0.6180339887


@dataclass(frozen=True)
class Pace:
    """What was measured. `depth` as in `messages.Ready`: -1 where nothing locks."""

    interval_s: float
    jitter_s: float
    depth: int


def pauses(period_s: float) -> list[float]:
    """Return the pauses before the trials: beyond one period, at evenly spread phases."""
    return [(1.2 + (k * _GOLDEN) % 1.0) * period_s for k in range(TRIALS)]


def locking(times_s: Sequence[float], period_s: float) -> float:
    """Return the length of the mean phase vector, 0 (at random) to 1 (all at one phase).

    >>> round(locking([0.0, 1.0, 3.0], 1.0), 3), round(locking([0.0, 1.5], 1.0), 3)
    (1.0, 0.0)
    """
    return abs(sum(cmath.exp(1j * tau * (t - times_s[0]) / period_s) for t in times_s)) / len(times_s)


def intervals(times_s: Sequence[float]) -> tuple[float, float]:
    """Return the mean interval without outliers, and its standard deviation.

    A flip that was missed (the interval is another than the median's by a quarter) is left out.
    """
    steps = [b - a for a, b in pairwise(times_s)]
    middle = statistics.median(steps)
    kept = [step for step in steps if abs(step - middle) <= middle / 4] or [middle]
    return statistics.fmean(kept), statistics.pstdev(kept)


def measured(present: Callable[[], float], sleep: Callable[[float], None], nominal_s: float) -> Pace:
    """Flip, and return at what pace; `present` flips the same picture again and returns when that came back."""
    present()
    times = [present() for _ in range(BURST)]
    interval_s, jitter_s = intervals(times[2:])  # the first ones fill the driver's queue
    if interval_s < nominal_s / FASTEST:
        return Pace(interval_s, jitter_s, -1)
    trials = [_trial(present, sleep, pause_s + DEEPEST * interval_s) for pause_s in pauses(interval_s)]
    for depth in range(DEEPEST + 1):
        if locking([trial[depth] for trial in trials], interval_s) >= LOCKED:
            return Pace(interval_s, jitter_s, depth)
    return Pace(interval_s, jitter_s, -1)


def _trial(present: Callable[[], float], sleep: Callable[[float], None], pause_s: float) -> list[float]:
    """Return the times of flips after a pause in which the driver's queue ran dry."""
    sleep(pause_s)
    return [present() for _ in range(DEEPEST + 1)]
