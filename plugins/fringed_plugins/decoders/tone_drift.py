"""Whether compensated fringes still are what the calibration's tone curve promises.

Owns the sign of a drift, the second harmonic, and its warning; `tone` measures and verifies the curve.
"""

from __future__ import annotations

import numpy as np

from fringed.data import Calibration, FrameSet
from fringed.hookspecs import Context
from fringed_plugins.decoders.common import full_scale_dn

PROMISE = "tone_second_harmonic"
UNVERIFIED_PROMISE = 0.02  # of the fundamental: what a compensation should keep below, where it was never verified
DRIFTED = 3.0  # times its promise: then the tone curve is another one than when it was measured
_LEAST_LIMIT = 0.015  # that much comes from motion, flicker and surfaces that shine through
_GRID = 6_000  # pixels: the harmonic is then known to 0.1 % or better, in a few milliseconds
_UNEVEN = 0.3


def warn_of_drift(frame_set: FrameSet, calibration: Calibration, context: Context) -> None:
    """Log a warning where compensated fringes show more of the second harmonic than the calibration promises.

    The tone curve is another one then: the lamp has aged, somebody changed the projector's picture mode, or the curve
    was measured with other settings. Sets of three steps cannot tell. Costs some milliseconds: it looks at a grid of
    pixels.
    """
    if calibration.tone_curve is None or not frame_set.sequence.precompensated:
        return
    seen = second_harmonic_of(frame_set)
    if seen is None:
        return
    promise = calibration.residuals.get(PROMISE, UNVERIFIED_PROMISE)
    limit = max(DRIFTED * promise, _LEAST_LIMIT)
    if abs(seen) > limit:
        context.log(
            "warning",
            f"the fringes have a second harmonic of {abs(seen):.1%} of the fundamental, where the calibration's tone "
            f"curve promises {promise:.1%} (warned of from {limit:.1%}): the projector's tone has drifted, or its "
            "picture mode was changed; measure it again with `fringe tone measure`, then `fringe tone verify`",
        )


def second_harmonic_of(frame_set: FrameSet) -> float | None:
    """Return the second harmonic over the fundamental, of the coarsest group that tells it; None where none does.

    A group tells it that is sinusoidal, has four or more steps, and whose every phase is seen alike.
    """
    from fringed_plugins.phase.nonlinear.harmonics import second_harmonic

    frames, sequence = frame_set.frames, frame_set.sequence
    step = max(1, int(np.sqrt(frames.shape[1] * frames.shape[2] / _GRID)))
    top = full_scale_dn(frame_set)
    for indices in sorted(sequence.groups().values(), key=lambda found: -sequence.frames[found[0]].period_px):
        members = [sequence.frames[i] for i in indices]
        if len(indices) < 4 or any(m.style != "sinusoidal" or m.inverted for m in members):
            continue
        grid = frames[list(indices), step // 2 :: step, step // 2 :: step].reshape(len(indices), -1).astype(np.float32)
        lit = (np.ptp(grid, axis=0) > 0.08 * top) & (grid.max(axis=0) < top)
        if np.count_nonzero(lit) < 200:
            continue
        amplitude, uneven = second_harmonic(grid[:, lit], [m.shift_rad for m in members])
        if uneven < _UNEVEN:
            return amplitude
    return None
