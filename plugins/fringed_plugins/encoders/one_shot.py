"""Encoders that put three patterns into one exposure, in red, green and blue; and the bars that measure the colours.

Owns their parameters; the rules are in `phase.single_frame.single_frame_rules`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import Channel, Orientation, PatternFrame, PatternSequence
from fringed.errors import UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.lines import Exposure, GreyParams, LineParams, length_px, sequence_of, uniform
from fringed_plugins.phase.projection import patterns
from fringed_plugins.phase.single_frame.single_frame_rules import check_carriers

CHANNELS: tuple[Channel, ...] = ("red", "green", "blue")
_WHITE_FRAME = Annotated[bool, Meta(description="a second exposure, all white: what coloured surfaces need")]


class OneShotPhaseShiftEncoder:
    """Three phase steps of one frequency in one exposure: red 0, green 2 pi/3, blue 4 pi/3.

    References
    ----------
    Huang, Hu, Jin & Chiang 1999 (colour-encoded fringes).
    """

    name: ClassVar[str] = "one-shot-phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "three phase steps in the colours of one exposure"
    decoders: ClassVar[tuple[str, ...]] = ("one-shot-phase-shift",)

    class Params(LineParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            float, Meta(gt=0, le=4096, description="across the projector", extra_json_schema={"units": "periods"})
        ] = 48.0
        initial_phase_rad: Annotated[
            float, Meta(ge=-7, le=7, description="phase of the first column", extra_json_schema={"units": "rad"})
        ] = 0.0
        white: _WHITE_FRAME = False

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the frames of one shot, and with `white` those of a second one.

        Raises
        ------
        UsageError
            a period that the projector cannot show.
        """
        length = length_px(target, params.orientation)
        try:
            patterns.check_period(length, params.periods)
        except ValueError as error:
            raise UsageError(f"{self.name}: {error}") from error
        frames, lights = [], []
        for step, channel in enumerate(CHANNELS):
            frames.append(
                PatternFrame(
                    style="sinusoidal",
                    orientation=params.orientation,
                    period_px=length / params.periods,
                    shift_rad=2 * np.pi * step / 3,
                    initial_phase_rad=params.initial_phase_rad,
                    step=step,
                    steps=3,
                    channel=channel,
                    shot=0,
                )
            )
            phase = params.initial_phase_rad + frames[-1].shift_rad
            lights.append(patterns.sinusoid(length, frames[-1].period_px, phase))
        exposures = [Exposure(tuple(frames), tuple(lights))]
        if params.white:
            exposures.append(_uniform_shot(params.orientation, 1, length, (1.0, 1.0, 1.0)))
        return sequence_of(self, params, target, exposures)


class OneShotFrequenciesEncoder:
    """Three carriers in one exposure, one in each colour: an absolute phase from a single frame.

    References
    ----------
    Zhang, Towers & Towers 2006 (colour-multiplexed multi-frequency fringes); Takeda & Mutoh 1983.
    """

    name: ClassVar[str] = "one-shot-frequencies"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "three frequencies in the colours of one exposure"
    decoders: ClassVar[tuple[str, ...]] = ("one-shot-frequencies",)

    class Params(LineParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            list[Annotated[int, Meta(ge=1, le=4096)]],
            Meta(min_length=3, max_length=3, description="across the projector, in red, green and blue, rising"),
        ] = msgspec.field(default_factory=lambda: [40, 59, 96])
        expected_phase_noise_rad: Annotated[
            float,
            Meta(gt=0, le=1, description="of one filtered carrier, for the choice of periods",
                 extra_json_schema={"units": "rad"}),
        ] = 0.05  # fmt: skip

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the three frames of one shot, a group each.

        Raises
        ------
        UsageError
            periods whose bands overlap, or whose fringe orders noise would make wrong.
        """
        length = length_px(target, params.orientation)
        try:
            check_carriers(length, params.periods, params.expected_phase_noise_rad)
        except ValueError as error:
            raise UsageError(f"{self.name}: {error}") from error
        frames, lights = [], []
        for group, (channel, number) in enumerate(zip(CHANNELS, params.periods, strict=True)):
            frames.append(
                PatternFrame("sinusoidal", params.orientation, length / number, group=group, channel=channel, shot=0)
            )
            lights.append(patterns.sinusoid(length, length / number, 0.0))
        return sequence_of(self, params, target, [Exposure(tuple(frames), tuple(lights))])


class ColourBarsEncoder:
    """Black, red, green, blue and white, each in the camera's three channels: what the crosstalk is measured from.

    References
    ----------
    Caspi, Kiryati & Shamir 1998 (colour crosstalk as a 3 x 3 matrix).
    """

    name: ClassVar[str] = "colour-bars"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "uniform black, red, green, blue and white, for the colour crosstalk"
    decoders: ClassVar[tuple[str, ...]] = ("crosstalk",)

    class Params(GreyParams, frozen=True, kw_only=True):
        """Parameters. A grey, not coloured, surface in view; no pixel saturated in white."""

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return five shots of three frames.

        Raises
        ------
        UsageError
            grey levels without contrast.
        """
        colours = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1))
        shots = [_uniform_shot("columns", shot, target.width_px, lights) for shot, lights in enumerate(colours)]
        return sequence_of(self, params, target, shots)


def _uniform_shot(orientation: Orientation, shot: int, length: int, lights: Sequence[float]) -> Exposure:
    """Return the frames of a uniform picture, a group of their own."""
    frames = tuple(
        PatternFrame("uniform", orientation, step=step, group=shot, channel=channel, shot=shot)
        for step, channel in enumerate(CHANNELS)
    )
    return Exposure(frames, tuple(uniform(length, light) for light in lights))
