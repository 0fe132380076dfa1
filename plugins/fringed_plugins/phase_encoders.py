"""Encoders of the fringe methods: parameters to a PatternSequence.

Owns names, units and limits of the parameters; the arithmetic is in `phase.patterns`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import Meta

from fringed import __version__
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


class PhaseShiftEncoder:
    """N-step phase shifting with one frequency: a wrapped phase.

    References
    ----------
    thesis.md, section 2; Zuo et al. 2018.
    """

    name: ClassVar[str] = "phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step sinusoidal fringes of one frequency"
    decoders: ClassVar[tuple[str, ...]] = ("phase-shift",)

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            float, Meta(gt=0, le=4096, description="across the projector", extra_json_schema={"units": "periods"})
        ] = 48.0
        steps: Annotated[int, Meta(ge=3, le=64, description="equal phase steps", extra_json_schema={"units": "1"})] = 6
        initial_phase_rad: Annotated[
            float, Meta(ge=-7, le=7, description="phase of the first column", extra_json_schema={"units": "rad"})
        ] = 0.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return `steps` patterns of one group.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason.
        """
        try:
            patterns.check_steps(params.steps)
            patterns.check_period(_length(target, params.orientation), params.periods)
        except ValueError as error:
            raise UsageError(f"phase-shift: {error}") from error
        return _sequence(self, params, target, [params.periods], [params.steps], params.initial_phase_rad)


class MultiFrequencyEncoder:
    """Several frequencies, each with N steps, from one period to many: an absolute phase.

    References
    ----------
    Zuo et al. 2016, section 3 (hierarchical temporal unwrapping).
    """

    name: ClassVar[str] = "multi-frequency"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step sinusoidal fringes of several frequencies, coarse to fine"
    decoders: ClassVar[tuple[str, ...]] = ("multi-frequency",)

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            list[Annotated[int, Meta(ge=1, le=4096)]],
            Meta(min_length=1, max_length=16, description="across the projector, coarse to fine, starting with 1"),
        ] = msgspec.field(default_factory=lambda: [1, 8, 64])
        steps: Annotated[
            Annotated[int, Meta(ge=3, le=64)] | list[Annotated[int, Meta(ge=3, le=64)]],
            Meta(description="equal phase steps: one number, or one for each frequency"),
        ] = 4
        expected_snr: Annotated[
            float,
            Meta(gt=0, le=1e4, description="modulation over the noise of a frame", extra_json_schema={"units": "1"}),
        ] = 20.0

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the patterns group by group, coarse to fine.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason and what to use instead.
        """
        steps = [params.steps] * len(params.periods) if isinstance(params.steps, int) else list(params.steps)
        length = _length(target, params.orientation)
        try:
            patterns.check_frequencies(length, params.periods, steps, params.expected_snr)
        except ValueError as error:
            raise UsageError(f"multi-frequency: {error}") from error
        return _sequence(self, params, target, params.periods, steps, 0.0)


def _length(target: ProjectorTarget, orientation: Orientation) -> int:
    return target.width_px if orientation == "columns" else target.height_px


def _sequence(
    encoder: PhaseShiftEncoder | MultiFrequencyEncoder,
    params: FringeParams,
    target: ProjectorTarget,
    periods: Sequence[float],
    steps: Sequence[int],
    initial_phase_rad: float,
) -> PatternSequence:
    length = _length(target, params.orientation)
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
            images.append(_image(grey, params))
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


def _image(grey: UInt8Array, params: FringeParams) -> UInt8Array:
    """Return one row or column; coloured light has three channels, so that it cannot be mistaken."""
    line = grey.reshape((1, -1, 1) if params.orientation == "columns" else (-1, 1, 1))
    if params.channel == "white":
        return line
    image = np.zeros((*line.shape[:2], 3), np.uint8)
    image[:, :, _CHANNELS[params.channel]] = line[:, :, 0]
    return image
