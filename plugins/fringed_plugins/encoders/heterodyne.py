"""Encoder of heterodyne sets: neighbouring frequencies whose beats are long.

Owns its parameters; the rules are in `phase.temporal.sets`, the designs in `phase.projection.frequencies`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from fringed import __version__
from fringed.data import Orientation, PatternSequence
from fringed.errors import UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.common import (
    Fringe,
    FringeParams,
    Named,
    design_notes,
    equal_shifts,
    fringes,
    length_px,
)

Steps = Annotated[
    Annotated[int, Meta(ge=3, le=64)] | list[Annotated[int, Meta(ge=3, le=64)]],
    Meta(description="equal phase steps: one number, or one for each period"),
]
Snr = Annotated[
    float, Meta(gt=0, le=1e4, description="modulation over the noise of a frame", extra_json_schema={"units": "1"})
]
AutoFrames = Annotated[
    int, Meta(ge=6, le=256, description="of all periods together, for auto", extra_json_schema={"units": "frames"})
]


class HeterodyneEncoder:
    """Several frequencies whose beats are long: every frame has fine fringes, and all of them measure the column.

    Unwrapping needs no frame of one period, whose only use is the order; all phases are averaged in the end.

    References
    ----------
    Towers, Towers & Jones 2003, 2005; Reich, Ritter & Thesing 1997 (three frequencies, such as 70, 64, 59).
    """

    name: ClassVar[str] = "heterodyne"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step sinusoidal fringes of neighbouring frequencies with long beats"
    decoders: ClassVar[tuple[str, ...]] = ("heterodyne", "number-theoretic")

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            list[Annotated[float, Meta(gt=0, le=4096)]] | Literal["auto"],
            Meta(description="across the projector, rising; auto: the best for frames and expected_snr"),
        ] = msgspec.field(default_factory=lambda: [56.0, 63.0, 64.0])
        steps: Steps = 4
        frames: AutoFrames = 12
        expected_snr: Snr = 20.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the patterns group by group, long periods first.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason and what to use instead.
        """
        from fringed_plugins.phase.projection.frequencies import design_heterodyne

        def given(size_px: int) -> list[float] | None:
            return None if params.periods == "auto" else [size_px / n for n in params.periods]

        return joint_fringes(self, params, target, given, design_heterodyne)


def joint_fringes(
    encoder: Named,
    params: Any,
    target: ProjectorTarget,
    given: Callable[[int], list[float] | None],
    designer: Any,
) -> PatternSequence:
    """Return fringes of the periods (px), long to short, that `given` has for a length; None: those of `designer`.

    Raises
    ------
    UsageError
        a set that leaves columns that nobody can tell apart, and what else makes no fringes.
    """
    from fringed_plugins.phase.temporal.sets import check_set

    def wanted(orientation: Orientation) -> list[Fringe]:
        size_px = length_px(target, orientation)
        periods_px, steps = given(size_px), params.steps
        if periods_px is None:
            design = designer(size_px, params.frames, params.expected_snr)
            periods_px, steps = [size_px / n for n in design.periods], list(design.steps)
        steps = [steps] * len(periods_px) if isinstance(steps, int) else list(steps)
        check_set(size_px, periods_px, steps, params.expected_snr, designer)
        return [Fringe(period, equal_shifts(count)) for period, count in zip(periods_px, steps, strict=True)]

    auto = given(target.width_px) is None
    try:
        notes = design_notes(designer, params, target) if auto else None
    except ValueError as error:
        raise UsageError(f"{encoder.name}: {error}") from error
    return fringes(encoder, params, target, wanted, notes=notes)
