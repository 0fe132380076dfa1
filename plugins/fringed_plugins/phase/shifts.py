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

LANES = 4  # frames that the kernel takes at a time
Float32Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Group:
    """Frames of one frequency: their places in the stack, their shifts and their period.

    `frames[i]` has shift `shifts_rad[i]`; the phase of column u is `2 pi u / period_px + initial_rad`.
    """

    frames: tuple[int, ...]
    shifts_rad: tuple[float, ...]
    period_px: float
    initial_rad: float = 0.0


class Plan(NamedTuple):
    """What the kernel needs of the groups, coarse to fine; the second axis is a quarter of the frames."""

    place: npt.NDArray[np.int64]  # (groups, frames padded to LANES)
    chunks: npt.NDArray[np.int64]  # (groups,)
    fit: Float32Array  # (groups, chunks, 4, LANES): A, C, S and the first residual component
    extra: Float32Array  # (groups, components, frames padded): further residual components
    extras: npt.NDArray[np.int64]  # (groups,)
    initial_turns: Float32Array  # (groups,)
    ratio: Float32Array  # (groups,) period of the group before over this one's
    periods_px: Float32Array  # (groups,)


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
    shifts = np.asarray(shifts_rad, np.float64)
    model = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    left, singular, _ = np.linalg.svd(model)
    if len(shifts) < 3 or singular[-1] < 1e-3 * singular[0]:
        text = ", ".join(f"{shift:.4f}" for shift in shifts)
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


def plan(groups: Sequence[Group]) -> Plan:
    """Lay the groups' matrices out for the kernel; `groups` run from coarse to fine."""
    chunks = [-(-len(group.frames) // LANES) for group in groups]
    padded, most = max(chunks) * LANES, max(max(len(g.frames) for g in groups) - 4, 1)
    index = np.zeros((len(groups), padded), np.int64)
    fit = np.zeros((len(groups), max(chunks), 4, LANES), np.float32)
    extra = np.zeros((len(groups), most, padded), np.float32)
    for g, group in enumerate(groups):
        count = len(group.frames)
        index[g, :count] = group.frames
        index[g, count:] = group.frames[-1]
        rows = np.zeros((max(count, 4), padded))
        rows[:count, :count] = transform(group.shifts_rad)
        fit[g] = rows[:4].reshape(4, max(chunks), LANES).transpose(1, 0, 2)
        extra[g, : max(count - 4, 0)] = rows[4:count]
    periods = np.array([group.period_px for group in groups], np.float64)
    ratio = np.concatenate([[1.0], periods[:-1] / periods[1:]])
    initial = np.array([group.initial_rad for group in groups]) / (2 * np.pi)
    return Plan(
        place=index,
        chunks=np.array(chunks, np.int64),
        fit=fit,
        extra=extra,
        extras=np.array([max(len(g.frames) - 4, 0) for g in groups], np.int64),
        initial_turns=initial.astype(np.float32),
        ratio=ratio.astype(np.float32),
        periods_px=periods.astype(np.float32),
    )


def degrees_of_freedom(groups: Sequence[Group]) -> int:
    """Return how many residual components the groups have together."""
    return sum(len(group.frames) - 3 for group in groups)


def groups_of(frames: Sequence[Any], groups: dict[int, tuple[int, ...]]) -> list[Group]:
    """Return the sinusoidal groups of a sequence's frame descriptions, coarse to fine.

    `frames[i]` has `shift_rad`, `period_px`, `initial_phase_rad` and `style`.

    Raises
    ------
    ValueError
        a group whose frames are no sinusoids, or differ in more than their shift.
    """
    found = []
    for number, indices in groups.items():
        members = [frames[i] for i in indices]
        first = members[0]
        if any(m.style != "sinusoidal" or not m.period_px > 0 for m in members):
            raise ValueError(
                f"group {number} holds patterns of style {first.style!r} and period {first.period_px}; "
                "this decoder reads sinusoids with a period"
            )
        same = {(m.period_px, m.initial_phase_rad, m.orientation, m.channel) for m in members}
        if len(same) > 1:
            raise ValueError(
                f"the frames of group {number} differ in period, initial phase, orientation or channel: "
                f"{sorted(same)}; frames of one group may differ in their shift only"
            )
        shifts = tuple(float(m.shift_rad) for m in members)
        transform(shifts)
        found.append(Group(tuple(indices), shifts, float(first.period_px), float(first.initial_phase_rad)))
    return sorted(found, key=lambda group: -group.period_px)
