"""What the pictures of a set betray by themselves: repeats, and groups that are no sinusoid.

Owns which test applies to which group; arrays in, findings out. Groups of one step (Gray code, black,
white) are judged for repeats only: a small object may honestly look the same under two of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringed.acquisition import siblings
from fringed.acquisition.blame import all_late, blame_group, blame_held
from fringed.acquisition.sampling import Noise
from fringed.acquisition.sinusoids import GroupFit, fit_group, misfit_of, tone_of, without_tone
from fringed.data import CheckFinding, Float32Array, PatternSequence

TONE_SPREAD = 0.25  # how much of the removed harmonics may vary over the picture: blur damps them unevenly
UNKNOWN_TONE = (0.28, 0.02)  # harmonics of gamma 2.2, for patterns that do not undo it and phases too few to tell


@dataclass(frozen=True)
class Pictures:
    """A set on its grid `(n, rows, columns)`, with all that it takes to judge it."""

    grid: Float32Array
    sequence: PatternSequence
    noise: Noise
    top: float
    limit: float


def judged_groups(sequence: PatternSequence) -> list[tuple[int, ...]]:
    """Return the frames of each group of three or more steps."""
    return [
        indices
        for indices in sequence.groups().values()
        if sequence.frames[indices[0]].steps >= 3 and len(indices) >= 3
    ]


def fit_frames(pictures: Pictures, indices: tuple[int, ...], late: int = 0) -> GroupFit:
    """Fit one group; `late` takes frames that many places later."""
    shifts = np.array([pictures.sequence.frames[i].shift_rad for i in indices])
    return fit_group(pictures.grid, tuple(i + late for i in indices), shifts, pictures.noise, pictures.top)


def share_tone(sequence: PatternSequence, fits: list[GroupFit], own: list[tuple[float, ...] | None]) -> list[GroupFit]:
    """Remove the tone curve's harmonics from every fit: its `own`, or where that is None a kin group's."""
    shared = []
    for fit, amplitudes in zip(fits, own, strict=True):
        kin = [a for other, a in zip(fits, own, strict=True) if a is not None and _kin(sequence, fit, other)]
        borrowed = tuple(float(np.median(orders)) for orders in zip(*kin, strict=True)) if kin else None
        chosen = amplitudes or borrowed or ((0.0, 0.0) if sequence.precompensated else UNKNOWN_TONE)
        shared.append(without_tone(fit, chosen))
    return shared


def picture_findings(
    pictures: Pictures, fits: list[GroupFit], repeats: dict[int, int]
) -> tuple[list[CheckFinding], float]:
    """Return what is wrong, and the largest misfit of any group over its modulation.

    `repeats` maps a frame to the earlier one that it equals to the last bit.
    """
    findings = [
        CheckFinding("repeated", f"frame {later} is frame {earlier} again, to the last bit", (later,))
        for later, earlier in repeats.items()
    ]
    worst = 0.0
    for fit in fits:
        found, residual = _group_findings(pictures, fit, fits)
        worst = max(worst, residual)
        if not set(repeats) & set(fit.indices):
            findings += found
    if len(findings) > len(repeats) + 1:
        last = len(pictures.grid) - 1
        moved = [fit_frames(pictures, fit.indices, late=1) for fit in fits if fit.indices[-1] < last]
        moved = share_tone(pictures.sequence, moved, [tone_of(fit) for fit in moved])
        everything = all_late(fits, moved, pictures.limit)
        findings = [everything] if everything else findings
    return findings, worst


def _group_findings(pictures: Pictures, fit: GroupFit, fits: list[GroupFit]) -> tuple[list[CheckFinding], float]:
    if fit.fits_always:
        return _three_step_findings(pictures, fit, fits)
    misfit = misfit_of(fit)
    allowed = pictures.limit + TONE_SPREAD * fit.tone
    wrong = misfit.certain.max() > allowed
    found = [blame_group(pictures.grid, fit, misfit.relative, allowed)] if wrong else []
    if not wrong and fit.indices[0] == 0:
        found += _held(pictures, fit, (0,), fit.deleted(0), 1.0 / float(fit.freedom[0]))
    return found, float(misfit.relative.max())


def _three_step_findings(pictures: Pictures, fit: GroupFit, fits: list[GroupFit]) -> tuple[list[CheckFinding], float]:
    """Judge a group that always fits: by duplicates, and by a background that its siblings share."""
    found = _duplicate_findings(pictures, fit)
    others = [other for other in fits if other is not fit and _kin(pictures.sequence, fit, other)]
    if others:
        error, inflation = siblings.background_error(fit, others)
        misfit = siblings.background_misfit(fit, others, error, inflation)
        found += [] if found else _held(pictures, fit, (0, 1, 2), error, inflation)
        certain, residual = float(misfit.certain.max()), float(misfit.relative.max())
        against = "the other groups'"
    else:
        many = siblings.fringes_across(pictures.sequence, fit.indices[0]) >= 2 * siblings.MIN_FRINGES
        residual = siblings.background_fringes(fit) if many else 0.0
        certain, against = residual / 2, "one without fringes"
    if certain > pictures.limit and not found:
        text = (
            f"the background of frames {fit.indices[0]} to {fit.indices[-1]} differs from {against} by {residual:.3f} "
            f"of the modulation, allowed {pictures.limit:.3f}; one of these frames is late, blended or torn"
        )
        found = [CheckFinding("misfit", text, fit.indices)]
    return found, residual


def _held(
    pictures: Pictures, fit: GroupFit, positions: tuple[int, ...], error: Float32Array, inflation: float
) -> list[CheckFinding]:
    finding = blame_held(pictures.grid, fit, positions, error, inflation)
    return [finding] if finding else []


def _kin(sequence: PatternSequence, fit: GroupFit, other: GroupFit) -> bool:
    one, two = sequence.frames[fit.indices[0]], sequence.frames[other.indices[0]]
    return one.orientation == two.orientation and one.channel == two.channel


def _duplicate_findings(pictures: Pictures, fit: GroupFit) -> list[CheckFinding]:
    found = []
    frames = pictures.sequence.frames
    for index in fit.indices:
        before = frames[index - 1] if index else None
        fringes = siblings.fringes_across(pictures.sequence, index)
        if before is None or before.steps < 3 or fringes < siblings.MIN_FRINGES:
            continue
        turned = frames[index].shift_rad - before.shift_rad
        expected = 1.0 - float(np.cos(turned)) if index != fit.indices[0] else 1.0
        same = siblings.same_as_previous(pictures.grid, index, fit, max(expected, 1e-3), pictures.noise)
        told = same[~np.isnan(same)]
        if len(told) and told.all():
            found.append(CheckFinding("late", f"frame {index} shows what frame {index - 1} showed", (index,)))
        elif len(told) and told.any():
            text = f"frame {index} shows what frame {index - 1} showed in {told.mean():.0%} of its bands"
            found.append(CheckFinding("torn", text, (index,)))
    return found
