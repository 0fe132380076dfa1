"""What the pictures of a set betray by themselves: repeats, and groups that are no sinusoid.

Owns which test applies to which group; arrays in, findings out. What has no group of fringes is judged by `codes`
and `ramps`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fringed.acquisition import siblings
from fringed.acquisition.blame import all_late, blame_group, blame_held
from fringed.acquisition.codes import code_findings
from fringed.acquisition.ramps import ramp_findings
from fringed.acquisition.sampling import Noise
from fringed.acquisition.sinusoids import GroupFit, misfit_of, tone_between, tone_of, without_tone
from fringed.acquisition.styles import fit_style, is_fringes
from fringed.data import CheckFinding, Float32Array, PatternSequence

TONE_SPREAD = 0.25  # how much of the removed harmonics may vary over the picture: blur damps them unevenly
UNEQUAL = 0.15  # of the light: what the fringes at an object's border and the lamp make of it
UNKNOWN_TONE = (0.28, 0.02)  # harmonics of gamma 2.2, for patterns that do not undo it and phases too few to tell


@dataclass(frozen=True)
class Pictures:
    """A set on its grid `(n, rows, columns)`, with all that it takes to judge it."""

    grid: Float32Array
    sequence: PatternSequence
    noise: Noise
    top: float
    limit: float


def fit_frames(pictures: Pictures, indices: tuple[int, ...], late: int = 0) -> GroupFit:
    """Fit one group; `late` takes frames that many places later."""
    sequence = pictures.sequence
    frames = [sequence.frames[i] for i in indices]
    fit = fit_style(pictures.grid, tuple(i + late for i in indices), frames, pictures.noise, pictures.top)
    return replace(fit, before=tuple(previous(sequence, i) for i in indices))


def previous(sequence: PatternSequence, index: int) -> int:
    """Return the frame that the same sensor saw before frame `index`, -1 for none; frames of a shot come together."""
    frame = sequence.frames[index]
    if frame.shot < 0:
        return index - 1
    earlier = (i for i in range(index - 1, -1, -1) if sequence.frames[i].shot != frame.shot)
    return next((i for i in earlier if sequence.frames[i].channel == frame.channel), -1)


def share_tone(sequence: PatternSequence, fits: list[GroupFit], own: list[tuple[float, ...] | None]) -> list[GroupFit]:
    """Remove the tone curve's harmonics from every fit: its `own`, or where that is None a kin group's.

    The kin's fringes may be finer, and blur has damped their harmonics: those of patterns that do not undo the tone
    curve lie between the kin's and what a gamma makes of sharp fringes.
    """
    shared = []
    for fit, amplitudes in zip(fits, own, strict=True):
        kin = [a for other, a in zip(fits, own, strict=True) if a is not None and _alike(sequence, fit, other)]
        borrowed = tuple(float(np.median(orders)) for orders in zip(*kin, strict=True)) if kin else None
        if borrowed and not amplitudes and not sequence.precompensated and len(fit.null):
            borrowed = tone_between(fit, borrowed, UNKNOWN_TONE)
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
    others = _other_findings(pictures, {index for fit in fits for index in fit.indices})
    findings += [finding for finding in others if not set(repeats) & set(finding.frames)]
    if len(findings) > len(repeats) + 1:
        last = len(pictures.grid) - 1
        moved = [fit_frames(pictures, fit.indices, late=1) for fit in fits if fit.indices[-1] < last]
        moved = share_tone(pictures.sequence, moved, [tone_of(fit) for fit in moved])
        everything = all_late(fits, moved, pictures.limit)
        findings = [everything] if everything else findings
    return findings, worst


def _other_findings(pictures: Pictures, fitted: set[int]) -> list[CheckFinding]:
    """Judge the frames that no group of fringes holds."""
    sequence, grid = pictures.sequence, pictures.grid
    if len(fitted) == len(sequence.frames):
        return []
    before = [previous(sequence, index) for index in range(len(sequence.frames))]
    light = (pictures.noise, pictures.top)
    return [
        *code_findings(grid, sequence, before, light, pictures.limit),
        *ramp_findings(grid, sequence, before, light),
        *_lone_findings(pictures, fitted, before),
    ]


def _lone_findings(pictures: Pictures, fitted: set[int], before: list[int]) -> list[CheckFinding]:
    """Return the frames, of fringes or beside them, that show what the one before them showed."""
    frames, found = pictures.sequence.frames, []
    for index, earlier in enumerate(before):
        fringes = [i for i in (index, earlier) if i >= 0 and is_fringes(frames[i])]
        many = [siblings.fringes_across(pictures.sequence, i) >= siblings.MIN_FRINGES for i in fringes]
        if earlier < 0 or index in fitted or not many or not all(many):
            continue
        pair = pictures.grid[[earlier, index]]
        half = pair.shape[1] // 2
        same = [siblings.are_one_picture(p, pictures.noise, pictures.top) for p in (pair[:, :half], pair[:, half:])]
        if any(same):
            text = f"frame {index} shows what frame {earlier} showed{'' if all(same) else ' in part of its rows'}"
            found.append(CheckFinding("late" if all(same) else "torn", text, (index,)))
    for indices in pictures.sequence.groups().values():
        complements = len(indices) == 2 and frames[indices[1]].inverted and not fitted & set(indices)
        found += _dim_findings(pictures, indices) if complements and not found else []
    return found


def _group_findings(pictures: Pictures, fit: GroupFit, fits: list[GroupFit]) -> tuple[list[CheckFinding], float]:
    if fit.loose or (fit.fits_always and not fit.clean):
        return _loose_findings(pictures, fit), 0.0
    if fit.fits_always:
        return _background_findings(pictures, fit, fits)
    misfit = misfit_of(fit)
    allowed = pictures.limit + TONE_SPREAD * (fit.tone + fit.shape)
    wrong = misfit.certain.max() > allowed
    found = [blame_group(pictures.grid, fit, misfit.relative, allowed)] if wrong else []
    if not wrong and fit.indices[0] == 0:
        found += _held(pictures, fit, (0,), fit.deleted(0), 1.0 / float(fit.freedom[0]))
    return found, float(misfit.relative.max())


def _loose_findings(pictures: Pictures, fit: GroupFit) -> list[CheckFinding]:
    """Judge a group of which nothing can be said but what looks like the picture before."""
    found = _duplicate_findings(pictures, fit) or _dim_findings(pictures, fit.indices)
    for position in range(len(fit.indices)) if not (found or fit.fits_always) else ():
        found += _held(pictures, fit, (position,), fit.deleted(position), 1.0 / float(fit.freedom[position]))
    return found


def _dim_findings(pictures: Pictures, indices: tuple[int, ...]) -> list[CheckFinding]:
    """Judge fringes, so many of them that every band holds some periods, by the light that they have in common."""
    if siblings.fringes_across(pictures.sequence, indices[0]) < 4 * siblings.MIN_FRINGES:
        return []
    index, away = siblings.unequal_light(pictures.grid, indices, pictures.top)
    if away <= UNEQUAL:
        return []
    text = (
        f"frame {index} has {away:.0%} more or less light than the others of its fringes (frames {indices[0]} to "
        f"{indices[-1]}); it holds some of what was shown before: raise acquisition.latency_s or settle_s"
    )
    return [CheckFinding("blended", text, (index,))]


def _background_findings(pictures: Pictures, fit: GroupFit, fits: list[GroupFit]) -> tuple[list[CheckFinding], float]:
    """Judge a group that always fits: by duplicates, and by a background that its siblings share."""
    found = _duplicate_findings(pictures, fit)
    others = [other for other in fits if other is not fit and other.clean and _kin(pictures.sequence, fit, other)]
    if others:
        error, inflation = siblings.background_error(fit, others)
        misfit = siblings.background_misfit(fit, others, error, inflation)
        found += [] if found else _held(pictures, fit, tuple(range(len(fit.indices))), error, inflation)
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


def _alike(sequence: PatternSequence, fit: GroupFit, other: GroupFit) -> bool:
    """Tell whether two groups have the same harmonics."""
    one, two = sequence.frames[fit.indices[0]], sequence.frames[other.indices[0]]
    return (one.orientation, one.channel, one.style) == (two.orientation, two.channel, two.style)


def _kin(sequence: PatternSequence, fit: GroupFit, other: GroupFit) -> bool:
    """Tell whether two groups have the same background."""
    one, two = sequence.frames[fit.indices[0]], sequence.frames[other.indices[0]]
    return (one.orientation, one.channel, one.level) == (two.orientation, two.channel, two.level)


def _duplicate_findings(pictures: Pictures, fit: GroupFit) -> list[CheckFinding]:
    found = []
    frames = pictures.sequence.frames
    for index, earlier in zip(fit.indices, fit.before, strict=True):
        before = frames[earlier] if earlier >= 0 else None
        fringes = siblings.fringes_across(pictures.sequence, index)
        if before is None or not is_fringes(before) or fringes < siblings.MIN_FRINGES:
            continue
        turned = frames[index].shift_rad - before.shift_rad
        expected = 1.0 - float(np.cos(turned)) if earlier in fit.indices else 1.0
        same = siblings.same_pictures(pictures.grid, (earlier, index), fit, max(expected, 1e-3), pictures.noise)
        told = same[~np.isnan(same)]
        if len(told) and told.all():
            found.append(CheckFinding("late", f"frame {index} shows what frame {earlier} showed", (index,)))
        elif len(told) and told.any():
            text = f"frame {index} shows what frame {earlier} showed in {told.mean():.0%} of its bands"
            found.append(CheckFinding("torn", text, (index,)))
    return found
