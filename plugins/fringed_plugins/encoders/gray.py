"""Encoders of Gray code, alone and with phase-shifted fringes.

Owns their parameters and the order of their frames; the code is in `phase.projection.graycode`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import msgspec
from msgspec import Meta

from fringed import __version__
from fringed.data import Orientation, PatternFrame, PatternSequence, UInt8Array
from fringed.errors import UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.common import Fringe, FringeParams, Light, equal_shifts, fringes, length_px
from fringed_plugins.encoders.drawing import coloured
from fringed_plugins.encoders.lines import LineParams
from fringed_plugins.phase.projection import graycode, patterns

_PX = {"units": "px"}


class GrayCodeEncoder:
    """Gray code: as many frames as bits, their complements or a white and a black frame; no fringes.

    References
    ----------
    Inokuchi, Sato & Matsuda 1984; Gray 1953.
    """

    name: ClassVar[str] = "gray-code"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "Gray code bits, coarse to fine, each with its complement"
    decoders: ClassVar[tuple[str, ...]] = ("gray-code",)

    class Params(LineParams, frozen=True, kw_only=True):
        """Parameters."""

        cell_px: Annotated[
            float, Meta(ge=1, le=4096, description="width of a cell of the code", extra_json_schema=_PX)
        ] = 4.0
        threshold: Annotated[
            Literal["inverse", "white-black"],
            Meta(description="what a bit is compared with: its complement, or a white and a black frame"),
        ] = "inverse"
        channel: Light = "white"

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the bits of one group.

        Raises
        ------
        UsageError
            a code that cannot be shown or told apart, with the reason and what to use instead.
        """
        try:
            patterns.check_greys(params.grey_low, params.grey_high)
            size_px = length_px(target, params.orientation)
            code = graycode.Code(graycode.bits_needed(size_px, params.cell_px), params.cell_px)
            common = PatternFrame(style="gray", orientation=params.orientation, channel=params.channel)
            frames = _bits(common, code, params.threshold)
            graycode.check_code(code, size_px)
            images = [_image(frame, code, size_px, (params.grey_low, params.grey_high)) for frame in frames]
        except ValueError as error:
            raise UsageError(f"{self.name}: {error}") from error
        return PatternSequence(
            family=self.name,
            width_px=target.width_px,
            height_px=target.height_px,
            frames=tuple(frames),
            patterns=tuple(images),
            grey_low=params.grey_low,
            grey_high=params.grey_high,
            encoder=self.name,
            encoder_version=self.version,
            parameters=msgspec.to_builtins(params),
        )


class GrayPhaseShiftEncoder:
    """N-step fringes, and a Gray code that counts their half periods.

    Cells of half a period settle the boundary problem: a bit that is read wrongly at the edge of its stripe moves the
    code by one cell, and the period that the phase then fits best is still the right one (the complementary
    code of Zhang et al. 2012 does the same with whole periods and one bit more).

    References
    ----------
    Sansoni, Carocci & Rodella 1999; Zhang et al. 2012.
    """

    name: ClassVar[str] = "gray-phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N-step fringes and a Gray code of half their period"
    decoders: ClassVar[tuple[str, ...]] = ("gray-phase-shift",)

    class Params(FringeParams, frozen=True, kw_only=True):
        """Parameters."""

        period_px: Annotated[
            float, Meta(gt=0, le=4096, description="of the fringes; a cell of the code is half of it",
                        extra_json_schema=_PX)
        ] = 16.0  # fmt: skip
        steps: Annotated[int, Meta(ge=3, le=64, description="equal phase steps")] = 4
        threshold: Annotated[
            Literal["fringes", "inverse", "white-black"],
            Meta(description="what a bit is compared with: the fringes' mean, its complement, white and black frames"),
        ] = "fringes"

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return, for each orientation, the fringes and then the bits.

        Raises
        ------
        UsageError
            a combination that cannot be decoded, with the reason and what to use instead.
        """
        sequences = [
            self._encode(replace_orientation(params, orientation), target)
            for orientation in (("columns", "rows") if params.orientation == "both" else (params.orientation,))
        ]
        frames: list[PatternFrame] = []
        images: list[UInt8Array] = []
        for number, sequence in enumerate(sequences):
            frames += [replace(frame, group=frame.group + 2 * number) for frame in sequence.frames]
            images += sequence.patterns
        return replace(
            sequences[0], frames=tuple(frames), patterns=tuple(images), parameters=msgspec.to_builtins(params)
        )

    def _encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        assert params.orientation != "both"
        size_px = length_px(target, params.orientation)
        cell_px = params.period_px / 2

        def wanted(orientation: Orientation) -> list[Fringe]:
            patterns.check_steps(params.steps)
            patterns.check_period(size_px, size_px / params.period_px)
            if len(params.levels) > 1:
                raise ValueError(
                    f"levels {params.levels} of light; a Gray code has one: take several exposures instead"
                )
            return [Fringe(params.period_px, equal_shifts(params.steps))]

        sequence = fringes(self, params, target, wanted)
        try:
            code = graycode.Code(graycode.bits_needed(size_px, cell_px), cell_px)
            graycode.check_code(code, size_px)
        except ValueError as error:
            raise UsageError(f"{self.name}: {error}") from error
        common = PatternFrame(style="gray", orientation=params.orientation, group=1, channel=params.channel)
        bits = _bits(common, code, params.threshold)
        images = [_image(frame, code, size_px, (params.grey_low, params.grey_high)) for frame in bits]
        return replace(sequence, frames=(*sequence.frames, *bits), patterns=(*sequence.patterns, *images))


def replace_orientation(params: GrayPhaseShiftEncoder.Params, orientation: str) -> GrayPhaseShiftEncoder.Params:
    """Return the parameters for one orientation."""
    return msgspec.structs.replace(params, orientation=orientation)


def _bits(common: PatternFrame, code: graycode.Code, threshold: str) -> list[PatternFrame]:
    """Return the frames of a code, coarse to fine."""
    common = replace(common, period_px=code.period_px, initial_phase_rad=code.initial_rad, steps=code.bits)
    found = []
    for bit in range(code.bits):
        found.append(replace(common, step=bit, bit=bit))
        if threshold == "inverse":
            found.append(replace(common, step=bit, bit=bit, inverted=True))
    if threshold == "white-black":
        found += [replace(common, step=code.bits), replace(common, step=code.bits, inverted=True)]
    return found


def _image(frame: PatternFrame, code: graycode.Code, size_px: int, greys: tuple[float, float]) -> UInt8Array:
    light = graycode.line(size_px, code, frame.bit, frame.inverted)
    grey = patterns.grey_levels(light, *greys)[None]
    return coloured(grey if frame.orientation == "columns" else grey.T, frame.channel)
