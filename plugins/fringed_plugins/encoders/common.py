"""What all encoders of fringes share: parameters, and frames with their pictures as a PatternSequence.

Owns names, units and limits of the parameters, and the order of frames; the arithmetic is in `phase`, the pictures
are in `drawing`. The order: all groups of columns, then all of rows; within these the levels of light, the brightest
first; within these the frequencies as given. Groups are numbered through. A group holds its steps; with `double` then
the same steps half a step further; with `inverse` each pattern is followed by its complement.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol

import msgspec
import numpy as np
from msgspec import Meta

from fringed.data import Channel, Orientation, PatternFrame, PatternSequence
from fringed.errors import UsageError
from fringed.hookspecs import Params, ProjectorTarget
from fringed_plugins.encoders import drawing
from fringed_plugins.phase.projection import pattern_rules, patterns, profiles

if TYPE_CHECKING:
    from fringed_plugins.phase.projection.frequencies import Design

Grey = Annotated[float, Meta(ge=0, le=255, description="darkest grey level", extra_json_schema={"units": "grey level"})]
GreyHigh = Annotated[
    float, Meta(ge=0, le=255, description="brightest grey level", extra_json_schema={"units": "grey level"})
]
Direction = Annotated[
    Literal["columns", "rows", "both"],
    Meta(description="what the phase counts: projector columns, rows, or one set each"),
]
Light = Annotated[Channel, Meta(description="the projector's light")]
Style = Annotated[
    Literal["sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary", "binary-pulse-width", "binary-dithered"],
    Meta(description="the fringes' profile; the binary ones are for a defocused projector"),
]
Dither = Annotated[
    Literal["none", "quiet", "ordered", "error-diffusion"],
    Meta(description="vary whole grey levels so that their mean follows the light; quiet: so that the phase is spared"),
]
Shifts = Annotated[
    list[Annotated[float, Meta(ge=-100, le=100)]],
    Meta(max_length=64, description="explicit phase shifts instead of equal steps", extra_json_schema={"units": "rad"}),
]


class FringeParams(Params, frozen=True, kw_only=True):
    """What all fringes have in common."""

    orientation: Direction = "columns"
    style: Style = "sinusoidal"
    grey_low: Grey = 0.0
    grey_high: GreyHigh = 255.0
    channel: Light = "white"
    precompensate: Annotated[
        bool, Meta(description="make the light follow the profile, where the projector's tone curve is known")
    ] = True
    dither: Dither = "none"
    inverse: Annotated[bool, Meta(description="follow each pattern by its complement")] = False
    double: Annotated[
        bool,
        Meta(description="take the steps twice, half a step apart: the strongest error of a bent tone curve cancels"),
    ] = False
    levels: Annotated[
        list[Annotated[float, Meta(gt=0, le=1)]],
        Meta(min_length=1, max_length=8, description="shares of the light, each a set of its own: high dynamic range"),
    ] = msgspec.field(default_factory=lambda: [1.0])


class Named(Protocol):
    """What a sequence says of its encoder."""

    name: ClassVar[str]
    version: ClassVar[str]


@dataclass(frozen=True)
class Fringe:
    """One frequency: its period and its shifts."""

    period_px: float
    shifts_rad: tuple[float, ...]


def length_px(target: ProjectorTarget, orientation: str) -> int:
    """Return how many projector pixels the phase counts; of both orientations the fewer."""
    if orientation == "both":
        return min(target.width_px, target.height_px)
    return target.width_px if orientation == "columns" else target.height_px


def orientations(params: FringeParams) -> tuple[Orientation, ...]:
    """Return the orientations in the order of their groups."""
    return ("columns", "rows") if params.orientation == "both" else (params.orientation,)


def equal_shifts(steps: int) -> tuple[float, ...]:
    """Return `steps` shifts (rad) that divide a turn."""
    return tuple(2 * np.pi * step / steps for step in range(steps))


def double_shifts(shifts_rad: Sequence[float]) -> tuple[float, ...]:
    """Return the shifts, and then the same ones half a step further."""
    return (*shifts_rad, *(shift + np.pi / len(shifts_rad) for shift in shifts_rad))


def shown_snr(params: FringeParams, expected_snr: float) -> float:
    """Return the expected modulation over the noise of a frame, with what rounding to whole grey levels adds.

    The darkest level of light counts. A rounded level is off by 1 / sqrt(12) rms.
    """
    modulation = (params.grey_high - params.grey_low) / 2 * min(params.levels)
    rounded = params.dither in ("none", "quiet") and modulation > 0
    return float(1 / np.hypot(1 / expected_snr, 1 / np.sqrt(12) / modulation if rounded else 0.0))


def sinusoids(
    encoder: Named,
    params: FringeParams,
    target: ProjectorTarget,
    periods: Sequence[float],
    steps: Sequence[int],
    initial_phase_rad: float,
) -> PatternSequence:
    """Return N-step fringes of one group for each number of `periods` across the projector; raises as `fringes`."""

    def wanted(orientation: Orientation) -> list[Fringe]:
        length = length_px(target, orientation)
        return [Fringe(length / number, equal_shifts(count)) for number, count in zip(periods, steps, strict=True)]

    return fringes(encoder, params, target, wanted, initial_phase_rad)


def fringes(
    encoder: Named,
    params: FringeParams,
    target: ProjectorTarget,
    wanted: Callable[[Orientation], Sequence[Fringe]],
    initial_phase_rad: float = 0.0,
    *,
    notes: Mapping[str, Any] | None = None,
) -> PatternSequence:
    """Return the frames and pictures of the frequencies that `wanted` gives for each orientation.

    `notes` are added to what the sequence tells of its parameters.

    Raises
    ------
    UsageError
        shapes, shifts, grey levels, levels of light or a tone curve that make no fringes.
    """
    try:
        greys = _greys(params, target)
        frames = _frames(params, wanted, initial_phase_rad)
        images = drawing.images(frames, greys, (target.height_px, target.width_px), params.dither)
    except ValueError as error:
        raise UsageError(f"{encoder.name}: {error}") from error
    return PatternSequence(
        family=encoder.name,
        width_px=target.width_px,
        height_px=target.height_px,
        frames=tuple(frames),
        patterns=tuple(images),
        grey_low=params.grey_low,
        grey_high=params.grey_high,
        precompensated=greys.tone_curve is not None,
        encoder=encoder.name,
        encoder_version=encoder.version,
        parameters={**msgspec.to_builtins(params), **(notes or {})},
    )


def design_notes(designer: Callable[[int, int, float], Design], params: Any, target: ProjectorTarget) -> dict[str, Any]:
    """Return what a sequence of designed frequencies tells of them, for each orientation: see `Design`."""
    made = {o: designer(length_px(target, o), params.frames, params.expected_snr) for o in orientations(params)}
    return {"design": {orientation: asdict(design) for orientation, design in made.items()}}


def _greys(params: FringeParams, target: ProjectorTarget) -> patterns.Greys:
    """Return the grey levels to use at full light, once they are found good."""
    patterns.check_greys(params.grey_low, params.grey_high)
    curve = target.tone_curve if params.precompensate else None
    greys = patterns.Greys(params.grey_low, params.grey_high, curve)
    pattern_rules.check_tone(greys, params.style)
    pattern_rules.check_levels(params.levels, greys)
    if curve is None and target.tone_curve is not None:
        pattern_rules.check_clipping(greys, target.tone_curve, params.style)
    return greys


def _frames(
    params: FringeParams, wanted: Callable[[Orientation], Sequence[Fringe]], initial_phase_rad: float
) -> list[PatternFrame]:
    frames: list[PatternFrame] = []
    group = 0
    for orientation in orientations(params):
        found = list(wanted(orientation))
        for level in sorted(params.levels, reverse=True):
            for fringe in found:
                frames += _group(params, fringe, PatternFrame(
                    style=params.style, orientation=orientation, period_px=fringe.period_px, group=group,
                    initial_phase_rad=initial_phase_rad + profiles.offset_rad(params.style, fringe.period_px),
                    channel=params.channel, level=level,
                ))  # fmt: skip
                group += 1
    return frames


def _group(params: FringeParams, fringe: Fringe, common: PatternFrame) -> list[PatternFrame]:
    """Return the frames of one group: what they have in `common`, and their shifts."""
    own = double_shifts(fringe.shifts_rad) if params.double else fringe.shifts_rad
    shifts = [(shift, False) for shift in own]
    if params.inverse:
        shifts = [(shift + np.pi * inverted, inverted) for shift, _ in shifts for inverted in (False, True)]
    pattern_rules.check_shifts([shift for shift, _ in shifts])
    pattern_rules.check_shape(params.style, fringe.period_px, [shift for shift, _ in shifts], params.dither)
    return [
        replace(common, shift_rad=float(shift), step=step, steps=len(shifts), inverted=inverted)
        for step, (shift, inverted) in enumerate(shifts)
    ]
