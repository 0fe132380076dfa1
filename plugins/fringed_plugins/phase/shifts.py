"""Least squares for known phase shifts, turned into one small matrix per group of frames.

Owns the linear algebra; the kernel multiplies. With I_k = A + C cos(shift_k) - S sin(shift_k), the
phase is atan2(S, C) and the modulation sqrt(C^2 + S^2); what is orthogonal to this model is residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.projection.profiles import STYLES, profile

_SAME_RAD = 1e-9
LANES = 4  # frames that the kernel takes at a time
FORMS = (3, 4, 6)  # numbers of equal shifts that have a closed form
Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Group:
    """Frames of one frequency: their places in the stack, their shifts and their period.

    `frames[i]` has shift `shifts_rad[i]`; the phase of column u is `2 pi u / period_px + initial_rad`. Of other
    styles than sinusoids this is the fundamental.
    """

    frames: tuple[int, ...]
    shifts_rad: tuple[float, ...]
    period_px: float
    initial_rad: float = 0.0
    style: str = "sinusoidal"


class Plan(NamedTuple):
    """What the kernel needs of the groups, coarse to fine; few arrays, for every one takes time to hand over."""

    frames: npt.NDArray[np.int64]  # (groups, 2 + n): FORM, CHUNKS, then places in the stack, in the form's order
    numbers: Float32Array  # (groups, 7): INITIAL ... MISFIT + 2
    weights: Float32Array  # (groups, chunks, 3, LANES): background, cosine, sine of frames less the first
    normal: Float32Array  # (groups, 6): what of the squares the fit explains, see `closed_forms.Sums`
    centre_turns: np.float32  # middle of the turn in which the coarsest phase lies


# Columns of a plan's frames: number of frames where the closed form holds, otherwise 0; number of LANES; places.
FORM, CHUNKS, PLACES = 0, 1, 2
# Columns of its numbers: turns to subtract from what the form gives; period of the group before over this one's; 0
# for the first group, otherwise 1; variance of the turns, times squared modulation, for a frame's variance of 1;
# largest sum of squared residuals: constant, per background, per squared modulation.
INITIAL, RATIO, COUNTS, VARIANCE, MISFIT = 0, 1, 2, 3, 4


def transform(shifts_rad: Sequence[float]) -> npt.NDArray[np.float64]:
    """Return the (n, n) matrix that takes n intensities to A, C, S and n - 3 residual components.

    The residual components have unit norm, so that each has the variance of one frame's noise. The
    rows of A, C and S are the least-squares solution (Greivenkamp 1984).

    Raises
    ------
    ValueError
        the shifts do not determine a phase: fewer than three different ones.

    Examples
    --------
    >>> np.round(transform([0.0, np.pi / 2, np.pi, 3 * np.pi / 2])[1], 3) + 0
    array([ 0.5,  0. , -0.5,  0. ])
    """
    model = _model(shifts_rad)
    left, singular, _ = np.linalg.svd(model)
    if len(model) < 3 or singular[-1] < 1e-3 * singular[0]:
        text = ", ".join(f"{shift:.4f}" for shift in shifts_rad)
        raise ValueError(
            f"shifts of ({text}) rad do not determine a phase; at least three different ones are needed, "
            "such as 0, 2 pi/3 and 4 pi/3"
        )
    return np.concatenate([np.linalg.pinv(model), left[:, 3:].T])


def phase_variance_factor(shifts_rad: Sequence[float]) -> float:
    """Return q with sigma_phase^2 = q sigma_frame^2 / modulation^2; 2/n for n equal shifts.

    For unequal shifts the variance depends on the phase; this is its mean over all phases.
    """
    rows = transform(shifts_rad)
    return float((rows[1] @ rows[1] + rows[2] @ rows[2]) / 2)


def form_in_use(shifts_rad: Sequence[float], *, absolute: bool) -> tuple[tuple[int, ...], float] | None:
    """Return the closed form that the kernels have for these shifts, or None where frames are summed.

    A wrapped phase takes one only where nothing has to be subtracted from it; levels of an absolute phase do without
    that of six frames, which would be one more loop to compile.
    """
    closed = closed_form(shifts_rad)
    if closed is None or (absolute and len(shifts_rad) > 4) or (not absolute and closed[1] != 0):
        return None
    return closed


def closed_form(shifts_rad: Sequence[float]) -> tuple[tuple[int, ...], float] | None:
    """Return the order of the frames, and what to subtract from the phase, that make `shifts_rad` 2 pi k / n.

    None where the shifts are not equal steps around the circle, or their number has no closed form.

    Examples
    --------
    >>> closed_form([np.pi, 0.0, np.pi / 2, -np.pi / 2])
    ((1, 2, 0, 3), 0.0)
    """
    count = len(shifts_rad)
    if count not in FORMS:
        return None
    shifts, step = np.asarray(shifts_rad, np.float64), 2 * np.pi / count
    offset = float(np.angle(np.exp(1j * count * shifts).mean())) / count
    steps = np.rint((shifts - offset) / step)
    places = np.mod(steps, count).astype(int)
    if sorted(places) != list(range(count)) or np.abs(shifts - offset - steps * step).max() > _SAME_RAD:
        return None
    return tuple(int(i) for i in np.argsort(places)), (offset if abs(offset) > _SAME_RAD else 0.0)


def plan(groups: Sequence[Group], centre_turns: float = 0.0, *, absolute: bool = True) -> Plan:
    """Lay the groups' matrices out for the kernel; `groups` run from coarse to fine."""
    chunks = [-(-len(group.frames) // LANES) for group in groups]
    frames = np.zeros((len(groups), PLACES + max(max(chunks) * LANES, *FORMS)), np.int64)
    weights = np.zeros((len(groups), max(chunks), 3, LANES), np.float32)
    numbers = np.full((len(groups), MISFIT + 3), np.inf)
    before = groups[0].period_px
    for g, group in enumerate(groups):
        closed = form_in_use(group.shifts_rad, absolute=absolute)
        order, offset = closed if closed is not None else (range(len(group.frames)), 0.0)
        frames[g, :PLACES] = 0 if closed is None else len(group.frames), chunks[g]
        frames[g, PLACES:] = group.frames[0]
        frames[g, PLACES : PLACES + len(group.frames)] = np.array(group.frames)[list(order)]
        weights[g, : chunks[g]] = chunk_weights(group.shifts_rad)
        variance = phase_variance_factor(group.shifts_rad) / (2 * np.pi) ** 2
        initial = (group.initial_rad + offset) / (2 * np.pi)
        numbers[g, :MISFIT] = initial, before / group.period_px, min(g, 1), variance
        before = group.period_px
    normal = np.array([_normal(group.shifts_rad) for group in groups], np.float32)
    return Plan(frames, numbers.astype(np.float32), weights, normal, np.float32(centre_turns))


def chunk_weights(shifts_rad: Sequence[float]) -> Float32Array:
    """Return (chunks, 3, LANES): the fit's first three rows, LANES frames at a time, 0 where there is no frame."""
    count = len(shifts_rad)
    chunks = -(-count // LANES)
    rows = np.zeros((3, chunks * LANES), np.float32)
    rows[:, :count] = transform(shifts_rad)[:3]
    return rows.reshape(3, chunks, LANES).transpose(1, 0, 2)


def _model(shifts_rad: Sequence[float]) -> npt.NDArray[np.float64]:
    shifts = np.asarray(shifts_rad, np.float64)
    return np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)


def _normal(shifts_rad: Sequence[float]) -> npt.NDArray[np.float64]:
    square = _model(shifts_rad).T @ _model(shifts_rad)
    return np.array([square[0, 0], square[1, 1], square[2, 2], square[0, 1], square[0, 2], square[1, 2]])


def style_residual(group: Group, gamma: float = 1.0) -> float:
    """Return the largest sum of squared residuals of a group of this style, over its squared modulation.

    The harmonics that N steps tell from the fundamental are residual: those of the style, and those that a projector
    of this `gamma` adds where nothing undoes it. It is that of the ideal shape, the most there can be: blur takes
    harmonics away first.

    Examples
    --------
    >>> four = tuple(np.arange(4) * np.pi / 2)
    >>> round(style_residual(Group((0, 1, 2, 3), four, 16.0, style="sawtooth")), 2)
    0.5
    >>> round(style_residual(Group((0, 1, 2, 3), four, 16.0), gamma=2.2), 2)
    0.32
    """
    if group.style == "sinusoidal" and gamma == 1:
        return 0.0
    phase = 2 * np.pi * (np.arange(720) + 0.5) / 720
    shifts = np.asarray(group.shifts_rad)[:, None]
    light = np.asarray(profile(group.style, phase + shifts, group.period_px)) ** gamma
    fitted = transform(group.shifts_rad) @ light
    return float(((fitted[3:] ** 2).sum(axis=0) / (fitted[1] ** 2 + fitted[2] ** 2)).max())


def style_ripple_rad(group: Group, gamma: float = 1.0) -> float:
    """Return the root mean square of the phase error that N steps make of the same harmonics.

    Those of order m N - 1 and m N + 1 pass for the fundamental: of a sinusoid of gamma g, three steps take the second
    one, (g - 1) / (g + 2) of the fundamental, which is that phase error's amplitude.

    Examples
    --------
    >>> three = tuple(np.arange(3) * 2 * np.pi / 3)
    >>> round(style_ripple_rad(Group((0, 1, 2), three, 16.0), gamma=2.2), 2), round(1.2 / 4.2 / 2**0.5, 2)
    (0.21, 0.2)
    """
    if group.style == "sinusoidal" and gamma == 1:
        return 0.0
    phase = 2 * np.pi * (np.arange(720) + 0.5) / 720
    light = np.asarray(profile(group.style, phase + np.asarray(group.shifts_rad)[:, None], group.period_px)) ** gamma
    fitted = transform(group.shifts_rad) @ light
    off = np.angle((fitted[1] + 1j * fitted[2]) * np.exp(-1j * phase))
    return float(np.sqrt(np.mean((off - off.mean()) ** 2)))


def degrees_of_freedom(groups: Sequence[Group]) -> int:
    """Return how many residual components the groups have together."""
    return sum(len(group.frames) - 3 for group in groups)


def groups_of(frames: Sequence[Any], groups: dict[int, tuple[int, ...]]) -> list[Group]:
    """Return the groups of fringes of a sequence's frame descriptions, coarse to fine.

    `frames[i]` has `shift_rad`, `period_px`, `initial_phase_rad` and `style`.

    Raises
    ------
    ValueError
        a group whose frames are no fringes with a period, or differ in more than their shift.
    """
    found = []
    for number, indices in groups.items():
        members = [frames[i] for i in indices]
        first = members[0]
        if any(m.style not in STYLES or not m.period_px > 0 for m in members):
            raise ValueError(
                f"group {number} holds patterns of style {first.style!r} and period {first.period_px}; "
                f"this decoder reads fringes with a period, of the styles {', '.join(STYLES)}"
            )
        same = {(m.period_px, m.initial_phase_rad, m.orientation, m.channel) for m in members}
        if len(same) > 1:
            raise ValueError(
                f"the frames of group {number} differ in period, initial phase, orientation or channel: "
                f"{sorted(same)}; frames of one group may differ in their shift only"
            )
        shifts = tuple(float(m.shift_rad) for m in members)
        transform(shifts)
        fringes = (float(first.period_px), float(first.initial_phase_rad), first.style)
        found.append(Group(tuple(indices), shifts, *fringes))
    return sorted(found, key=lambda group: -group.period_px)
