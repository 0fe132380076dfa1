"""Which sets of periods tell every projector column apart, and how surely.

Owns the rules for heterodyne and number-theoretic sets; the error model is `frequency_errors` of `phase.projection`,
the designs are `frequencies` there. Knows neither frames nor patterns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fringed_plugins.phase.projection import patterns
from fringed_plugins.phase.projection.frequencies import Design
from fringed_plugins.phase.projection.frequency_errors import number_theoretic_failure

MAX_FAILURE = 1e-6
_SAME_TURNS = 0.01  # phases that repeat this well are the same in practice: a thirtieth of a grey level's worth
Designer = Callable[[float, int, float], Design]


def repeat_px(periods_px: Sequence[float], size_px: int, tolerance_turns: float = _SAME_TURNS) -> float | None:
    """Return the smallest distance of two columns whose phases all agree, or None within `size_px`.

    Examples
    --------
    >>> repeat_px([1024 / 56, 1024 / 64], 1024)
    128.0
    >>> repeat_px([1024 / 56, 1024 / 63, 1024 / 64], 1024) is None
    True
    >>> repeat_px([15.0, 17.0], 1024)  # coprime: their product
    255.0
    """
    periods = np.asarray(periods_px, np.float64)
    finest = periods.min()
    turns = np.arange(1, int(np.floor((size_px - 1) / finest)) + 1)
    off = turns[:, None] * finest / periods
    same = np.abs(off - np.rint(off)).max(axis=1) < tolerance_turns
    return float(turns[same][0] * finest) if same.any() else None


def check_set(size_px: int, periods_px: Sequence[float], steps: Sequence[int], snr: float, designer: Designer) -> None:
    """Check that the phases of `periods_px`, long to short, tell all of `size_px` columns apart despite noise.

    `snr` is the modulation over the noise of a frame that is expected; the most likely combination of orders may be
    wrong at one pixel of a million. `designer` makes what a refusal suggests.

    Raises
    ------
    ValueError
        with the reason, and what to use instead.
    """
    if len(periods_px) < 2:
        raise ValueError(f"{len(periods_px)} period; two or more are needed to tell columns apart")
    if len(steps) != len(periods_px):
        raise ValueError(f"{len(steps)} numbers of steps for {len(periods_px)} periods; give one, or one for each")
    if list(periods_px) != sorted(set(periods_px), reverse=True):
        text = ", ".join(f"{period:.4g}" for period in periods_px)
        raise ValueError(f"periods of {text} px must all differ and go from long to short")
    for count, period in zip(steps, periods_px, strict=True):
        patterns.check_steps(count)
        patterns.check_period(size_px, size_px / period)
    again = repeat_px(periods_px, size_px)
    if again is not None:
        raise ValueError(
            f"columns {again:.4g} px apart share all phases, and the projector has {size_px} px: the beat of the "
            f"periods is too short; {_suggestion(size_px, steps, snr, designer)}"
        )
    failure = number_theoretic_failure([size_px / period for period in periods_px], steps, snr)
    if failure > MAX_FAILURE:
        raise ValueError(
            f"at a modulation of {snr:g} times the noise {failure:.2g} of the pixels would get a wrong fringe order "
            f"(allowed: {MAX_FAILURE:g}); {_suggestion(size_px, steps, snr, designer)}"
        )


def _suggestion(size_px: int, steps: Sequence[int], snr: float, designer: Designer) -> str:
    try:
        design = designer(size_px, max(sum(steps), 9), snr)
    except ValueError:
        return "take more steps or more light, or the encoder gray-phase-shift"
    return f"use for instance periods {list(design.periods)} across the projector with steps {list(design.steps)}"
