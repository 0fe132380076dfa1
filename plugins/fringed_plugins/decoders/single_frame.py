"""What the single-frame decoders share: which frame carries the fringes, and the arrays the algorithms take.

Owns the choice among a set's frames, the transposition of fringes along rows, and masks as a PhaseMap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from msgspec import Meta

from fringed.data import Array, Float32Array, FrameSet, PatternFrame, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Params
from fringed_plugins.decoders.common import full_scale_dn, projector_size_px

if TYPE_CHECKING:
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.single_frame.bands import Band
    from fringed_plugins.phase.single_frame.fourier import FrameLimits, SingleFrame

_ONE = {"units": "1"}


class SingleFrameParams(Params, frozen=True, kw_only=True):
    """What the single-frame decoders have in common."""

    carrier_period_px: Annotated[
        float,
        Meta(ge=0, le=4096, description="period in the picture; 0: search it", extra_json_schema={"units": "px"}),
    ] = 0.0
    rises: Annotated[
        bool, Meta(description="projector columns rise to the right (rows downwards) in the picture; false: mirrored")
    ] = True
    min_modulation_dn: Annotated[
        float,
        Meta(ge=0, le=65535, description="smallest modulation, for 8 bits", extra_json_schema={"units": "grey level"}),
    ] = 3.0
    min_modulation_snr: Annotated[
        float, Meta(ge=0, le=1e4, description="smallest modulation over the noise of a frame", extra_json_schema=_ONE)
    ] = 2.0
    max_misfit: Annotated[
        float,
        Meta(gt=0, le=10, description="largest part of the fringes that the filter leaves", extra_json_schema=_ONE),
    ] = 0.35
    min_support: Annotated[
        float, Meta(ge=0, le=1, description="part of a pixel's surroundings that must have been measured")
    ] = 0.75


@dataclass(frozen=True)
class Fringes:
    """One frame's fringes along the second axis, float32; with what was measured of the background, or None.

    `variances` is the noise variance of `light` over that of one exposure.
    """

    light: Float32Array
    background: Float32Array | None
    saturated: Array
    frame: PatternFrame
    variances: float = 1.0


def fringes_of(frame_set: FrameSet, wanted: int, pair: bool = True) -> Fringes:
    """Return the fringes of frame `wanted` of the finest period, without their background where a second frame tells.

    That is one of the same fringes shifted by pi, or a uniform one.

    Raises
    ------
    DataError
        no such frame.
    """
    frames = frame_set.sequence.frames
    finest = _finest(frames)
    if wanted >= len(finest):
        raise DataError(
            f"frame {wanted} of the finest fringes is wanted; the set has {len(finest)}: 0 to {len(finest) - 1}"
        )
    index = finest[wanted]
    chosen = frames[index]
    images = frame_set.frames if chosen.orientation == "columns" else frame_set.frames.transpose(0, 2, 1)
    full = full_scale_dn(frame_set)
    image = np.ascontiguousarray(images[index], np.float32)
    saturated = images[index] >= full
    opposite = _opposite(frames, finest, chosen) if pair else None
    if opposite is not None:
        other = np.ascontiguousarray(images[opposite], np.float32)
        mean: Float32Array = (image + other) * np.float32(0.5)
        return Fringes(image, mean, saturated | (images[opposite] >= full), chosen, 0.5)
    flat = [i for i, frame in enumerate(frames) if frame.style == "uniform" and frame.channel == chosen.channel]
    if flat and pair:
        other = np.ascontiguousarray(images[flat[0]], np.float32)
        return Fringes(image, other, saturated | (images[flat[0]] >= full), chosen, 2.0)
    return Fringes(image, None, saturated, chosen)


def _finest(frames: Sequence[PatternFrame]) -> list[int]:
    periodic = [i for i, frame in enumerate(frames) if frame.style == "sinusoidal" and frame.period_px > 0]
    if not periodic:
        styles = sorted({frame.style for frame in frames})
        raise DataError(
            f"no frame has sinusoidal fringes; the set's styles are {', '.join(styles)}: "
            "take one with encoder 'fourier'"
        )
    least = min(frames[i].period_px for i in periodic)
    return [i for i in periodic if frames[i].period_px < least * (1 + 1e-6)]


def _opposite(frames: Sequence[PatternFrame], finest: Sequence[int], chosen: PatternFrame) -> int | None:
    for index in finest:
        apart = np.exp(1j * (frames[index].shift_rad - chosen.shift_rad))
        same = (frames[index].orientation, frames[index].channel, frames[index].level) == (
            chosen.orientation, chosen.channel, chosen.level,
        )  # fmt: skip
        if same and abs(apart + 1) < 1e-6:
            return index
    return None


def band_of(fringes: Fringes, frame_set: FrameSet, params: Any) -> Band:
    """Return the band around the carrier: named, or searched near what an equal field of view would show.

    Raises
    ------
    DataError
        no carrier, or one that cannot be filtered.
    """
    from fringed_plugins.phase.single_frame.bands import band_around, find_carrier

    given = float(params.carrier_period_px)
    try:
        if given:
            carrier = (1 / given, 0.0)
        else:
            periods = projector_size_px(frame_set.sequence) / fringes.frame.period_px
            picture = fringes.light if fringes.background is None else fringes.light - fringes.background
            carrier = find_carrier(picture, periods / fringes.light.shape[1])
        return band_around(
            carrier, params.bandwidth, params.cross_bandwidth, 0.0 if params.window == "hann" else params.flat
        )
    except ValueError as error:
        raise DataError(f"the set {frame_set.id or 'without id'}: {error}") from error


def frame_limits(frame_set: FrameSet, params: SingleFrameParams) -> FrameLimits:
    """Return the limits in the frames' own grey levels."""
    from fringed_plugins.phase.single_frame.fourier import FrameLimits

    return FrameLimits(
        modulation_dn=params.min_modulation_dn * full_scale_dn(frame_set) / 255,
        modulation_snr=params.min_modulation_snr,
        misfit=params.max_misfit,
        support=params.min_support,
    )


def frame_noise_model(frame_set: FrameSet, light: Float32Array) -> NoiseModel:
    """Return the camera's noise model, estimated from the frame itself where the settings do not know it."""
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.single_frame.fourier import frame_noise

    settings = frame_set.settings
    if settings.electrons_per_dn > 0:
        return NoiseModel.from_sensor(settings.electrons_per_dn, settings.read_noise_electrons)
    return frame_noise(light)


def mirrored(values: Array, rises: bool) -> Array:
    """Return `values` with the axis of the phase turned round where the picture is mirrored."""
    return values if rises else values[:, ::-1]


def phase_map_of_frame(found: SingleFrame, fringes: Fringes, frame_set: FrameSet, rises: bool) -> PhaseMap:
    """Return the decoded frame as a wrapped PhaseMap."""
    frame = fringes.frame
    arrays = [mirrored(array, rises) for array in found]
    if frame.orientation == "rows":
        arrays = [array.T for array in arrays]
    phase, sigma, modulation, background, rejected = arrays
    return PhaseMap(
        phase_rad=phase,
        modulation=modulation,
        background=background,
        rejected=rejected,
        kind="wrapped",
        period_px=frame.period_px,
        orientation=frame.orientation,
        initial_phase_rad=frame.initial_phase_rad,
        sigma_rad=sigma,
        projector_px=projector_size_px(frame_set.sequence),
    )
