"""Encoder of a single frame with a carrier, for Fourier-transform profilometry.

Owns its parameters; the rules are in `phase.single_frame.single_frame_rules`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import Channel, Float64Array, PatternFrame, PatternSequence
from fringed.errors import UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.lines import COLOURS, Exposure, LineParams, length_px, sequence_of, uniform
from fringed_plugins.phase.projection import patterns
from fringed_plugins.phase.single_frame.single_frame_rules import check_carrier


class FourierEncoder:
    """One sinusoidal carrier; a second frame may take the background away.

    References
    ----------
    Takeda & Mutoh 1983; Li, Su & Guo 1990 (a second frame, shifted by pi).
    """

    name: ClassVar[str] = "fourier"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "one frame with a carrier, for moving objects"
    decoders: ClassVar[tuple[str, ...]] = ("fourier", "windowed-fourier")

    class Params(LineParams, frozen=True, kw_only=True):
        """Parameters."""

        periods: Annotated[
            float, Meta(gt=0, le=4096, description="across the projector", extra_json_schema={"units": "periods"})
        ] = 96.0
        initial_phase_rad: Annotated[
            float, Meta(ge=-7, le=7, description="phase of the first column", extra_json_schema={"units": "rad"})
        ] = 0.0
        background: Annotated[
            Literal["none", "inverse", "flat"],
            Meta(description="second frame that takes the background away: shifted by pi, uniform, or none"),
        ] = "none"
        channel: Annotated[Channel, Meta(description="the projector's light")] = "white"

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return one pattern, or two of which the second removes the background.

        Raises
        ------
        UsageError
            a carrier that no single frame can be decoded with, with the reason and what to use instead.
        """
        length = length_px(target, params.orientation)
        try:
            check_carrier(length, params.periods)
        except ValueError as error:
            raise UsageError(f"fourier: {error}") from error
        fringes = self._exposure(params, length, 0.0)
        if params.background == "none":
            return sequence_of(self, params, target, [fringes])
        second = self._exposure(params, length, np.pi) if params.background == "inverse" else self._flat(params, length)
        return sequence_of(self, params, target, [fringes, second])

    @staticmethod
    def _exposure(params: Params, length: int, shift_rad: float) -> Exposure:
        frame = PatternFrame(
            style="sinusoidal",
            orientation=params.orientation,
            period_px=length / params.periods,
            shift_rad=shift_rad,
            initial_phase_rad=params.initial_phase_rad,
            step=int(shift_rad > 0),
            steps=2 if params.background == "inverse" else 1,
            channel=params.channel,
            inverted=shift_rad > 0,
        )
        light = patterns.sinusoid(length, frame.period_px, params.initial_phase_rad + shift_rad)
        return Exposure((frame,), _coloured(light, params.channel))

    @staticmethod
    def _flat(params: Params, length: int) -> Exposure:
        frame = PatternFrame("uniform", params.orientation, group=1, channel=params.channel)
        return Exposure((frame,), _coloured(uniform(length, 0.5), params.channel))


def _coloured(light: Float64Array, channel: Channel) -> tuple[Float64Array | None, ...]:
    if channel == "white":
        return (light,)
    return tuple(light if colour == channel else None for colour in COLOURS)
