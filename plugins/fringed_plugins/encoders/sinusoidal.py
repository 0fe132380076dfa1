"""Encoders of phase-shifted fringes: one frequency, and several from coarse to fine.

Owns their parameters; the arithmetic is in `phase`, what all fringes share in `common`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import Orientation, PatternSequence
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.common import (
    Fringe,
    FringeParams,
    Shifts,
    design_notes,
    double_shifts,
    equal_shifts,
    fringes,
    length_px,
    shown_snr,
)
from fringed_plugins.phase.projection import pattern_rules, patterns

if TYPE_CHECKING:
    from fringed_plugins.phase.projection.frequencies import Design

_PX = {"units": "px"}
InitialPhase = Annotated[
    float, Meta(ge=-7, le=7, description="phase of the first column", extra_json_schema={"units": "rad"})
]


class PhaseShiftEncoder:
    """N-step phase shifting with one frequency: a wrapped phase.

    References
    ----------
    thesis.md, section 2; Zuo et al. 2018; Huang, Hu & Chiang 2002 (`double`).
    """

    name: ClassVar[str] = "phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step fringes of one frequency"
    decoders: ClassVar[tuple[str, ...]] = ("phase-shift",)

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            float, Meta(gt=0, le=4096, description="across the projector", extra_json_schema={"units": "periods"})
        ] = 48.0
        period_px: Annotated[
            float,
            Meta(ge=0, le=65536, description="length of a period, instead of periods; 0: off", extra_json_schema=_PX),
        ] = 0.0
        steps: Annotated[int, Meta(ge=3, le=64, description="equal phase steps", extra_json_schema={"units": "1"})] = 6
        shifts_rad: Shifts = msgspec.field(default_factory=list)
        initial_phase_rad: InitialPhase = 0.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the patterns of one group (for each orientation and level).

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason and what to use instead.
        """

        def wanted(orientation: Orientation) -> list[Fringe]:
            length = length_px(target, orientation)
            periods = length / params.period_px if params.period_px > 0 else params.periods
            patterns.check_period(length, periods)
            pattern_rules.check_period_within(length, length / periods)
            return [Fringe(length / periods, _shifts(params.steps, params.shifts_rad))]

        return fringes(self, params, target, wanted, params.initial_phase_rad)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernel that dithers."""
        warm_up_dithering()


class MultiFrequencyEncoder:
    """Several frequencies, each with N steps, from one period to many: an absolute phase.

    References
    ----------
    Zuo et al. 2016, section 3 (hierarchical temporal unwrapping); Huang, Hu & Chiang 2002 (`double`).
    """

    name: ClassVar[str] = "multi-frequency"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step fringes of several frequencies, coarse to fine"
    decoders: ClassVar[tuple[str, ...]] = ("multi-frequency",)

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            list[Annotated[int, Meta(ge=1, le=4096)]] | Literal["auto"],
            Meta(
                description="across the projector, coarse to fine, starting with 1; auto: the best for frames and "
                "expected_snr"
            ),
        ] = msgspec.field(default_factory=lambda: [1, 8, 64])
        periods_px: Annotated[
            list[Annotated[float, Meta(gt=0, le=65536)]],
            Meta(max_length=16, description="lengths instead of numbers, the first one the projector's or more",
                 extra_json_schema=_PX),
        ] = msgspec.field(default_factory=list)  # fmt: skip
        steps: Annotated[
            Annotated[int, Meta(ge=3, le=64)] | list[Annotated[int, Meta(ge=3, le=64)]],
            Meta(description="equal phase steps: one number, or one for each frequency"),
        ] = 4
        shifts_rad: Shifts = msgspec.field(default_factory=list)
        initial_phase_rad: InitialPhase = 0.0
        frames: Annotated[
            int,
            Meta(ge=3, le=256, description="of all steps together, for auto", extra_json_schema={"units": "frames"}),
        ] = 12
        expected_snr: Annotated[
            float,
            Meta(gt=0, le=1e4, description="modulation over the noise of a frame", extra_json_schema={"units": "1"}),
        ] = 20.0
        min_period_px: Annotated[
            float, Meta(ge=4, le=4096, description="shortest period, for auto", extra_json_schema=_PX)
        ] = 12.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the patterns group by group, coarse to fine.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason and what to use instead.
        """
        from fringed_plugins.phase.projection.frequencies import design_hierarchical

        def best(length: int, frames: int, _: float) -> Design:
            return design_hierarchical(length, frames, shown_snr(params, params.expected_snr), params.min_period_px)

        def wanted(orientation: Orientation) -> list[Fringe]:
            length = length_px(target, orientation)
            if params.periods != "auto":
                return _unwrapping(params, _hierarchical(params, length))
            design = best(length, params.frames, params.expected_snr)
            made = [Fringe(length / n, equal_shifts(k)) for n, k in zip(design.periods, design.steps, strict=True)]
            return _unwrapping(params, made)

        sequence = fringes(self, params, target, wanted, params.initial_phase_rad)
        if params.periods != "auto":
            return sequence
        return replace(sequence, parameters={**sequence.parameters, **design_notes(best, params, target)})

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernel that dithers."""
        warm_up_dithering()


def warm_up_dithering() -> None:
    """Compile or load the kernel of error diffusion."""
    from fringed_plugins.phase.projection.dithering import diffuse

    diffuse(np.zeros((2, 2)), np.array([0.0, 1.0]))


def _shifts(steps: int, shifts_rad: Sequence[float]) -> tuple[float, ...]:
    """Return the explicit shifts, or equal ones."""
    if shifts_rad:
        return tuple(float(shift) for shift in shifts_rad)
    patterns.check_steps(steps)
    return equal_shifts(steps)


def _hierarchical(params: MultiFrequencyEncoder.Params, length: int) -> list[Fringe]:
    """Return the frequencies that the parameters list, once they are found good; raises ValueError."""
    assert not isinstance(params.periods, str)
    periods = [length / period_px for period_px in params.periods_px] or list(params.periods)
    steps = [params.steps] * len(periods) if isinstance(params.steps, int) else list(params.steps)
    if params.shifts_rad:
        steps = [len(params.shifts_rad)] * len(periods)
    found = [_shifts(count, params.shifts_rad) for count in steps]
    patterns.check_frequencies(
        length, periods, [_worth(params, shifts) for shifts in found], shown_snr(params, params.expected_snr)
    )
    return [Fringe(length / number, shifts) for number, shifts in zip(periods, found, strict=True)]


def _unwrapping(params: FringeParams, found: list[Fringe]) -> list[Fringe]:
    """Return the frequencies, once the shape of each coarse one is found good to unwrap the next; raises ValueError."""
    if params.style not in ("sinusoidal", "binary-dithered"):
        for coarse, fine in pairwise(found):
            shifts = double_shifts(coarse.shifts_rad) if params.double else coarse.shifts_rad
            ratio = coarse.period_px / fine.period_px
            pattern_rules.check_shape_unwraps(params.style, coarse.period_px, shifts, ratio)
    return found


def _worth(params: FringeParams, shifts_rad: Sequence[float]) -> float:
    """Return how many equal steps have as little noise as these shifts, taken as often as they are."""
    from fringed_plugins.phase.shifts import phase_variance_factor

    both = np.concatenate([shifts_rad, np.add(shifts_rad, np.pi)]) if params.inverse else np.asarray(shifts_rad)
    pattern_rules.check_shifts([float(shift) for shift in both])
    return (1 + params.double) * 2 / phase_variance_factor([float(shift) for shift in both])
