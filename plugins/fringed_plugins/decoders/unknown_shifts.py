"""Decoder of frames whose phase shifts are not what was asked for.

Owns its parameters and what is said about the shifts; the estimate is in `phase.unknown.unknown_shifts`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import FrameSet, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.common import (
    DecoderParams,
    as_seen,
    checked_frames,
    full_scale_dn,
    phase_map_of,
    sensor_noise,
    sinusoidal_groups,
    thresholds,
)

if TYPE_CHECKING:
    from fringed_plugins.phase.shifts import Group
    from fringed_plugins.phase.unknown.unknown_shifts import ShiftEstimate

_SIGMAS = 4.0


class UnknownShiftsDecoder:
    """Wrapped phase of one group of N >= 3 shifts, which are estimated from the frames themselves.

    Warns where they are not those that were asked for: a projector that drops frames, a stage that does not
    reach its places, a rig that vibrates. A common shift of all frames cannot be told from the phase.

    References
    ----------
    Wang & Han 2004; Vargas, Quiroga & Belenguer 2011.
    """

    name: ClassVar[str] = "unknown-shifts"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "N steps of one frequency, their shifts estimated, to a wrapped phase"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(DecoderParams, frozen=True, kw_only=True):
        """Parameters."""

        group: Annotated[
            int, Meta(ge=-1, le=63, description="frequency to decode, coarse to fine; -1: the finest")
        ] = -1
        warn_difference_deg: Annotated[
            float,
            Meta(
                ge=0,
                le=180,
                description="difference of estimated and asked shifts that is worth a warning",
                extra_json_schema={"units": "deg"},
            ),
        ] = 3.0
        pixels: Annotated[
            int, Meta(ge=1000, le=10_000_000, description="pixels that the shifts are estimated from")
        ] = 200_000  # fmt: skip

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the wrapped phase.

        Raises
        ------
        DataError
            frames that are no sinusoids, a group that is not there, or shifts that the frames do not tell.
        """
        frame_set = checked_frames(inputs, self.name)
        groups = sinusoidal_groups(frame_set.sequence)
        if params.group >= len(groups):
            raise DataError(f"group {params.group} is wanted; the set has {len(groups)}: 0 to {len(groups) - 1}, or -1")
        asked = groups[params.group]
        context.progress(0.05, "estimating the shifts")
        found = _estimate(frame_set, asked, params.pixels)
        _tell(found, asked, params.warn_difference_deg, context)
        context.progress(0.6, "decoding")
        return _decoded(frame_set, replace(asked, shifts_rad=found.shifts_rad), params, context)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        from fringed_plugins.decoders.sinusoidal import warm_up_kernels

        warm_up_kernels()


def _estimate(frame_set: FrameSet, asked: Group, pixels: int) -> ShiftEstimate:
    from fringed_plugins.phase.unknown.unknown_shifts import estimated_shifts

    frames = frame_set.frames[list(asked.frames)]
    noise = sensor_noise(frame_set, asked)
    found = estimated_shifts(frames, asked.shifts_rad, noise, saturation_dn=full_scale_dn(frame_set), pixels=pixels)
    if not found.converged:
        raise DataError(f"the shifts of the set {frame_set.id or 'without id'} cannot be estimated: {found.reason}")
    return found


def _tell(found: ShiftEstimate, asked: Group, limit_deg: float, context: Context) -> None:
    """Log the shifts; warn where they are not those that were asked for."""
    difference = np.rad2deg(np.array(found.shifts_rad) - np.array(asked.shifts_rad))
    sigma = np.rad2deg(np.array(found.sigma_rad))
    shifts = ", ".join(f"{shift:.2f}" for shift in np.rad2deg(found.shifts_rad))
    context.log("info", f"shifts of {shifts} deg, each within {sigma.max():.2g}; {found.reason}")
    off = (np.abs(difference) > limit_deg) & (np.abs(difference) > _SIGMAS * sigma)
    if off.any():
        worst = ", ".join(
            f"frame {asked.frames[i]}: {difference[i]:+.1f} +- {sigma[i]:.2g}" for i in np.flatnonzero(off)
        )
        context.log(
            "warning",
            f"{off.sum()} of {len(off)} shifts differ from those asked for by more than {limit_deg:g} deg ({worst} deg)"
            "; they are used as estimated: look for dropped frames, vibration or a wrong description of the set",
        )


def _decoded(frame_set: FrameSet, group: Group, params: UnknownShiftsDecoder.Params, context: Context) -> PhaseMap:
    from fringed_plugins.phase.decode import decode

    try:
        decoded = decode(
            frame_set.frames,
            [group],
            sensor_noise(frame_set, group),
            as_seen(thresholds(frame_set, params), frame_set.frames, [group]),
            keep_wrapped=params.keep_wrapped,
            threads=context.threads,
        )
    except ValueError as error:
        raise DataError(f"the set {frame_set.id or 'without id'} cannot be decoded: {error}") from error
    return phase_map_of(decoded, "wrapped", group, frame_set)
