"""Decoder of a single frame by the Fourier transform.

Owns its parameters; the filter is in `phase.single_frame.fourier`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import FrameSet, PhaseMap
from fringed.hookspecs import Context
from fringed_plugins.decoders.common import checked_frames
from fringed_plugins.decoders.single_frame import (
    Fringes,
    SingleFrameParams,
    band_of,
    frame_limits,
    frame_noise_model,
    fringes_of,
    mirrored,
    phase_map_of_frame,
)


class FourierDecoder:
    """Wrapped phase of one frame: the band around the carrier, its background removed, borders continued.

    A second frame (shifted by pi, or uniform) removes the background instead of the filter, where the set has one.
    Neighbouring pixels share their noise, and details finer than about a period are lost.

    References
    ----------
    Takeda & Mutoh 1983; Li, Su & Guo 1990; Roddier & Roddier 1987.
    """

    name: ClassVar[str] = "fourier"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "one frame with a carrier to a wrapped phase, by the Fourier transform"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(SingleFrameParams, frozen=True, kw_only=True):
        """Parameters."""

        frame: Annotated[int, Meta(ge=0, le=63, description="which frame of the finest fringes")] = 0
        use_second_frame: Annotated[
            bool, Meta(description="take the background from a second frame, where there is one")
        ] = True
        bandwidth: Annotated[
            float,
            Meta(gt=0, le=1, description="half width of the band over the carrier's frequency"),
        ] = 0.9
        cross_bandwidth: Annotated[float, Meta(gt=0, le=1, description="... across the carrier's direction")] = 0.9
        window: Annotated[Literal["tukey", "hann"], Meta(description="shape of the band")] = "tukey"
        flat: Annotated[float, Meta(ge=0, le=0.95, description="part of a Tukey band that is flat")] = 0.5
        iterations: Annotated[
            int, Meta(ge=0, le=50, description="rounds that continue the fringes into holes and beyond borders")
        ] = 3  # fmt: skip

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the wrapped phase.

        Raises
        ------
        DataError
            no fringes, or no carrier that stands out.
        """
        from fringed_plugins.phase.single_frame.fourier import analytic_signal, lit, single_frame

        frame_set = checked_frames(inputs, self.name)
        context.check_cancelled()
        fringes = turned(fringes_of(frame_set, params.frame, params.use_second_frame), params.rises)
        band = band_of(fringes, frame_set, params)
        limits = frame_limits(frame_set, params)
        context.progress(0.1, f"carrier of {band.period_px:.4g} px")
        valid = lit(fringes.light, fringes.saturated, band, limits.modulation_dn)
        found = analytic_signal(
            fringes.light, valid, band, fringes.background, params.iterations,
            threads=context.threads, report=lambda part: context.progress(0.1 + 0.8 * part),
        )  # fmt: skip
        decoded = single_frame(
            found, fringes.light, valid, fringes.saturated, band,
            noise=frame_noise_model(frame_set, fringes.light), limits=limits,
            frame_variances=fringes.variances, shift_rad=fringes.frame.shift_rad,
        )  # fmt: skip
        return phase_map_of_frame(decoded, fringes, frame_set, params.rises)

    @classmethod
    def warm_up(cls) -> None:
        """Load what transforms need."""
        from fringed_plugins.phase.single_frame import bands, fourier

        band = bands.Band(0.125, 0.0, 0.06, 0.06)
        fourier.analytic_signal(np.zeros((16, 64), np.float32), np.ones((16, 64), bool), band, threads=1)


def turned(fringes: Fringes, rises: bool) -> Fringes:
    """Return the fringes with the phase rising to the right."""
    if rises:
        return fringes
    background = None if fringes.background is None else np.ascontiguousarray(mirrored(fringes.background, False))
    return replace(
        fringes,
        light=np.ascontiguousarray(mirrored(fringes.light, False)),
        background=background,
        saturated=mirrored(fringes.saturated, False),
    )
