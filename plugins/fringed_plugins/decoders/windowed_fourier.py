"""Windowed Fourier analysis: of one frame with a carrier, or of a phase map whose noise is to go.

Owns its parameters; the filters are in `phase.single_frame.windowed_fourier`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import Array, Float32Array, FrameSet, PhaseMap, Reject
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.fourier import turned
from fringed_plugins.decoders.single_frame import (
    Fringes,
    SingleFrameParams,
    band_of,
    frame_limits,
    frame_noise_model,
    fringes_of,
    phase_map_of_frame,
)

if TYPE_CHECKING:
    from fringed_plugins.phase.single_frame.bands import Band
    from fringed_plugins.phase.single_frame.fourier import Analytic
    from fringed_plugins.phase.single_frame.window_bank import Bank

_TURN = np.float32(2 * np.pi)


class WindowedFourier:
    """Phase from windows in which the fringes are nearly straight and evenly spaced; noise elsewhere is dropped.

    Takes either one frame with a carrier, or a phase map of any kind, whose phase it smooths without blurring
    its jumps of 2 pi. "filter" puts together what stands out of the noise; "ridges" takes the strongest window at
    each pixel. Where no window stands out the pixel is dropped.

    References
    ----------
    Kemao 2004; Kemao 2007.
    """

    name: ClassVar[str] = "windowed-fourier"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "one frame with a carrier, or a noisy phase map, by windowed Fourier analysis"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet, "phase": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset({"frames", "phase"})
    output: ClassVar[type] = PhaseMap

    class Params(SingleFrameParams, frozen=True, kw_only=True):
        """Parameters."""

        method: Annotated[Literal["filter", "ridges"], Meta(description="what is taken of the windows")] = "filter"
        window_px: Annotated[
            float,
            Meta(
                ge=0,
                le=200,
                description="standard deviation of a window; 0: a period of a frame, 10 for a phase map",
                extra_json_schema={"units": "px"},
            ),
        ] = 0.0
        threshold: Annotated[
            float,
            Meta(ge=0, le=100, description="what a coefficient must exceed", extra_json_schema={"units": "sigma"}),
        ] = 3.0
        min_ridge: Annotated[
            float, Meta(ge=0, le=1, description="smallest height of a smoothed phase map's phasor; less is dropped")
        ] = 0.5
        bandwidth: Annotated[
            float, Meta(gt=0, le=1, description="local frequencies along the carrier, over its own")
        ] = 0.9
        cross_bandwidth: Annotated[float, Meta(gt=0, le=1, description="... and across it")] = 0.9
        use_second_frame: Annotated[
            bool, Meta(description="take the background from a second frame, where there is one")
        ] = True
        window: Annotated[Literal["tukey", "hann"], Meta(description="band of the background's estimate")] = "tukey"
        flat: Annotated[float, Meta(ge=0, le=0.95, description="part of a Tukey band that is flat")] = 0.5

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the phase: wrapped for a frame, of the input's kind for a phase map.

        Raises
        ------
        DataError
            not exactly one input, no fringes, or windows that do not fit.
        """
        frame_set, phase = inputs.get("frames"), inputs.get("phase")
        context.check_cancelled()
        try:
            if isinstance(frame_set, FrameSet) and phase is None:
                return _of_frame(frame_set, params, context)
            if isinstance(phase, PhaseMap) and frame_set is None:
                return _of_phase(phase, params, context)
        except ValueError as error:
            raise DataError(f"{self.name}: {error}") from error
        raise DataError(
            f"{self.name} takes either a FrameSet 'frames' or a PhaseMap 'phase'; it was given "
            f"{type(frame_set).__name__} and {type(phase).__name__}"
        )

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernel."""
        from fringed_plugins.phase.single_frame.window_bank import Bank
        from fringed_plugins.phase.single_frame.windowed_fourier import ridges

        ridges(np.zeros((16, 64), np.float32), Bank((0.2, 0.4), (0.0, 0.0), 4.0), threads=1)


def _of_frame(frame_set: FrameSet, params: WindowedFourier.Params, context: Context) -> PhaseMap:
    from fringed_plugins.phase.single_frame.fourier import analytic_signal, lit, single_frame

    fringes = turned(fringes_of(frame_set, 0, params.use_second_frame), params.rises)
    band = band_of(fringes, frame_set, params)
    limits = frame_limits(frame_set, params)
    noise = frame_noise_model(frame_set, fringes.light)
    valid = lit(fringes.light, fringes.saturated, band, limits.modulation_dn)
    context.progress(0.05, f"carrier of {band.period_px:.4g} px")
    rough = analytic_signal(fringes.light, valid, band, fringes.background, 3, threads=context.threads)
    context.progress(0.3, "windows")
    level = float(np.median(rough.background[valid])) if valid.any() else 0.0
    sigma = float(np.sqrt(fringes.variances * (noise.constant_dn2 + noise.slope_dn * max(level, 0.0))))
    found = _refined(rough, fringes, band, sigma, (params, context))
    decoded = single_frame(
        found, fringes.light, valid, fringes.saturated, band,
        noise=noise, limits=limits, frame_variances=fringes.variances, shift_rad=fringes.frame.shift_rad,
    )  # fmt: skip
    return phase_map_of_frame(decoded, fringes, frame_set, params.rises)


def _refined(
    rough: Analytic, fringes: Fringes, band: Band, sigma: float, asked: tuple[WindowedFourier.Params, Context]
) -> Analytic:
    """Return the fringes anew from the windows; `sigma` is the noise of what they see."""
    from fringed_plugins.phase.single_frame.window_bank import Bank

    params, context = asked
    carrier, width = 2 * np.pi * np.array([band.along, band.across]), 2 * np.pi * band.along
    bank = Bank(
        along=(carrier[0] - params.bandwidth * width, carrier[0] + params.bandwidth * width),
        across=(carrier[1] - params.cross_bandwidth * width, carrier[1] + params.cross_bandwidth * width),
        sigma_px=params.window_px or max(band.period_px, 4.0),
    )
    field, gain = _windows(rough.continued, bank, sigma, (params, context), periodic=True)
    height, width_px = fringes.light.shape
    field = field[:height, :width_px]
    gain = gain[:height, :width_px] if np.ndim(gain) else gain
    return rough._replace(
        cosine=np.ascontiguousarray(field.real), sine=np.ascontiguousarray(field.imag), noise_gain=gain
    )


def _windows(
    field: Array, bank: Bank, sigma: float, asked: tuple[WindowedFourier.Params, Context], *, periodic: bool
) -> tuple[Array, Any]:
    """Return the complex field that the windows give, and q of its noise."""
    from fringed_plugins.phase.single_frame.window_bank import noise_of_coefficients
    from fringed_plugins.phase.single_frame.windowed_fourier import filtered, ridges

    params, context = asked
    report: Callable[[float], None] = lambda part: context.progress(0.3 + 0.6 * part)  # noqa: E731
    if params.method == "ridges":
        ridge = ridges(field, bank, periodic=periodic, threads=context.threads, report=report)
        scale = 1 if np.iscomplexobj(field) else 2
        return ridge.amplitude * np.exp(1j * ridge.phase_rad), scale / (4 * np.pi * bank.sigma_px**2)
    least = params.threshold * noise_of_coefficients(sigma, bank.sigma_px, is_complex=False)
    found = filtered(field, bank, least, periodic=periodic, threads=context.threads, report=report)
    context.log("info", f"{found.kept:.0%} of the windows' coefficients stand out of the noise")
    return found.field, found.noise_gain


def _of_phase(phase: PhaseMap, params: WindowedFourier.Params, context: Context) -> PhaseMap:
    from fringed_plugins.phase.single_frame.window_bank import bank_of

    known = np.isfinite(phase.phase_rad)
    if not known.any():
        raise DataError("the phase map has no pixel with a phase; nothing can be filtered")
    field = np.where(known, np.exp(1j * np.where(known, phase.phase_rad, 0)), 0).astype(np.complex64)
    sigma = _phase_noise(phase, known)
    bank = bank_of(field, params.window_px or 10.0)
    field_out, gain = _windows(field, bank, sigma, (params, context), periodic=False)
    step = np.angle(field_out).astype(np.float32) - phase.phase_rad
    step -= _TURN * np.rint(step / _TURN)
    weak = known & (np.abs(field_out) < params.min_ridge)
    rejected = phase.rejected | np.where(weak, np.uint16(Reject.RESIDUAL), np.uint16(0))
    smoothed = np.where(weak, np.float32(np.nan), phase.phase_rad + step).astype(np.float32)
    if phase.kind == "wrapped":
        smoothed -= _TURN * np.rint(smoothed / _TURN)
    before = phase.sigma_rad if phase.sigma_rad is not None else np.full_like(smoothed, sigma)
    after: Float32Array = (before * np.sqrt(gain)).astype(np.float32)
    after[~np.isfinite(smoothed)] = np.nan
    return replace(phase, phase_rad=smoothed, rejected=rejected, sigma_rad=after, confidence=None, id="")


def _phase_noise(phase: PhaseMap, known: Array) -> float:
    """Return the typical noise of the phase in radians, from second differences where the map does not tell."""
    if phase.sigma_rad is not None and np.isfinite(phase.sigma_rad[known]).any():
        return float(np.nanmedian(phase.sigma_rad[known]))
    second = phase.phase_rad[2:] - 2 * phase.phase_rad[1:-1] + phase.phase_rad[:-2]
    second = second - _TURN * np.rint(second / _TURN)
    if not np.isfinite(second).any():
        return 0.1
    return float(np.nanmedian(np.abs(second)) / 0.6745 / np.sqrt(6))
