"""The colour crosstalk of a rig from uniform pictures, and what all decoders of colours share.

Owns parameters, the choice of a set's shots, and how crosstalk is kept in a Calibration; the arithmetic is in
`phase.colours.crosstalk` and `phase.colours.colour`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Array, Calibration, FrameSet, PatternSequence, Provenance
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.common import checked_frames, full_scale_dn

if TYPE_CHECKING:
    from fringed_plugins.phase.colours.colour import Colours
    from fringed_plugins.phase.colours.crosstalk import Crosstalk

CHANNELS = ("red", "green", "blue")
BLACK = "black_{}_dn"
_BARS = {(0, 0, 0): 0, (1, 0, 0): 1, (0, 1, 0): 2, (0, 0, 1): 3, (1, 1, 1): 4}


class MeasureCrosstalk:
    """Crosstalk of camera and projector colours from black, red, green, blue and white on a grey surface.

    The calibration that comes out is the one that went in, with `crosstalk`, and with its uncertainty and the black
    levels among the residuals. Unmixed channels are equal on the surface that was used: a grey one, please.

    References
    ----------
    Caspi, Kiryati & Shamir 1998.
    """

    name: ClassVar[str] = "crosstalk"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "colour crosstalk from uniform pictures, into the calibration"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet, "calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Calibration

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        max_additivity: Annotated[
            float, Meta(ge=0, le=1, description="white minus red, green and blue, over white, worth a warning")
        ] = 0.05

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Calibration:
        """Return the calibration with its crosstalk.

        Raises
        ------
        DataError
            a set without the five pictures in three channels, too little light, or channels that cannot be told apart.
        """
        from fringed_plugins.phase.colours.crosstalk import measure_crosstalk

        frame_set, calibration = checked_frames(inputs, self.name), inputs.get("calibration")
        if not isinstance(calibration, Calibration):
            raise DataError(f"{self.name} adds to a Calibration; it was given {type(calibration).__name__}")
        context.check_cancelled()
        try:
            found = measure_crosstalk(_bars(frame_set), full_scale_dn(frame_set))
        except ValueError as error:
            raise DataError(f"the crosstalk cannot be measured: {error}") from error
        _tell(found, params.max_additivity, context)
        return _with_crosstalk(calibration, found, frame_set)


def _bars(frame_set: FrameSet) -> Array:
    """Return frames (5, 3, height, width): black, red, green, blue, white in three channels."""
    places: dict[tuple[int, int], int] = {}
    sequence = frame_set.sequence
    for index, (frame, pattern) in enumerate(zip(sequence.frames, sequence.patterns, strict=True)):
        if frame.style != "uniform" or frame.channel not in CHANNELS:
            continue
        lit = [int(light > sequence.grey_low + 1) for light in pattern[0, 0]]
        bar = _BARS.get((lit[0], lit[-1] if len(lit) == 1 else lit[1], lit[-1]))  # a single channel is a grey
        if bar is not None:
            places[bar, CHANNELS.index(frame.channel)] = index
    if len(places) < 15:
        raise DataError(
            f"{len(places)} of the 15 frames (black, red, green, blue and white, each in three channels) are in the "
            "set; take them with encoder 'colour-bars' and camera channel 'rgb'"
        )
    return np.stack([np.stack([frame_set.frames[places[bar, c]] for c in range(3)]) for bar in range(5)])


def _tell(found: Crosstalk, most: float, context: Context) -> None:
    rows = "; ".join(" ".join(f"{value:.3f}" for value in row) for row in found.matrix)
    context.log(
        "info",
        f"crosstalk {rows} (standard error up to {found.sigma.max():.1g}, over the field {found.spread.max():.1g}), "
        f"condition {found.condition:.3g}",
    )
    if abs(found.additivity) > most:
        context.log(
            "warning",
            f"white is {found.additivity:+.1%} off the sum of red, green and blue; {most:.0%} is allowed: the "
            "projector does not add its colours (a white segment, or colour processing), so that unmixing holds for "
            "single colours only: switch such modes off",
        )


def _with_crosstalk(calibration: Calibration, found: Crosstalk, frame_set: FrameSet) -> Calibration:
    told = {
        "crosstalk_sigma": float(found.sigma.max()),
        "crosstalk_spread": float(found.spread.max()),
        "crosstalk_condition": found.condition,
        "crosstalk_additivity": found.additivity,
    }
    scale = 255 / full_scale_dn(frame_set)
    told |= {BLACK.format(name): float(level) * scale for name, level in zip(CHANNELS, found.black_dn, strict=True)}
    residuals = {**calibration.residuals, **told}
    return replace(calibration, crosstalk=found.matrix, residuals=residuals, id="", provenance=Provenance())


def colours_of(calibration: Calibration | None, frame_set: FrameSet, context: Context) -> Colours:
    """Return crosstalk and black levels as the algorithms take them; none, with a warning, where none is known.

    Black levels are kept for 8 bits and scaled to the set's grey levels.
    """
    from fringed_plugins.phase.colours.colour import Colours

    if calibration is None or calibration.crosstalk is None:
        context.log(
            "warning",
            "the colour crosstalk is unknown, and colours are taken as they are: measure it with encoder "
            "'colour-bars' and processor 'crosstalk'",
        )
        return Colours(np.eye(3))
    scale = full_scale_dn(frame_set) / 255
    red, green, blue = (float(calibration.residuals.get(BLACK.format(name), 0.0)) * scale for name in CHANNELS)
    return Colours(calibration.crosstalk, (red, green, blue))


def channel_places(sequence: PatternSequence, style: str) -> tuple[int, int, int] | None:
    """Return the indices of the first shot of that style, in red, green and blue; None where there is none.

    Raises
    ------
    DataError
        a shot that lacks a channel.
    """
    shots = [frame.shot for frame in sequence.frames if frame.style == style and frame.shot >= 0]
    if not shots:
        return None
    found = {f.channel: i for i, f in enumerate(sequence.frames) if f.shot == shots[0] and f.style == style}
    missing = [name for name in CHANNELS if name not in found]
    if missing:
        raise DataError(
            f"shot {shots[0]} has no frame in {', '.join(missing)}; take it with camera channel 'rgb', which "
            "delivers red, green and blue of one exposure"
        )
    return found["red"], found["green"], found["blue"]
