"""Decoders of sinusoidal fringes: N known steps of one frequency, and of several from coarse to fine.

Owns their parameters; the kernels are in `phase`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import FrameSet, PatternSequence, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context, FrameSetStart
from fringed_plugins.decoders.absolute import JointParams, order_thresholds, parts_of
from fringed_plugins.decoders.common import (
    DecoderParams,
    as_seen,
    checked_frames,
    phase_map_of,
    sensor_noise,
    thresholds,
)
from fringed_plugins.decoders.streaming import SumsSink, Work

if TYPE_CHECKING:
    from fringed_plugins.phase.shifts import Group

Weights = Annotated[
    Literal["equal", "noise"],
    Meta(
        description="equal: frames in equal steps cancel harmonics; noise: darker frames count more, for the least "
        "phase noise of fringes whose tone curve is compensated"
    ),
]


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
        orientation: Annotated[
            Literal["auto", "columns", "rows"], Meta(description="fringes to decode; auto: the only ones there are")
        ] = "auto"
        weights: Weights = "equal"

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the wrapped phase.

        Raises
        ------
        DataError
            frames that are no fringes, or a group that is not there.
        """
        frame_set = checked_frames(inputs, self.name)
        return _decode(frame_set, _wrapped_work(frame_set, params), context)

    def begin(self, start: FrameSetStart, params: Params, context: Context) -> SumsSink:
        """Return what takes the frames while they arrive.

        Raises
        ------
        DataError
            as `run` does for the sequence.
        """
        return SumsSink(start, _wrapped_work(start, params), context)

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

    class Params(JointParams, frozen=True, kw_only=True):
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
        weights: Weights = "equal"

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the absolute phase.

        Raises
        ------
        DataError
            frames that are no fringes, or frequencies that cannot be unwrapped.
        """
        frame_set = checked_frames(inputs, self.name)
        return _decode(frame_set, _absolute_work(frame_set, params), context)

    def begin(self, start: FrameSetStart, params: Params, context: Context) -> SumsSink:
        """Return what takes the frames while they arrive.

        Raises
        ------
        DataError
            as `run` does for the sequence.
        """
        return SumsSink(start, _absolute_work(start, params), context)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        warm_up_kernels(absolute=True)


def _groups(sequence: PatternSequence, orientation: str) -> list[Group]:
    """Return the groups of fringes of one orientation, coarse to fine.

    Raises
    ------
    DataError
        there are none.
    """
    groups = parts_of(sequence, orientation).groups
    if not groups:
        raise DataError(f"patterns of family {sequence.family!r} have no group of fringes with a period")
    return groups


def _wrapped_work(source: FrameSet | FrameSetStart, params: PhaseShiftDecoder.Params) -> Work:
    from fringed_plugins.phase.decode import Keep

    groups = _groups(source.sequence, params.orientation)
    if params.group >= len(groups):
        raise DataError(f"group {params.group} is wanted; the set has {len(groups)}: 0 to {len(groups) - 1}, or -1")
    keep = Keep(wrapped=params.keep_wrapped)
    return Work((groups[params.group],), thresholds(source, params), None, keep, params.weights == "noise")


def _absolute_work(source: FrameSet | FrameSetStart, params: MultiFrequencyDecoder.Params) -> Work:
    from fringed_plugins.phase.decode import Keep

    parts = parts_of(source.sequence, params.orientation)
    groups = _groups(source.sequence, params.orientation)
    limits = replace(
        order_thresholds(source, params, source.sequence.frames[parts.first].orientation),
        order_turns=params.max_order_error,
        modulation_drop=params.min_modulation_ratio,
    )
    keep = Keep(wrapped=params.keep_wrapped, confidence=params.keep_confidence)
    return Work(tuple(groups), limits, parts.size_px, keep, params.weights == "noise")


def _decode(frame_set: FrameSet, work: Work, context: Context) -> PhaseMap:
    from fringed_plugins.phase.decode import decode
    from fringed_plugins.phase.noise import noise_group

    context.check_cancelled()
    noise = sensor_noise(frame_set, noise_group(work.groups))
    try:
        decoded = decode(
            frame_set.frames,
            work.groups,
            noise,
            as_seen(work.thresholds, frame_set.frames, work.groups),
            work.size_px,
            keep=work.keep,
            threads=context.threads,
        )
    except ValueError as error:
        raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error
    work.weigh(decoded, frame_set, noise, context.threads)
    return phase_map_of(decoded, work.kind, work.groups[-1], frame_set)


def warm_up_kernels(*, absolute: bool = False) -> None:
    """Compile or load the kernels of a wrapped or an absolute phase for 8-bit frames, streamed or whole."""
    from fringed_plugins.phase.accumulate import Accumulator
    from fringed_plugins.phase.decoded import Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group

    coarse = Group(tuple(range(5)), tuple(np.arange(5) * 2 * np.pi / 5), 8.0)
    fine = Group(tuple(range(5, 9)), tuple(np.arange(4) * np.pi / 2), 2.0)
    groups, size_px = ((coarse, fine), 8) if absolute else ((coarse,), None)
    limits, noise = Thresholds(window_snr=0.0), NoiseModel(1.0, 0.0)
    sums = Accumulator((8, 8), np.uint8, groups, limits, size_px, noise=noise, threads=1)
    for index in range(9):
        sums.add(index, np.zeros((8, 8), np.uint8))
    sums.finish()
