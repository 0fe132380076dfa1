"""What all decoders share: parameters, and the contract's types as the algorithms want them.

Owns the translation of a FrameSet into groups, noise model and thresholds, and of arrays into a PhaseMap;
the algorithms in `phase` are imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from msgspec import Meta

from fringed.data import Array, CameraSettings, FrameSet, PatternFrame, PatternSequence, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import FrameSetStart
from fringed_plugins.decoders.masks import MaskParams, mask_limits

if TYPE_CHECKING:
    from fringed_plugins.phase.decoded import Decoded, Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group

_ONE = {"units": "1"}
_SPREAD = 1.15  # of a gamma beyond 1, over the picture: blur damps harmonics unevenly


class DecoderParams(MaskParams, frozen=True, kw_only=True):
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
    max_gamma: Annotated[
        float,
        Meta(
            ge=1, le=4, description="gamma of a projector up to which its harmonics are no misfit, where the patterns "
            "do not undo it; 1: it is linear", extra_json_schema=_ONE,
        ),
    ] = 2.6  # fmt: skip
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


def full_scale_dn(source: FrameSet | FrameSetStart) -> float:
    """Return the grey level of a saturated pixel, of a set or of one that begins."""
    kind = source.frames.dtype if isinstance(source, FrameSet) else np.dtype(source.dtype)
    if kind == np.uint8:
        return 255.0
    bits = source.settings.bits
    return float(2 ** (bits if bits > 8 else 16) - 1)


def thresholds(source: FrameSet | FrameSetStart, params: DecoderParams) -> Thresholds:
    """Return the thresholds in the frames' own grey levels."""
    from fringed_plugins.phase.decoded import Thresholds

    full = full_scale_dn(source)
    return Thresholds(
        saturation_dn=full,
        modulation_dn=params.min_modulation_dn * full / 255,
        modulation_snr=params.min_modulation_snr,
        residual=params.max_residual,
        gamma=1.0 if source.sequence.precompensated else params.max_gamma,
        similar_neighbours=params.min_similar_neighbours,
        border_glow=params.min_border_modulation,
        masks=mask_limits(params, full),
    )


def as_seen(limits: Thresholds, frames: Array, groups: Sequence[Group]) -> Thresholds:
    """Return the thresholds with the gamma that the frames show, at most the one allowed."""
    from fringed_plugins.phase.tone import gamma_of

    if limits.gamma <= 1 or not groups:
        return limits
    seen = gamma_of(frames, groups, limits.gamma)
    return replace(limits, gamma=min(1 + _SPREAD * (seen - 1), limits.gamma))


def known_noise(settings: CameraSettings) -> NoiseModel | None:
    """Return the noise that the camera's settings tell, or None."""
    from fringed_plugins.phase.noise import NoiseModel

    if settings.electrons_per_dn > 0:
        return NoiseModel.from_sensor(settings.electrons_per_dn, settings.read_noise_electrons)
    return None


def sensor_noise(frame_set: FrameSet, group: Group) -> NoiseModel:
    """Return the camera's noise model, estimated from the group's frames where the settings do not know it."""
    from fringed_plugins.phase.noise import estimate_noise

    known = known_noise(frame_set.settings)
    orientation = frame_set.sequence.frames[group.frames[0]].orientation
    return known if known is not None else estimate_noise(frame_set.frames, group, orientation)


def phase_map_of(decoded: Decoded, kind: Any, group: Group, frame_set: FrameSet) -> PhaseMap:
    """Return the decoded arrays as a PhaseMap of `group`."""
    sequence = frame_set.sequence
    first: PatternFrame = sequence.frames[group.frames[0]]
    return PhaseMap(
        phase_rad=decoded.phase_rad,
        modulation=decoded.modulation,
        background=decoded.background,
        rejected=decoded.rejected,
        kind=kind,
        period_px=group.period_px,
        orientation=first.orientation,
        initial_phase_rad=group.initial_rad,
        projector_px=sequence.width_px if first.orientation == "columns" else sequence.height_px,
        sigma_rad=decoded.sigma_rad,
        wrapped_rad=decoded.wrapped_rad if decoded.wrapped_rad.size else None,
        confidence=decoded.confidence if decoded.confidence.size else None,
    )
