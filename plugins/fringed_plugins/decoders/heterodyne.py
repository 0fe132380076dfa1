"""Decoder of heterodyne sets: neighbouring frequencies whose beats are long.

Owns its parameters; the algorithm is in `phase.temporal`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import FrameSet, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.absolute import JointParams, absolute_map, parts_of
from fringed_plugins.decoders.common import checked_frames

if TYPE_CHECKING:
    from fringed_plugins.phase.decode import Keep
    from fringed_plugins.phase.decoded import Decoded, Thresholds
    from fringed_plugins.phase.noise import NoiseModel

_RAD = {"units": "rad"}


class HeterodyneDecoder:
    """Absolute phase of several frequencies by all of their beats at once.

    Each pixel takes the most likely of all fringe orders, given all phases and their noise; the phase returned is that
    of the finest frequency, averaged over all of them by their weights. A pixel is dropped where another order is
    almost as likely (`FRINGE_ORDER`), unless what surrounds it settles the order.

    References
    ----------
    Towers, Towers & Jones 2005; Reich, Ritter & Thesing 1997; Petkovic et al. 2017.
    """

    name: ClassVar[str] = "heterodyne"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N steps of neighbouring frequencies to an absolute phase, by their beats"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(JointParams, frozen=True, kw_only=True):
        """Parameters."""

        combine: Annotated[bool, Meta(description="average the phase over all frequencies by their weights")] = True
        systematic_rad: Annotated[
            float,
            Meta(ge=0, le=1, description="error of a phase that is no noise, such as ripples", extra_json_schema=_RAD),
        ] = 0.02

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the absolute phase.

        Raises
        ------
        DataError
            frames that are no sinusoids, or periods that leave columns which no phase tells apart.
        """
        frame_set = checked_frames(inputs, self.name)
        parts = parts_of(frame_set.sequence, params.orientation)
        if parts.bits is not None or not parts.groups:
            raise DataError(f"{self.name} decodes fringes; this set has a Gray code: use gray-phase-shift or gray-code")

        def decode(noise: NoiseModel, limits: Thresholds, keep: Keep) -> Decoded:
            from fringed_plugins.phase.temporal.absolute import decode_joint

            return decode_joint(
                frame_set.frames, parts.groups, noise, limits, parts.size_px,
                combine=params.combine, systematic_rad=params.systematic_rad, keep=keep, threads=context.threads,
            )  # fmt: skip

        return absolute_map(frame_set, parts, params, context, decode)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels for 8-bit frames."""
        warm_up_joint()


def warm_up_joint() -> None:
    """Compile or load the kernels of the search over all orders."""
    from fringed_plugins.phase.decoded import Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group
    from fringed_plugins.phase.temporal.absolute import decode_joint

    shifts = tuple(np.arange(4) * np.pi / 2)
    groups = [Group(tuple(range(4 * i, 4 * i + 4)), shifts, period) for i, period in enumerate((64 / 7, 64 / 8))]
    frames = np.full((8, 8, 8), 100, np.uint8)
    frames[::4] = 130
    decode_joint(frames, groups, NoiseModel(400.0, 0.0), Thresholds(), 64, threads=1)
