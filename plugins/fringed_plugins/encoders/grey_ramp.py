"""Encoder of uniform grey pictures that tell the projector's tone curve.

Owns their order: shuffled, so that a lamp that drifts does not look like tone, with black and white again and again.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import PatternFrame, PatternSequence
from fringed.errors import UsageError
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.common import Light
from fringed_plugins.encoders.drawing import coloured

_LEAST_SPAN = 64.0


class GreyRampEncoder:
    """Uniform pictures of many grey levels, for `tone-response`.

    Nothing is compensated, whatever the calibration says: what is measured is the projector itself. A uniform picture
    is the same however the projector is focused.

    References
    ----------
    Guo, He & Chen 2004; Zhang & Yau 2007, section 3.
    """

    name: ClassVar[str] = "grey-ramp"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "uniform pictures of many grey levels, to measure the projector's tone curve"
    decoders: ClassVar[tuple[str, ...]] = ("tone-response",)

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        levels: Annotated[
            int, Meta(ge=9, le=256, description="grey levels, both ends among them", extra_json_schema={"units": "1"})
        ] = 33
        repeats: Annotated[
            int,
            Meta(ge=2, le=64, description="how often black and white come again", extra_json_schema={"units": "1"}),
        ] = 7
        grey_low: Annotated[
            float, Meta(ge=0, le=255, description="darkest grey level", extra_json_schema={"units": "grey level"})
        ] = 0.0
        grey_high: Annotated[
            float, Meta(ge=0, le=255, description="brightest grey level", extra_json_schema={"units": "grey level"})
        ] = 255.0
        channel: Light = "white"
        seed: Annotated[int, Meta(ge=0, le=2**31, description="of the levels' order")] = 1

    def encode(self, params: Params, target: ProjectorTarget) -> PatternSequence:
        """Return the pictures, each of one pixel that stands for the whole panel.

        Raises
        ------
        UsageError
            a range too narrow for its levels.
        """
        span = params.grey_high - params.grey_low
        if span < max(_LEAST_SPAN, params.levels - 1):
            raise UsageError(
                f"grey-ramp: {params.levels} levels from {params.grey_low:g} to {params.grey_high:g}; a tone curve "
                f"needs a range of {_LEAST_SPAN:g} or more, and a grey level for each: use 0 to 255"
            )
        greys = _order(params)
        frames = tuple(
            PatternFrame("grey", group=index, step=index, channel=params.channel) for index in range(len(greys))
        )
        pictures = tuple(coloured(np.full((1, 1), grey, np.uint8), params.channel) for grey in greys)
        return PatternSequence(
            family=self.name,
            width_px=target.width_px,
            height_px=target.height_px,
            frames=frames,
            patterns=pictures,
            grey_low=params.grey_low,
            grey_high=params.grey_high,
            encoder=self.name,
            encoder_version=self.version,
            parameters=msgspec.to_builtins(params),
        )


def _order(params: GreyRampEncoder.Params) -> list[int]:
    """Return the grey level of each picture: levels shuffled, black and white spread evenly among them."""
    levels = np.rint(np.linspace(params.grey_low, params.grey_high, params.levels)).astype(int)
    shuffled = np.random.default_rng(params.seed).permutation(levels[1:-1])
    ends = [int(levels[-1]), int(levels[0])]
    parts = np.array_split(shuffled, params.repeats - 1)
    return [*ends, *(int(grey) for part in parts for grey in (*part, *ends))]
