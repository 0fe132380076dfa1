"""What a registration returns: the motion, how it was found, and whether to believe it.

Owns plain results; the plug-in turns them into the products that travel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fringed_plugins.registration.transforms import FloatArray

Report = Callable[[float, str], None]


def silent(fraction: float, text: str) -> None:
    """Report nothing: the default of every `report`. A caller's own may raise to stop the work."""


@dataclass(frozen=True)
class Iteration:
    """One iteration: RMS of the pairs it used, their number, the limit of their distance, and the motion it made.

    `alpha_mm` is how much one unit of an invariant's noise counts as distance, where invariants are compared.
    """

    rms_mm: float
    pairs: int
    threshold_mm: float
    rotation_rad: float
    translation_mm: float
    stage: str
    alpha_mm: float = 0.0


@dataclass(frozen=True)
class Alignment:
    """A registered pair; `T_reference_model` (4, 4) takes model points to the reference's frame.

    `covariance` (6, 6) belongs to (rotation vector in rad, translation in mm) of a small motion in the
    reference's frame about its origin, made after `T_reference_model`. `overlap` is the part of the
    model's points that lie on the reference, `rms_mm` their point-to-plane error.
    """

    T_reference_model: FloatArray
    converged: bool
    reason: str
    rms_mm: float
    overlap: float
    covariance: FloatArray | None
    history: tuple[Iteration, ...]


def between(report: Report, low: float, high: float) -> Report:
    """Return what reports a part of the work as the part from `low` to `high` (0 to 1) of the whole."""
    return lambda fraction, text: report(low + (high - low) * fraction, text)
