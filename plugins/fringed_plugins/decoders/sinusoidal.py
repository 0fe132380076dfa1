"""Decoders of sinusoidal fringes: N known steps of one frequency, and of several from coarse to fine.

Owns their parameters; the kernels are in `phase`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import Array, FrameSet, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context, FrameSetStart
from fringed_plugins.decoders.common import (
    DecoderParams,
    checked_frames,
    phase_map_of,
    projector_size_px,
    sensor_noise,
    sinusoidal_groups,
    thresholds,
)

if TYPE_CHECKING:
    from fringed_plugins.phase.decoded import Decoded, Thresholds
    from fringed_plugins.phase.shifts import Group


class PhaseShiftDecoder:
    """Wrapped phase of one group of N known shifts, by least squares.

    The standard deviation is sigma_frame sqrt(2/N) / modulation; sigma_frame^2 is read noise, shot noise
    and quantisation from the camera's settings, or estimated from the frames where these are unknown.

    References
    ----------
    Greivenkamp 1984; thesis.md, section 2.
    """

    name: ClassVar[str] = "phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N steps of one frequency to a wrapped phase"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(DecoderParams, frozen=True, kw_only=True):
        """Parameters."""

        group: Annotated[
            int, Meta(ge=-1, le=63, description="frequency to decode, coarse to fine; -1: the finest")
        ] = -1  # fmt: skip

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the wrapped phase.

        Raises
        ------
        DataError
            frames that are no sinusoids, or a group that is not there.
        """
        frame_set = checked_frames(inputs, self.name)
        groups = sinusoidal_groups(frame_set.sequence)
        if params.group >= len(groups):
            raise DataError(f"group {params.group} is wanted; the set has {len(groups)}: 0 to {len(groups) - 1}, or -1")
        chosen = groups[params.group]
        decoded = _decode(frame_set, [chosen], thresholds(frame_set, params), None, params.keep_wrapped, context)
        return phase_map_of(decoded, "wrapped", chosen, frame_set)

    def begin(self, start: FrameSetStart, params: Params, context: Context) -> FrameSumSink:
        """Return what takes the frames while they arrive.

        Raises
        ------
        DataError
            as `run` does for the sequence.
        """
        sinusoidal_groups(start.sequence)
        return FrameSumSink(self, params)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        warm_up_kernels()


class MultiFrequencyDecoder:
    """Absolute phase of several frequencies, unwrapped in time from coarse to fine.

    Every pixel stands by itself, so steps and shadows do no harm. A pixel is dropped where a coarse
    phase and the next finer one contradict each other (`FRINGE_ORDER`), where the phase is not on the
    projector (`OUT_OF_RANGE`), and where its neighbours are all different (`ISOLATED`).

    References
    ----------
    Zuo et al. 2016, section 3; Greivenkamp 1984.
    """

    name: ClassVar[str] = "multi-frequency"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N steps of several frequencies to an absolute phase"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(DecoderParams, frozen=True, kw_only=True):
        """Parameters."""

        max_order_error: Annotated[
            float,
            Meta(
                gt=0,
                le=0.5,
                description="largest difference of a predicted and a measured phase",
                extra_json_schema={"units": "periods"},
            ),
        ] = 0.3
        min_modulation_ratio: Annotated[
            float,
            Meta(ge=0, le=1, description="finest over coarsest modulation: less is a mixed pixel; 0: off"),
        ] = 0.2
        edge_px: Annotated[
            float,
            Meta(
                ge=0,
                le=100,
                description="columns dropped at the projector's border",
                extra_json_schema={"units": "px"},
            ),
        ] = 0.5

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the absolute phase.

        Raises
        ------
        DataError
            frames that are no sinusoids, or frequencies that cannot be unwrapped.
        """
        frame_set = checked_frames(inputs, self.name)
        groups = sinusoidal_groups(frame_set.sequence)
        limits = replace(
            thresholds(frame_set, params),
            order_turns=params.max_order_error,
            modulation_drop=params.min_modulation_ratio,
            edge_px=params.edge_px,
        )
        size_px = projector_size_px(frame_set.sequence)
        decoded = _decode(frame_set, groups, limits, size_px, params.keep_wrapped, context)
        return phase_map_of(decoded, "absolute", groups[-1], frame_set)

    def begin(self, start: FrameSetStart, params: Params, context: Context) -> FrameSumSink:
        """Return what takes the frames while they arrive.

        Raises
        ------
        DataError
            as `run` does for the sequence.
        """
        sinusoidal_groups(start.sequence)
        return FrameSumSink(self, params)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        warm_up_kernels()


class FrameSumSink:
    """The state of one run that takes its frames while they arrive."""

    def __init__(self, decoder: PhaseShiftDecoder | MultiFrequencyDecoder, params: Any) -> None:
        self._decoder = decoder
        self._params = params

    def add(self, index: int, image: Array) -> None:
        """Take frame `index`."""

    def finish(self, frame_set: FrameSet, context: Context) -> PhaseMap:
        """Return the phase map of the finished set."""
        return self._decoder.run({"frames": frame_set}, self._params, context)


def _decode(
    frame_set: FrameSet,
    groups: list[Group],
    limits: Thresholds,
    size_px: int | None,
    keep_wrapped: bool,
    context: Context,
) -> Decoded:
    from fringed_plugins.phase.decode import decode

    context.check_cancelled()
    try:
        return decode(
            frame_set.frames,
            groups,
            sensor_noise(frame_set, groups[-1]),
            limits,
            size_px,
            keep_wrapped=keep_wrapped,
            threads=context.threads,
        )
    except ValueError as error:
        raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error


def warm_up_kernels() -> None:
    """Compile or load the decoding kernels for 8-bit frames."""
    from fringed_plugins.phase.decode import decode
    from fringed_plugins.phase.decoded import Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group

    group = Group((0, 1, 2, 3), tuple(np.arange(4) * np.pi / 2), 8.0)
    decode(np.zeros((4, 8, 8), np.uint8), [group], NoiseModel(1.0, 0.0), Thresholds(), threads=1)
