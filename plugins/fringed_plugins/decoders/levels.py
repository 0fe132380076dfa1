"""Decoding of a set that shows its fringes with several amounts of light, and their fusion.

Owns the choice of each level's frames; decoding and fusion are those of their own processors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from fringed import __version__
from fringed.data import FrameSet, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.common import checked_frames
from fringed_plugins.decoders.fusion import FuseExposures


class FuseLevels:
    """One phase map of a set whose fringes are projected with several `levels` of light.

    Each level's frames are decoded by themselves, and the maps fused as `fuse-exposures` does. Against several
    exposures it needs no other camera settings, but ambient light is not dimmed, and dark parts win nothing: the
    brightest level is what a single set would have.
    """

    name: ClassVar[str] = "fuse-levels"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a set with several levels of light to one phase map"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(FuseExposures.Params, frozen=True, kw_only=True):
        """Parameters: those of the fusion, and the decoder of each level."""

        decoder: Annotated[
            Literal["phase-shift", "multi-frequency", "heterodyne", "number-theoretic"],
            Meta(description="what decodes the frames of each level"),
        ] = "multi-frequency"
        decoder_params: Annotated[dict[str, Any], Meta(description="the decoder's parameters")] = msgspec.field(
            default_factory=dict
        )

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the fused map.

        Raises
        ------
        DataError
            a set with one level only, or frames that the decoder cannot read.
        """
        from fringed.config import validate

        frame_set = checked_frames(inputs, self.name)
        levels = sorted({frame.level for frame in frame_set.sequence.frames}, reverse=True)
        if len(levels) < 2:
            raise DataError(
                f"the set {frame_set.id or 'without id'} has the level {levels[0]:g} only; project several, such as "
                "levels = [1.0, 0.25], or decode it without fusion"
            )
        decoder = _decoder(params.decoder)
        chosen = validate(params.decoder_params, decoder.Params, f"{self.name}.decoder_params")
        maps = []
        for index, level in enumerate(levels):
            context.progress(index / (len(levels) + 1), f"level {level:g}")
            maps.append(decoder().run({"frames": level_of(frame_set, level)}, chosen, context))
        names = FuseExposures.Params.__struct_fields__
        fusion = FuseExposures.Params(**{name: getattr(params, name) for name in names})
        return FuseExposures().run({"maps": tuple(maps)}, fusion, context)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        FuseExposures.warm_up()


def level_of(frame_set: FrameSet, level: float) -> FrameSet:
    """Return the frames of one level as a set of their own, with the same identity."""
    chosen = [i for i, frame in enumerate(frame_set.sequence.frames) if frame.level == level]
    sequence = frame_set.sequence
    return replace(
        frame_set,
        frames=frame_set.frames[chosen],
        sequence=replace(
            sequence,
            frames=tuple(sequence.frames[i] for i in chosen),
            patterns=tuple(sequence.patterns[i] for i in chosen),
        ),
        stamps=tuple(frame_set.stamps[i] for i in chosen) if frame_set.stamps else (),
    )


def _decoder(name: str) -> Any:
    from fringed_plugins.decoders.heterodyne import HeterodyneDecoder
    from fringed_plugins.decoders.number_theoretic import NumberTheoreticDecoder
    from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder

    known = (PhaseShiftDecoder, MultiFrequencyDecoder, HeterodyneDecoder, NumberTheoreticDecoder)
    return next(decoder for decoder in known if decoder.name == name)
