"""Decoders of Gray code, alone and with phase-shifted fringes.

Owns their parameters; the algorithms are in `phase.temporal`, imported when first used.
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


class GrayCodeDecoder:
    """Absolute phase of a Gray code alone: the middle of each pixel's cell, or the edge that it lies at.

    Its `sigma_rad` is that of a uniform distribution over the cell. Each bit is compared with its complement, or
    with the mean of a white and a black frame.

    References
    ----------
    Inokuchi, Sato & Matsuda 1984.
    """

    name: ClassVar[str] = "gray-code"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "Gray code to projector cells"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(JointParams, frozen=True, kw_only=True):
        """Parameters."""

        min_modulation_snr: Annotated[
            float, Meta(ge=0, le=1e4, description="smallest mean difference of bits over its noise",
                        extra_json_schema={"units": "1"})
        ] = 2.5  # fmt: skip

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the absolute phase, two cells a turn.

        Raises
        ------
        DataError
            no Gray code, or bits that nothing tells bright from dark.
        """
        frame_set = checked_frames(inputs, self.name)
        parts = parts_of(frame_set.sequence, params.orientation)
        bits = parts.bits
        if bits is None or parts.groups:
            raise DataError(f"{self.name} decodes a Gray code alone; use gray-phase-shift for one with fringes")

        def decode(noise: NoiseModel, limits: Thresholds, keep: Keep) -> Decoded:
            from fringed_plugins.phase.temporal.gray import decode_gray

            return decode_gray(frame_set.frames, bits, noise, limits, parts.size_px, threads=context.threads)

        return absolute_map(frame_set, parts, params, context, decode)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels for 8-bit frames."""
        warm_up_gray()


class GrayPhaseShiftDecoder:
    """Absolute phase of fringes whose periods a Gray code counts.

    Bits are compared with their complements, with white and black frames, or with the fringes' own mean light. Where a
    bit is weak the pixel lies at the edge of a stripe, which is a place as good as a cell. With fringes of
    several periods all phases help to choose the order, so that cells may be as wide as the longest period.

    References
    ----------
    Sansoni, Carocci & Rodella 1999; Zhang et al. 2012.
    """

    name: ClassVar[str] = "gray-phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N steps and a Gray code to an absolute phase"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(JointParams, frozen=True, kw_only=True):
        """Parameters."""

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the absolute phase.

        Raises
        ------
        DataError
            fringes or a code that are missing, or cells that cannot count the fringes.
        """
        frame_set = checked_frames(inputs, self.name)
        parts = parts_of(frame_set.sequence, params.orientation)
        bits = parts.bits
        if bits is None or not parts.groups:
            missing = "Gray code" if bits is None else "fringes"
            raise DataError(f"{self.name} decodes fringes and a Gray code; this set has no {missing}")

        def decode(noise: NoiseModel, limits: Thresholds, keep: Keep) -> Decoded:
            from fringed_plugins.phase.temporal.gray import decode_gray_fringes

            return decode_gray_fringes(
                frame_set.frames, parts.groups, bits, noise, limits, parts.size_px, keep=keep, threads=context.threads
            )

        return absolute_map(frame_set, parts, params, context, decode)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels for 8-bit frames."""
        warm_up_gray()


def warm_up_gray() -> None:
    """Compile or load the kernels of bits and of the orders that they give."""
    from fringed_plugins.phase.decoded import Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.projection.graycode import Code
    from fringed_plugins.phase.shifts import Group
    from fringed_plugins.phase.temporal.gray import decode_gray_fringes
    from fringed_plugins.phase.temporal.graybits import BitFrames

    group = Group((0, 1, 2, 3), tuple(np.arange(4) * np.pi / 2), 16.0)
    bits = BitFrames(Code(2, 8.0), (4, 5), (-1, -1))
    frames = np.full((6, 8, 8), 100, np.uint8)
    frames[::4] = 130
    decode_gray_fringes(frames, [group], bits, NoiseModel(400.0, 0.0), Thresholds(), 32, threads=1)
