"""Sequences of single pictures made of lines: what the single-frame and colour encoders share.

Owns their common parameters and the translation of relative light into pictures; the arithmetic is in `phase`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol

import msgspec
import numpy as np
from msgspec import Meta

from fringed.data import Float64Array, Orientation, PatternFrame, PatternSequence, UInt8Array
from fringed.errors import UsageError
from fringed.hookspecs import Params, ProjectorTarget
from fringed_plugins.phase.projection import patterns

COLOURS = ("red", "green", "blue")
_GREY = {"units": "grey level"}


class GreyParams(Params, frozen=True, kw_only=True):
    """What uniform pictures and lines have in common."""

    grey_low: Annotated[float, Meta(ge=0, le=255, description="darkest grey level", extra_json_schema=_GREY)] = 0.0
    grey_high: Annotated[float, Meta(ge=0, le=255, description="brightest grey level", extra_json_schema=_GREY)] = 255.0
    precompensate: Annotated[
        bool, Meta(description="make the light sinusoidal, where the projector's tone curve is known")
    ] = True


class LineParams(GreyParams, frozen=True, kw_only=True):
    """What lines have in common."""

    orientation: Annotated[Orientation, Meta(description="what the phase counts: projector columns or rows")] = (
        "columns"
    )


class Named(Protocol):
    """What a sequence says of its encoder."""

    name: ClassVar[str]
    version: ClassVar[str]


@dataclass(frozen=True)
class Exposure:
    """One picture: its frames (one, or one for each camera channel) and the light of each projector channel.

    `lights` holds one line for white light, or three for red, green and blue: 0 to 1 along the phase's direction,
    from the darkest to the brightest grey level; None is a channel that stays off.
    """

    frames: tuple[PatternFrame, ...]
    lights: tuple[Float64Array | None, ...]


def length_px(target: ProjectorTarget, orientation: Orientation) -> int:
    """Return how many projector pixels the phase counts."""
    return target.width_px if orientation == "columns" else target.height_px


def sequence_of(
    encoder: Named, params: GreyParams, target: ProjectorTarget, exposures: Sequence[Exposure]
) -> PatternSequence:
    """Return the exposures as a sequence; frames of one exposure share one picture.

    Raises
    ------
    UsageError
        grey levels or a tone curve that make no fringes.
    """
    curve = target.tone_curve if params.precompensate else None
    orientation = params.orientation if isinstance(params, LineParams) else "columns"
    frames: list[PatternFrame] = []
    images: list[UInt8Array] = []
    try:
        patterns.check_greys(params.grey_low, params.grey_high)
        for exposure in exposures:
            image = _image(exposure.lights, params, curve, orientation)
            frames.extend(exposure.frames)
            images.extend([image] * len(exposure.frames))
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
        precompensated=curve is not None,
        encoder=encoder.name,
        encoder_version=encoder.version,
        parameters=msgspec.to_builtins(params),
    )


def _image(
    lights: Sequence[Float64Array | None], params: GreyParams, curve: Float64Array | None, orientation: Orientation
) -> UInt8Array:
    length = max(light.size for light in lights if light is not None)
    flat = np.zeros((length, len(lights)), np.uint8)
    for channel, light in enumerate(lights):
        if light is not None:
            flat[:, channel] = patterns.grey_levels(light, params.grey_low, params.grey_high, curve)
    image = flat[None] if orientation == "columns" else flat[:, None]
    image.flags.writeable = False
    return image


def uniform(length: int, light: float) -> Float64Array:
    """Return the same light everywhere along a line of `length`."""
    return np.full(length, light)
