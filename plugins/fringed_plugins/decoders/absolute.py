"""What decoders of absolute phase share: the parameters of fringe orders, and the groups of one orientation.

Owns the translation of a sequence into sinusoidal and Gray groups, and of what was found into a PhaseMap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from msgspec import Meta

from fringed.data import FrameSet, PatternSequence, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context, FrameSetStart
from fringed_plugins.decoders.common import DecoderParams, as_seen, full_scale_dn, sensor_noise, thresholds
from fringed_plugins.decoders.masks import mask_limits

if TYPE_CHECKING:
    from fringed_plugins.phase.decode import Keep
    from fringed_plugins.phase.decoded import Decoded, Thresholds
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group
    from fringed_plugins.phase.temporal.graybits import BitFrames

_PX, _ONE = {"units": "px"}, {"units": "1"}


class OrderParams(DecoderParams, frozen=True, kw_only=True):
    """When a fringe order is taken, and what else an absolute phase allows to drop."""

    edge_px: Annotated[
        float, Meta(ge=0, le=100, description="columns dropped at the projector's border", extra_json_schema=_PX)
    ] = 0.5
    min_window_snr: Annotated[
        float,
        Meta(
            ge=0, le=1e4, description="modulation over noise, averaged over 5 x 5 px, from which on neighbours may "
            "settle a doubtful fringe order; 0: each pixel stands by itself", extra_json_schema=_ONE,
        ),
    ] = 1.0  # fmt: skip
    order_median_px: Annotated[
        Literal[0, 3, 5, 7, 9],
        Meta(description="window of a median of the fringe order, for pixels that seemed sure too; 0: off"),
    ] = 0
    drop_repeated: Annotated[
        bool, Meta(description="keep one camera pixel for each projector pixel along the camera's line")
    ] = False
    keep_confidence: Annotated[
        bool, Meta(description="keep how many standard deviations the fringe order is from a wrong one")
    ] = False


class JointParams(OrderParams, frozen=True, kw_only=True):
    """Parameters of decoders that choose the orientation themselves."""

    orientation: Annotated[
        Literal["auto", "columns", "rows"], Meta(description="fringes to decode; auto: the only ones there are")
    ] = "auto"


@dataclass(frozen=True)
class Parts:
    """The groups of one orientation: sinusoids from long to short period, and the Gray code where there is one."""

    groups: list[Group]
    bits: BitFrames | None
    first: int  # a frame of this orientation
    size_px: int


def parts_of(sequence: PatternSequence, orientation: str) -> Parts:
    """Return the groups of one orientation.

    Raises
    ------
    DataError
        an orientation that is not there or not said, several levels or codes, or groups that make no sense.
    """
    from fringed_plugins.phase.shifts import groups_of
    from fringed_plugins.phase.temporal.graybits import bit_frames

    there = sorted({frame.orientation for frame in sequence.frames})
    if orientation not in ("auto", *there) or (orientation == "auto" and len(there) > 1):
        raise DataError(
            f"the set has fringes along {' and '.join(there)}, and orientation is {orientation!r}; "
            f"choose one of {', '.join(there)}"
        )
    wanted = there[0] if orientation == "auto" else orientation
    groups = {n: found for n, found in sequence.groups().items() if sequence.frames[found[0]].orientation == wanted}
    gray = [found for found in groups.values() if sequence.frames[found[0]].style == "gray"]
    waves = {n: found for n, found in groups.items() if sequence.frames[found[0]].style != "gray"}
    levels = {sequence.frames[index].level for found in groups.values() for index in found}
    if len(gray) > 1 or len(levels) > 1:
        raise DataError(
            f"the set has {len(gray)} Gray codes and levels of light {sorted(levels)} along {wanted}; one code and one "
            "level are decoded at a time"
        )
    try:
        bits = bit_frames(sequence.frames, gray[0]) if gray else None
        found_groups = groups_of(sequence.frames, waves) if waves else []
    except ValueError as error:
        raise DataError(f"patterns of family {sequence.family!r}: {error}") from error
    size_px = sequence.width_px if wanted == "columns" else sequence.height_px
    return Parts(found_groups, bits, next(iter(groups.values()))[0], size_px)


def order_thresholds(frame_set: FrameSet | FrameSetStart, params: OrderParams, orientation: str) -> Thresholds:
    """Return the thresholds in the frames' own grey levels."""
    masks = mask_limits(
        params, full_scale_dn(frame_set), order_median_px=params.order_median_px, repeated=params.drop_repeated,
        down=orientation == "rows",
    )  # fmt: skip
    return replace(thresholds(frame_set, params), edge_px=params.edge_px, window_snr=params.min_window_snr, masks=masks)


def absolute_map(
    frame_set: FrameSet,
    parts: Parts,
    params: OrderParams,
    context: Context,
    decode: Callable[[NoiseModel, Thresholds, Keep], Decoded],
) -> PhaseMap:
    """Return what `decode` makes of noise, thresholds and what is to be kept, as an absolute PhaseMap.

    Raises
    ------
    DataError
        what the algorithm refuses.
    """
    from fringed_plugins.phase.decode import Keep
    from fringed_plugins.phase.noise import NoiseModel
    from fringed_plugins.phase.shifts import Group

    first = frame_set.sequence.frames[parts.first]
    context.check_cancelled()
    noise = sensor_noise(frame_set, parts.groups[-1]) if parts.groups else _plain_noise(frame_set, NoiseModel)
    limits = as_seen(order_thresholds(frame_set, params, first.orientation), frame_set.frames, parts.groups)
    keep = Keep(wrapped=params.keep_wrapped and bool(parts.groups), confidence=params.keep_confidence)
    try:
        decoded = decode(noise, limits, keep)
    except ValueError as error:
        raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error
    code = parts.bits.code if parts.bits else None
    finest = parts.groups[-1] if parts.groups else Group((), (), code.period_px, code.initial_rad)  # type: ignore[union-attr]
    return PhaseMap(
        phase_rad=decoded.phase_rad,
        modulation=decoded.modulation,
        background=decoded.background,
        rejected=decoded.rejected,
        kind="absolute",
        period_px=finest.period_px,
        orientation=first.orientation,
        initial_phase_rad=finest.initial_rad,
        projector_px=parts.size_px,
        sigma_rad=decoded.sigma_rad,
        wrapped_rad=decoded.wrapped_rad if decoded.wrapped_rad.size else None,
        confidence=decoded.confidence if decoded.confidence.size else None,
    )


def _plain_noise(frame_set: FrameSet, model: Any) -> NoiseModel:
    """Return the noise of frames without fringes to estimate it from: the settings', or two grey levels."""
    settings = frame_set.settings
    if settings.electrons_per_dn > 0:
        noise: NoiseModel = model.from_sensor(settings.electrons_per_dn, settings.read_noise_electrons)
        return noise
    unknown: NoiseModel = model((2.0 * full_scale_dn(frame_set) / 255) ** 2, 0.0)
    return unknown
