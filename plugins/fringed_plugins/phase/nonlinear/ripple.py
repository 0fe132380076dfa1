"""The ripple that is left in a phase: few steps against many, on whatever surface.

Owns the comparison that verifies a compensation. The frames of a set of many steps hold sets of few: every third of
twelve makes four. Noise they share, a surface they share, and harmonics show in the few alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.nonlinear.table import error_series
from fringed_plugins.phase.shifts import transform

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Complex64Array = npt.NDArray[np.complex64]

_UNIFORM = 0.03


@dataclass(frozen=True)
class Ripple:
    """The phase error of `steps` steps: RMS (rad), its amplitudes (4, 2), and the RMS of the noise about it."""

    steps: int
    rms_rad: float
    amplitudes: Float64Array
    noise_rad: float


def fringe_vector(frames: npt.NDArray[Any], shifts_rad: npt.ArrayLike) -> Complex64Array:
    """Return modulation exp(i wrapped phase), complex64 (height, width), of frames (n, height, width)."""
    matrix = transform(np.asarray(shifts_rad, np.float64).tolist())[1:3].astype(np.float32)
    cosine, sine = np.tensordot(matrix, np.asarray(frames, np.float32), 1)
    return np.asarray(cosine + 1j * sine, np.complex64)


def equal_steps(shifts_rad: npt.ArrayLike) -> int:
    """Return N where the shifts are N equal steps of a turn, in any order.

    Raises
    ------
    ValueError
        they are not.

    Examples
    --------
    >>> equal_steps([0.0, 4.18879, 2.094395])
    3
    """
    shifts = np.sort(np.mod(np.asarray(shifts_rad, np.float64), 2 * np.pi))
    gaps = np.diff(np.append(shifts, shifts[0] + 2 * np.pi))
    if len(shifts) < 3 or np.abs(gaps - 2 * np.pi / len(shifts)).max() > 1e-3:
        raise ValueError(
            f"shifts of {np.round(shifts, 3).tolist()} rad are not equal steps of a turn; harmonics alias in a known "
            "way only where they are: use the encoders' `steps`"
        )
    return len(shifts)


def subset_ripple(
    frames: npt.NDArray[Any], shifts_rad: npt.ArrayLike, steps: int, valid: npt.NDArray[np.bool_]
) -> Ripple:
    """Return the ripple of `steps` steps in `frames` (n, height, width) of n = m `steps` equal steps, m >= 2.

    The phase of all n is the truth but for harmonics n - 1 and above. Each of the m subsets is compared with it, at the
    `valid` pixels (height, width); what depends on the phase is ripple.

    Raises
    ------
    ValueError
        shifts that are no multiple of the steps, or too few pixels.
    """
    shifts = np.asarray(shifts_rad, np.float64)
    count = equal_steps(shifts)
    if count % steps or count // steps < 2:
        raise ValueError(f"{count} steps do not hold two or more sets of {steps}; take a multiple, such as {4 * steps}")
    order = np.argsort(np.mod(shifts, 2 * np.pi))
    truth = fringe_vector(frames, shifts)[valid]
    phase, errors = np.angle(truth), []
    for first in range(count // steps):
        chosen = order[first :: count // steps]
        few = fringe_vector(frames[chosen], shifts[chosen])[valid]
        errors.append((np.angle(few * np.conj(truth)), phase + shifts[chosen[0]]))
    error = np.concatenate([e for e, _ in errors])
    total = np.concatenate([p for _, p in errors])  # a subset that begins later sees its ripple at a later phase
    amplitudes, noise = error_series(error, total, steps)
    return Ripple(steps, float(np.sqrt(np.sum(amplitudes**2) / 2)), amplitudes, noise)


def likeness(one: npt.NDArray[Any], other: npt.NDArray[Any], blocks: tuple[int, int] = (24, 32)) -> float:
    """Return how alike two pictures of a scene are, -1 to 1: the correlation of their block means.

    Two scans of one surface in one place give nearly 1, whatever was projected; another surface, or another place,
    less. Only blocks that are lit in either picture count. Where both are as good as uniform, it is the cosine instead.
    """
    first, second = (_blocks(picture, blocks) for picture in (one, other))
    lit = (first > 0.1 * first.max()) | (second > 0.1 * second.max())
    a, b = first[lit], second[lit]
    if max(float(np.std(values) / max(abs(float(values.mean())), 1e-9)) for values in (a, b)) > _UNIFORM:
        a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0 else 1.0


def _blocks(picture: npt.NDArray[Any], blocks: tuple[int, int]) -> Float64Array:
    edges = [np.unique(np.arange(min(n, size)) * size // min(n, size))
             for n, size in zip(blocks, picture.shape, strict=True)]  # fmt: skip
    sums = np.add.reduceat(np.add.reduceat(picture.astype(np.float64), edges[0], axis=0), edges[1], axis=1)
    ones = np.add.reduceat(np.add.reduceat(np.ones(picture.shape), edges[0], axis=0), edges[1], axis=1)
    return np.asarray((sums / ones).ravel())
