"""What all encoders share: parameters, and frames with their pictures as a PatternSequence.

Owns names, units and limits of the parameters; the arithmetic is in `phase`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Protocol

import msgspec
import numpy as np
from msgspec import Meta

from fringed.data import Channel, Orientation, PatternFrame, PatternSequence, UInt8Array
from fringed.errors import UsageError
from fringed.hookspecs import Params, ProjectorTarget
from fringed_plugins.phase import patterns

Grey = Annotated[float, Meta(ge=0, le=255, description="darkest grey level", extra_json_schema={"units": "grey level"})]
GreyHigh = Annotated[
    float, Meta(ge=0, le=255, description="brightest grey level", extra_json_schema={"units": "grey level"})
]
Direction = Annotated[Orientation, Meta(description="what the phase counts: projector columns or rows")]
Light = Annotated[Channel, Meta(description="the projector's light")]
_CHANNELS: dict[str, int] = {"red": 0, "green": 1, "blue": 2}


class FringeParams(Params, frozen=True, kw_only=True):
    """What all sinusoidal fringes have in common."""

    orientation: Direction = "columns"
    style: Annotated[Literal["sinusoidal"], Meta(description="the fringes' profile")] = "sinusoidal"
    grey_low: Grey = 0.0
    grey_high: GreyHigh = 255.0
    channel: Light = "white"
    precompensate: Annotated[
        bool, Meta(description="make the light sinusoidal, where the projector's tone curve is known")
    ] = True


class Named(Protocol):
    """What a sequence says of its encoder."""

    name: ClassVar[str]
    version: ClassVar[str]


def length_px(target: ProjectorTarget, orientation: Orientation) -> int:
    """Return how many projector pixels the phase counts."""
    return target.width_px if orientation == "columns" else target.height_px


def sinusoids(
    encoder: Named,
    params: FringeParams,
    target: ProjectorTarget,
    periods: Sequence[float],
    steps: Sequence[int],
    initial_phase_rad: float,
) -> PatternSequence:
    """Return N-step sinusoids of one group for each number of `periods`.

    Raises
    ------
    UsageError
        grey levels or a tone curve that make no fringes.
    """
    length = length_px(target, params.orientation)
    curve = target.tone_curve if params.precompensate else None
    frames, images = [], []
    for group, (number, count) in enumerate(zip(periods, steps, strict=True)):
        for step in range(count):
            frame = PatternFrame(
                style=params.style,
                orientation=params.orientation,
                period_px=length / number,
                shift_rad=2 * np.pi * step / count,
                initial_phase_rad=initial_phase_rad,
                step=step,
                steps=count,
                group=group,
                channel=params.channel,
            )
            light = patterns.sinusoid(length, frame.period_px, initial_phase_rad + frame.shift_rad)
            try:
                patterns.check_greys(params.grey_low, params.grey_high)
                grey = patterns.grey_levels(light, params.grey_low, params.grey_high, curve)
            except ValueError as error:
                raise UsageError(f"{encoder.name}: {error}") from error
            frames.append(frame)
            images.append(line_image(grey, params))
    return PatternSequence(
        family=encoder.name,
        width_px=target.width_px,
        height_px=target.height_px,
        frames=tuple(frames),
        patterns=tuple(images),
        grey_low=params.grey_low,
        grey_high=params.grey_high,
        precompensated=curve is not None,
        encoder=encoder.name,
        encoder_version=encoder.version,
        parameters=msgspec.to_builtins(params),
    )


def line_image(grey: UInt8Array, params: FringeParams) -> UInt8Array:
    """Return one row or column; coloured light has three channels, so that it cannot be mistaken."""
    line = grey.reshape((1, -1, 1) if params.orientation == "columns" else (-1, 1, 1))
    if params.channel == "white":
        return line
    image = np.zeros((*line.shape[:2], 3), np.uint8)
    image[:, :, _CHANNELS[params.channel]] = line[:, :, 0]
    return image
