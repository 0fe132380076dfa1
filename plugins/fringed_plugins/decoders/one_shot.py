"""Decoders of one exposure whose colours carry three phase steps, or three frequencies.

Owns their parameters; the arithmetic is in `phase.colours`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import Array, Calibration, Float32Array, FrameSet, PatternFrame, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.colour import channel_places, colours_of
from fringed_plugins.decoders.common import (
    DecoderParams,
    checked_frames,
    full_scale_dn,
    phase_map_of,
    projector_size_px,
    thresholds,
)
from fringed_plugins.decoders.single_frame import SingleFrameParams, frame_limits, frame_noise_model

if TYPE_CHECKING:
    from fringed_plugins.phase.colours.colour import Balance, Colours
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group

_INPUTS: Mapping[str, Any] = {"frames": FrameSet, "calibration": Calibration}
_OPTIONAL = frozenset({"calibration"})


class OneShotPhaseShiftDecoder:
    """Wrapped phase of three steps in the colours of one exposure.

    Colours are unmixed with the calibration's crosstalk, then balanced: three steps in three colours are right
    only where the surface reflects them alike, or where that is divided out. By itself, balance takes a white
    frame where the set has one, else one factor for each channel of the whole picture.

    References
    ----------
    Huang, Hu, Jin & Chiang 1999; Caspi, Kiryati & Shamir 1998.
    """

    name: ClassVar[str] = "one-shot-phase-shift"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "three phase steps in the colours of one exposure to a wrapped phase"
    inputs: ClassVar[Mapping[str, Any]] = _INPUTS
    optional: ClassVar[frozenset[str]] = _OPTIONAL
    output: ClassVar[type] = PhaseMap

    class Params(DecoderParams, frozen=True, kw_only=True):
        """Parameters."""

        balance: Annotated[
            Literal["auto", "none", "global", "local", "white"],
            Meta(description="how a coloured surface is allowed for; auto: white where it was taken, else global"),
        ] = "auto"
        carrier_period_px: Annotated[
            float,
            Meta(ge=0, le=4096, description="period in the picture, for local balance; 0: search it",
                 extra_json_schema={"units": "px"}),
        ] = 0.0  # fmt: skip

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the wrapped phase.

        Raises
        ------
        DataError
            no shot in three channels, channels that cannot be told apart, or a balance that the set does not allow.
        """
        from fringed_plugins.phase.colours.colour import three_steps

        frame_set, colours, places = _shot(inputs, self.name, context)
        frames = frame_set.frames[list(places)]
        group = _group(frame_set, places)
        method, white = _balance_of(frame_set, params)
        context.progress(0.2, f"balance {method}")
        limits = thresholds(frame_set, params)
        try:
            gains = _gains(frame_set, frames, colours, (method, white), params)
            decoded = three_steps(
                frames, group.shifts_rad, colours, _noise(frame_set, places[1]), limits,
                gains=gains, white=white, threads=context.threads,
            )  # fmt: skip
        except ValueError as error:
            raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error
        context.progress(0.8, "neighbours")
        from fringed_plugins.phase.cleaning import clean

        clean(decoded, group, limits, None, context.threads)
        return phase_map_of(decoded, "wrapped", group, frame_set)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        from fringed_plugins.phase.colours.colour import Colours, three_steps
        from fringed_plugins.phase.decoded import Thresholds
        from fringed_plugins.phase.noise import NoiseModel

        shifts = tuple(2 * np.pi * np.arange(3) / 3)
        frames = np.zeros((3, 8, 8), np.uint8)
        three_steps(frames, shifts, Colours(np.eye(3)), NoiseModel(1.0, 0.0), Thresholds(), threads=1)


class OneShotFrequenciesDecoder:
    """Absolute phase of three carriers in the colours of one exposure.

    Each unmixed channel is filtered around its carrier as a single frame (`fourier`); the three phases together
    tell the fringe order. Every channel has its own brightness, so that coloured surfaces do little harm.

    References
    ----------
    Zhang, Towers & Towers 2006; Takeda & Mutoh 1983; Petkovic, Pribanic & Donlic 2017.
    """

    name: ClassVar[str] = "one-shot-frequencies"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "three frequencies in the colours of one exposure to an absolute phase"
    inputs: ClassVar[Mapping[str, Any]] = _INPUTS
    optional: ClassVar[frozenset[str]] = _OPTIONAL
    output: ClassVar[type] = PhaseMap

    class Params(SingleFrameParams, frozen=True, kw_only=True):
        """Parameters; carrier_period_px is the finest carrier's."""

        bandwidth: Annotated[
            float, Meta(gt=0, le=1, description="half width of each band over its carrier's frequency")
        ] = 0.9  # fmt: skip
        cross_bandwidth: Annotated[float, Meta(gt=0, le=1, description="... across the carrier's direction")] = 0.9
        flat: Annotated[float, Meta(ge=0, le=0.95, description="part of a band that is flat")] = 0.5
        iterations: Annotated[
            int, Meta(ge=0, le=50, description="rounds that continue the fringes into holes and beyond borders")
        ] = 3  # fmt: skip
        systematic_rad: Annotated[
            float,
            Meta(gt=0, le=1, description="error of a filtered phase besides noise, for the fringe orders",
                 extra_json_schema={"units": "rad"}),
        ] = 0.05  # fmt: skip

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the absolute phase.

        Raises
        ------
        DataError
            no shot in three channels, no carrier, or frequencies whose orders cannot be told.
        """
        from fringed_plugins.phase.colours.colour import noise_of_unmixed, unmix
        from fringed_plugins.phase.colours.one_shot import Carrier, Filters, three_carriers

        frame_set, colours, places = _shot(inputs, self.name, context)
        raw = np.stack([_turned(frame_set, index, params.rises) for index in places])
        chosen = [frame_set.sequence.frames[index] for index in places]
        size_px = projector_size_px(frame_set.sequence)
        noise = _noise(frame_set, places[1])
        filters = Filters(
            params.carrier_period_px, params.bandwidth, params.cross_bandwidth, params.flat, params.iterations,
            params.systematic_rad, frame_limits(frame_set, params),
        )  # fmt: skip
        try:
            noises = noise_of_unmixed(colours, noise)
            decoded = three_carriers(
                unmix(raw, colours, context.threads),
                raw.max(axis=0) >= full_scale_dn(frame_set),
                [
                    Carrier(f.period_px, f.initial_phase_rad + f.shift_rad, n)
                    for f, n in zip(chosen, noises, strict=True)
                ],
                size_px,
                filters=filters,
                threads=context.threads,
                report=lambda part: context.progress(0.1 + 0.8 * part),
            )
        except ValueError as error:
            raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error
        finest = min(chosen, key=lambda frame: frame.period_px)
        return _absolute_map(decoded, finest, frame_set, params.rises)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        from fringed_plugins.phase.colours.colour import Colours, unmix

        unmix(np.zeros((3, 8, 8), np.uint8), Colours(np.eye(3)), 1)


def _shot(inputs: Mapping[str, Any], name: str, context: Context) -> tuple[FrameSet, Colours, tuple[int, int, int]]:
    """Return the frame set, its colours, and the fringes' frames in red, green and blue."""
    frame_set, calibration = checked_frames(inputs, name), inputs.get("calibration")
    if calibration is not None and not isinstance(calibration, Calibration):
        raise DataError(f"{name} takes a Calibration named 'calibration'; it was given {type(calibration).__name__}")
    context.check_cancelled()
    places = channel_places(frame_set.sequence, "sinusoidal")
    if places is None:
        raise DataError(f"no frame of the set is part of a shot; {name} decodes what encoder {name!r} makes")
    return frame_set, colours_of(calibration, frame_set, context), places


def _group(frame_set: FrameSet, places: tuple[int, int, int]) -> Group:
    from fringed_plugins.phase.shifts import Group

    frames = [frame_set.sequence.frames[index] for index in places]
    periods = {frame.period_px for frame in frames}
    if len(periods) > 1:
        raise DataError(
            f"the colours carry periods of {sorted(periods)} px; three steps have one: decode with one-shot-frequencies"
        )
    shifts = tuple(float(frame.shift_rad) for frame in frames)
    return Group(places, shifts, float(frames[0].period_px), float(frames[0].initial_phase_rad))


def _balance_of(frame_set: FrameSet, params: OneShotPhaseShiftDecoder.Params) -> tuple[Balance, Array | None]:
    """Return the method, and the raw white frame where it is needed."""
    places = channel_places(frame_set.sequence, "uniform")
    if params.balance == "white" or (params.balance == "auto" and places is not None):
        return "white", None if places is None else frame_set.frames[list(places)]
    return ("global" if params.balance == "auto" else params.balance), None


def _gains(
    frame_set: FrameSet, frames: Array, colours: Colours, chosen: tuple[Balance, Array | None],
    params: OneShotPhaseShiftDecoder.Params,
) -> Float32Array | None:  # fmt: skip
    from fringed_plugins.phase.colours.colour import balance, carrier_period_px, unmix

    method, white = chosen
    if method == "none":
        return None
    unmixed = unmix(frames, colours)
    if method != "local":
        return balance(unmixed, method, white=None if white is None else unmix(white, colours))
    first = frame_set.sequence.frames[0]
    along = unmixed if first.orientation == "columns" else np.ascontiguousarray(unmixed.transpose(0, 2, 1))
    expected = projector_size_px(frame_set.sequence) / first.period_px / along.shape[2]
    period = params.carrier_period_px or carrier_period_px(along, expected)
    gains = balance(along, method, period_px=period)
    return gains if gains is None or first.orientation == "columns" else gains.transpose(0, 2, 1)


def _noise(frame_set: FrameSet, index: int) -> NoiseModel:
    """Return the noise of the camera's channels, as the frame at `index` shows it where the settings do not tell."""
    return frame_noise_model(frame_set, _turned(frame_set, index, True).astype(np.float32))


def _turned(frame_set: FrameSet, index: int, rises: bool) -> Array:
    """Return a frame with its phase rising along the second axis."""
    frame, image = frame_set.sequence.frames[index], frame_set.frames[index]
    image = image if frame.orientation == "columns" else image.T
    turned: Array = image if rises else image[:, ::-1]
    return turned


def _absolute_map(decoded: Any, finest: PatternFrame, frame_set: FrameSet, rises: bool) -> PhaseMap:
    arrays = [decoded.phase_rad, decoded.sigma_rad, decoded.modulation, decoded.background, decoded.rejected]
    arrays.append(decoded.confidence)
    arrays = [array if rises else array[:, ::-1] for array in arrays]
    if finest.orientation == "rows":
        arrays = [array.T for array in arrays]
    phase, sigma, modulation, background, rejected, confidence = arrays
    return PhaseMap(
        phase_rad=phase,
        modulation=modulation,
        background=background,
        rejected=rejected,
        kind="absolute",
        period_px=finest.period_px,
        orientation=finest.orientation,
        initial_phase_rad=finest.initial_phase_rad,
        projector_px=projector_size_px(frame_set.sequence),
        sigma_rad=sigma,
        confidence=confidence,
    )
