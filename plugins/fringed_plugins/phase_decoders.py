"""Decoders of the fringe methods: a FrameSet to a PhaseMap.

Owns parameters and the translation between the contract's types and arrays; the kernels are in
`phase`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import CameraSettings, FrameSet, PatternFrame, PatternSequence, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context, Params

if TYPE_CHECKING:
    from fringed_plugins.phase.decode import Decoded, Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group

_ONE = {"units": "1"}


class DecoderParams(Params, frozen=True, kw_only=True):
    """When a pixel is dropped."""

    min_modulation_dn: Annotated[
        float,
        Meta(ge=0, le=65535, description="smallest modulation, for 8 bits", extra_json_schema={"units": "grey level"}),
    ] = 3.0
    min_modulation_snr: Annotated[
        float, Meta(ge=0, le=1e4, description="smallest modulation over the noise of a frame", extra_json_schema=_ONE)
    ] = 5.0
    max_residual: Annotated[
        float,
        Meta(gt=0, le=10, description="largest misfit to a sinusoid over the modulation", extra_json_schema=_ONE),
    ] = 0.1
    min_similar_neighbours: Annotated[
        int, Meta(ge=0, le=24, description="of 24 neighbours, those that must be alike; 0: off", extra_json_schema=_ONE)
    ] = 6
    min_border_modulation: Annotated[
        float,
        Meta(
            ge=0,
            le=1,
            description="modulation over the brightest neighbour's, at the border of what is lit; 0: off",
            extra_json_schema=_ONE,
        ),
    ] = 0.4
    keep_wrapped: Annotated[bool, Meta(description="keep the finest wrapped phase too, for pictures")] = False


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
        return _phase_map(decoded, "wrapped", chosen, frame_set)

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
        from dataclasses import replace

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
        return _phase_map(decoded, "absolute", groups[-1], frame_set)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        warm_up_kernels()


def checked_frames(inputs: Mapping[str, Any], name: str) -> FrameSet:
    """Return the input "frames".

    Raises
    ------
    DataError
        it is missing, or no frame set.
    """
    frame_set = inputs.get("frames")
    if not isinstance(frame_set, FrameSet):
        raise DataError(f"{name} decodes a FrameSet named 'frames'; it was given {type(frame_set).__name__}")
    return frame_set


def sinusoidal_groups(sequence: PatternSequence) -> list[Group]:
    """Return the groups of a sequence, coarse to fine.

    Raises
    ------
    DataError
        patterns that are no sinusoids of one orientation.
    """
    from fringed_plugins.phase.shifts import groups_of

    orientations = {frame.orientation for frame in sequence.frames}
    if len(orientations) > 1:
        raise DataError("the set has fringes along columns and along rows; decode them one after the other")
    try:
        return groups_of(sequence.frames, sequence.groups())
    except ValueError as error:
        raise DataError(f"patterns of family {sequence.family!r}: {error}") from error


def projector_size_px(sequence: PatternSequence) -> int:
    """Return the projector's width for columns, its height for rows."""
    return sequence.width_px if sequence.frames[0].orientation == "columns" else sequence.height_px


def full_scale_dn(frame_set: FrameSet) -> float:
    """Return the grey level of a saturated pixel."""
    if frame_set.frames.dtype == np.uint8:
        return 255.0
    bits = frame_set.settings.bits
    return float(2 ** (bits if bits > 8 else 16) - 1)


def thresholds(frame_set: FrameSet, params: DecoderParams) -> Thresholds:
    """Return the thresholds in the frames' own grey levels."""
    from fringed_plugins.phase.decode import Thresholds

    full = full_scale_dn(frame_set)
    return Thresholds(
        saturation_dn=full,
        modulation_dn=params.min_modulation_dn * full / 255,
        modulation_snr=params.min_modulation_snr,
        residual=params.max_residual,
        similar_neighbours=params.min_similar_neighbours,
        border_glow=params.min_border_modulation,
    )


def sensor_noise(frame_set: FrameSet, group: Group) -> NoiseModel:
    """Return the camera's noise model, estimated from the frames where the settings do not know it."""
    from fringed_plugins.phase.noise import NoiseModel, estimate_noise

    settings: CameraSettings = frame_set.settings
    if settings.electrons_per_dn > 0:
        return NoiseModel.from_sensor(settings.electrons_per_dn, settings.read_noise_electrons)
    return estimate_noise(frame_set.frames, group, frame_set.sequence.frames[0].orientation)


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


def _phase_map(decoded: Decoded, kind: Any, group: Group, frame_set: FrameSet) -> PhaseMap:
    first: PatternFrame = frame_set.sequence.frames[0]
    return PhaseMap(
        phase_rad=decoded.phase_rad,
        modulation=decoded.modulation,
        background=decoded.background,
        rejected=decoded.rejected,
        kind=kind,
        period_px=group.period_px,
        orientation=first.orientation,
        initial_phase_rad=group.initial_rad,
        projector_px=projector_size_px(frame_set.sequence),
        sigma_rad=decoded.sigma_rad,
        wrapped_rad=decoded.wrapped_rad if decoded.wrapped_rad.size else None,
    )


def warm_up_kernels() -> None:
    """Compile or load the decoding kernels for 8-bit frames."""
    from fringed_plugins.phase.decode import Thresholds, decode
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group

    group = Group((0, 1, 2, 3), tuple(np.arange(4) * np.pi / 2), 8.0)
    decode(np.zeros((4, 8, 8), np.uint8), [group], NoiseModel(1.0, 0.0), Thresholds(), threads=1)
