"""Whether a set has enough light and not too much, and which exposure would.

Owns this part of the check and its words; arrays in, findings out. Where a sequence repeats its fringes with less
light, to reach bright and dark surfaces, its darkest frames are judged for saturation and any of them for light.
"""

from __future__ import annotations

import numpy as np

from fringed.acquisition.sinusoids import GroupFit
from fringed.config import CheckConfig
from fringed.data import Array, CheckFinding, Float32Array, PatternSequence

MIN_CONTRAST = 8.0 / 255.0  # of full scale: what a pixel of a set without fringes must vary by to be lit
MIN_MODULATION = 2.0 / 255.0
WANTED = 0.85  # of full scale: where the brightest pixels should be


def saturated_fraction(grid: Float32Array, sequence: PatternSequence, top: float) -> float:
    """Return the share of pixels that a frame of the least light saturates."""
    return float((_darkest(grid, sequence).max(axis=0) >= top).mean())


def _darkest(grid: Float32Array, sequence: PatternSequence) -> Float32Array:
    level = [frame.level for frame in sequence.frames]
    return grid[[i for i, one in enumerate(level) if one <= min(level)]]


def lit_fraction(grid: Float32Array, sequence: PatternSequence, fits: list[GroupFit], top: float) -> float:
    """Return the share of pixels that see every group of fringes at one level of light or another."""
    if fits:
        seen: dict[float, Array] = {}
        for fit in fits:
            level = sequence.frames[fit.indices[0]].level
            own = (fit.power > (MIN_MODULATION * top) ** 2) & (fit.power > 9 * fit.variance)
            seen[level] = own & seen.get(level, True)
        return float(np.any(list(seen.values()), axis=0).mean())
    if len(grid) < 2:
        return float((grid[0] > MIN_CONTRAST * top).mean())
    return float((np.ptp(grid, axis=0) > MIN_CONTRAST * top).mean())


def light_findings(
    grid: Float32Array, sequence: PatternSequence, shares: tuple[float, float], top: float, limits: CheckConfig
) -> list[CheckFinding]:
    """Return what is wrong; `shares` are the saturated and the lit fraction."""
    saturated, lit = shares
    findings = []
    if saturated > limits.saturated_max:
        findings.append(
            CheckFinding(
                "saturated",
                f"{saturated:.1%} of the pixels are saturated; checks.saturated_max allows {limits.saturated_max:.1%}; "
                f"shorten the exposure {_shorter(_darkest(grid, sequence), top, limits.saturated_max)} or close the "
                "aperture (`fringe exposure` measures what fits; pipeline hdr takes several)",
            )
        )
    if lit < limits.lit_min:
        findings.append(
            CheckFinding(
                "unlit",
                f"fringes are seen on {lit:.2%} of the pixels; checks.lit_min asks for {limits.lit_min:.2%}; "
                f"{_darkness(grid, top, saturated)}",
            )
        )
    return findings


def _shorter(frames: Float32Array, top: float, allowed: float) -> str:
    """Return by how much, from the median frame: fringes are twice as bright at most."""
    middle = np.median(frames, axis=0) if len(frames) > 2 else frames.max(axis=0)
    peak = np.where(middle < top, np.minimum(2 * middle, np.maximum(frames.max(axis=0), 2 * middle)), np.inf)
    wanted = float(np.quantile(peak, 1 - allowed / 2, method="lower"))
    if not np.isfinite(wanted):
        return "to less than half"
    return f"to about {min(WANTED * top / max(wanted, 1.0), 0.9):.0%}"


def _darkness(grid: Float32Array, top: float, saturated: float) -> str:
    if saturated > 0.5:
        return "they are lost in saturation: shorten the exposure (`fringe exposure` measures what fits)"
    brightest = float(np.quantile(grid.max(axis=0), 0.99)) / top
    if brightest < 0.25:
        return (
            f"the brightest hundredth reaches {brightest:.1%} of full scale: is the projector on and its lens cap off? "
            f"If so, lengthen the exposure up to {WANTED / max(brightest, 0.01):.0f} times, or open the aperture"
        )
    return "is the projector on, its lens cap off, and the object in view?"
