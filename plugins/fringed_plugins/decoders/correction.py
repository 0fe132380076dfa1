"""Corrections of a phase that the projector's tone curve has bent, after decoding.

Owns three processors: the table of the error, its use, and the harmonics that a multi-frequency set tells by itself.
The algorithms are in `phase.nonlinear`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Calibration, Float32Array, FrameSet, PhaseErrorTable, PhaseMap
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.absolute import parts_of
from fringed_plugins.decoders.common import checked_frames, full_scale_dn, sinusoidal_groups

_SAME = 1e-6


class PhaseErrorTableMaker:
    """Fringes on a plane, and the calibration, to a calibration with a table of the phase error.

    From many steps (a set of m N steps holds m sets of N, which are compared with all of them), or, where an absolute
    phase map of a plane is given, from its departure from a smooth surface. The table holds for the period, steps,
    grey levels and blur it was measured with; `tone-response` has no such limits and is the first choice.

    References
    ----------
    Zhang & Huang 2007; Zhang & Yau 2007.
    """

    name: ClassVar[str] = "phase-error-table"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "fringes on a plane and the calibration to a calibration with a phase error table"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet, "calibration": Calibration, "phase": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset({"phase"})
    output: ClassVar[type] = Calibration

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        steps: Annotated[
            int,
            Meta(ge=0, le=64, description="steps that the table is for; 0: those of the set on a plane, else a third"),
        ] = 0
        reference: Annotated[
            Literal["auto", "steps", "plane"],
            Meta(description="what the truth is: all steps, or a smooth plane; auto: the plane where a phase is given"),
        ] = "auto"

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Calibration:
        """Return the calibration; a table of the same steps and period is replaced.

        Raises
        ------
        DataError
            frames whose steps are not equal or hold no set of `steps`, or a plane without an absolute phase.
        """
        from fringed_plugins.phase.nonlinear.table import table_of

        frames, calibration = checked_frames(inputs, self.name), inputs.get("calibration")
        if not isinstance(calibration, Calibration):
            raise DataError(f"{self.name} adds to a calibration; it was given {type(calibration).__name__}")
        context.check_cancelled()
        phase = inputs.get("phase")
        from_plane = params.reference == "plane" or (params.reference == "auto" and phase is not None)
        try:
            steps, amplitudes, noise = (
                _of_plane(frames, phase, params.steps) if from_plane else _of_steps(frames, params.steps)
            )
        except ValueError as error:
            raise DataError(f"no table from the set {frames.id or 'without id'}: {error}") from error
        period = sinusoidal_groups(frames.sequence)[-1].period_px
        table = PhaseErrorTable(steps, period, table_of(amplitudes, steps))
        rms = float(np.sqrt(np.mean(table.error_rad**2)))
        context.log("info", f"phase error of {steps} steps, {period:g} px: {rms:.4f} rad RMS, scatter {noise:.4f} rad")
        others = tuple(other for other in calibration.phase_errors if not _same(other, steps, period))
        residuals = {**calibration.residuals, f"phase_error_{steps}_rms_rad": rms}
        return replace(calibration, phase_errors=(*others, table), residuals=residuals)


class CorrectPhase:
    """Phase, wrapped or absolute, less the calibration's table of errors at it.

    References
    ----------
    Zhang & Huang 2007, section 3.3.
    """

    name: ClassVar[str] = "correct-phase"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a phase map less the calibration's phase error table"
    inputs: ClassVar[Mapping[str, Any]] = {"phase": PhaseMap, "calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        steps: Annotated[
            int, Meta(ge=0, le=64, description="steps of the phase; 0: those of the only table for its period")
        ] = 0

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the corrected phase.

        Raises
        ------
        DataError
            a phase that counts from nowhere (relative), or no table, or several, for its period.
        """
        from fringed_plugins.phase.nonlinear.table import subtract_table

        phase, calibration = inputs.get("phase"), inputs.get("calibration")
        if not isinstance(phase, PhaseMap) or not isinstance(calibration, Calibration):
            raise DataError(f"{self.name} takes a PhaseMap 'phase' and a Calibration 'calibration'")
        if phase.kind == "relative" or phase.difference_to:
            raise DataError(
                f"the phase is {phase.kind}, a difference to another map, and has no error of one phase; correct both "
                "wrapped maps before their difference is unwrapped"
            )
        table = _table_for(phase, calibration, params.steps)
        context.check_cancelled()
        wrapped = phase.wrapped_rad
        corrected = subtract_table(phase.phase_rad, table.error_rad)
        return replace(
            phase,
            phase_rad=_turned_in(corrected) if phase.kind == "wrapped" else corrected,
            wrapped_rad=None if wrapped is None else _turned_in(subtract_table(wrapped, table.error_rad)),
            id="",
        )


class HarmonicCorrection:
    """Absolute phase less the harmonics that its own multi-frequency set tells, where the blur is what it is.

    Needs no calibration. For sets that were projected without compensation: where fringes are compensated, the
    rounding of grey levels in the coarse ones limits it, and the phase is better left alone. What the coarse maps
    scatter is averaged over the whole view. Decode with `max_order_error = 0.5`, since a bent coarse phase looks like
    a wrong order.

    References
    ----------
    Xing & Guo 2018.
    """

    name: ClassVar[str] = "harmonic-correction"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "an absolute phase less the harmonics that its several frequencies tell"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet, "phase": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        blur_terms: Annotated[
            int,
            Meta(ge=1, le=3, description="coefficients of a harmonic over the blur; 1: it is the same everywhere",
                 extra_json_schema={"units": "1"}),
        ] = 3  # fmt: skip
        require_convergence: Annotated[bool, Meta(description="fail where the fit does not settle")] = True

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> PhaseMap:
        """Return the corrected phase.

        Raises
        ------
        DataError
            one frequency only, unequal steps, a phase that is not absolute, too few pixels, or a fit that does not
            settle.
        """
        from fringed_plugins.phase.nonlinear.regional import estimate_harmonics, remove

        frames, phase = checked_frames(inputs, self.name), inputs.get("phase")
        if not isinstance(phase, PhaseMap) or phase.kind != "absolute":
            kind = phase.kind if isinstance(phase, PhaseMap) else type(phase).__name__
            raise DataError(f"{self.name} takes an absolute PhaseMap 'phase'; it was given {kind}")
        try:
            fine, *coarser = _fringes(frames, phase)
            context.progress(0.2, "fitting harmonics")
            own_rad = _of_finest(phase.phase_rad, fine.vector)
            found = estimate_harmonics(own_rad, fine, coarser, params.blur_terms)
        except ValueError as error:
            raise DataError(f"the harmonics of the set {frames.id or 'without id'} cannot be told: {error}") from error
        if not found.converged:
            if params.require_convergence:
                raise DataError(f"the harmonics of the set {frames.id or 'without id'} cannot be told: {found.reason}")
            context.log("warning", f"harmonic correction: {found.reason}")
        before, after = found.disagreement_rad
        context.log(
            "info",
            f"harmonics of {found.steps} steps: {found.rms_rad:.4f} rad RMS taken off, known to "
            f"{found.deviation_rad:.5f} rad; the maps differ by {after:.4f} rad, before {before:.4f}",
        )
        context.progress(0.8, "correcting")
        corrected = remove(own_rad, found, context.threads)
        wrapped = None if phase.wrapped_rad is None else _turned_in(remove(phase.wrapped_rad, found, context.threads))
        return replace(phase, phase_rad=corrected, wrapped_rad=wrapped, id="")

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernel."""
        from fringed_plugins.phase.nonlinear.regional import RegionalHarmonics, remove

        flat, series = np.zeros((8, 8), np.float32), np.zeros((3, 3))
        remove(flat, RegionalHarmonics(series, 3, flat, 0.0, 1.0, 0.0, 0.0, (0.0, 0.0), 64, True, ""), threads=1)


def _of_steps(frames: FrameSet, steps: int) -> tuple[int, Any, float]:
    """Return steps, amplitudes (4, 2) and scatter (rad) from the finest group of many steps."""
    from fringed_plugins.phase.nonlinear.ripple import fringe_vector, subset_ripple

    group = sinusoidal_groups(frames.sequence)[-1]
    stack = frames.frames[list(group.frames)]
    wanted = steps or max(len(stack) // 3, 3)
    size = np.abs(fringe_vector(stack, group.shifts_rad))
    top = full_scale_dn(frames)
    valid = (stack.max(axis=0) < top) & (size > max(0.03 * top, 0.25 * float(np.percentile(size, 99))))
    ripple = subset_ripple(stack, group.shifts_rad, wanted, valid)
    return wanted, ripple.amplitudes, ripple.noise_rad


def _of_plane(frames: FrameSet, phase: Any, steps: int) -> tuple[int, Any, float]:
    """Return steps, amplitudes (4, 2) and scatter (rad) from an absolute phase on a plane."""
    from fringed_plugins.phase.nonlinear.ripple import equal_steps
    from fringed_plugins.phase.nonlinear.table import error_series, plane_error

    if not isinstance(phase, PhaseMap) or phase.kind != "absolute":
        raise ValueError("a plane needs an absolute PhaseMap 'phase': decode several frequencies first")
    own = equal_steps(sinusoidal_groups(frames.sequence)[-1].shifts_rad)
    if steps not in (0, own):
        raise ValueError(f"a table for {steps} steps from a phase of {own} steps; leave steps at 0")
    error = plane_error(phase.phase_rad)
    amplitudes, noise = error_series(error, phase.phase_rad - error, own)
    return own, amplitudes, noise


def _fringes(frames: FrameSet, phase: PhaseMap) -> list[Any]:
    """Return the set's frequencies, the finest first, as vectors; check that the phase is that of the finest."""
    from fringed_plugins.phase.nonlinear.regional_fit import Fringes
    from fringed_plugins.phase.nonlinear.ripple import equal_steps, fringe_vector

    groups = parts_of(frames.sequence, phase.orientation).groups[::-1]
    if not groups:
        raise ValueError("the set has no fringes with a period; only those have harmonics to tell")
    finest = groups[0]
    if frames.frames.shape[1:] != phase.phase_rad.shape or abs(finest.period_px - phase.period_px) > _SAME:
        raise ValueError(
            f"the phase has {phase.phase_rad.shape} pixels and a period of {phase.period_px:g} px, the frames "
            f"{frames.frames.shape[1:]} and {finest.period_px:g} px; give the phase that was decoded from these frames"
        )
    return [
        Fringes(
            fringe_vector(frames.frames[list(group.frames)], group.shifts_rad),
            equal_steps(group.shifts_rad),
            group.period_px,
            group.initial_rad,
        )
        for group in groups
    ]


def _of_finest(phase_rad: Float32Array, vector: Any) -> Float32Array:
    """Return the phase of the finest fringes alone, in the order of `phase_rad`, which may be a mean over periods.

    A mean has the ripples of all periods, which are not those of the harmonics that are taken off.
    """
    own = np.angle(vector)
    turns = 2 * np.pi
    return np.asarray(own + turns * np.rint((phase_rad - own) / turns), np.float32)


def _table_for(phase: PhaseMap, calibration: Calibration, steps: int) -> PhaseErrorTable:
    near = [table for table in calibration.phase_errors if abs(table.period_px - phase.period_px) < 1e-3]
    found = [table for table in near if steps in (0, table.steps)]
    if len(found) != 1:
        there = (
            ", ".join(f"{table.steps} steps of {table.period_px:g} px" for table in calibration.phase_errors) or "none"
        )
        wanted = f"{steps} steps of " if steps else ""
        raise DataError(
            f"{len(found)} phase error tables for {wanted}{phase.period_px:g} px; the calibration has: {there}. "
            "Measure one with phase-error-table, or say which with `steps`"
        )
    return found[0]


def _same(table: PhaseErrorTable, steps: int, period_px: float) -> bool:
    return table.steps == steps and abs(table.period_px - period_px) < 1e-3


def _turned_in(phase_rad: Float32Array) -> Float32Array:
    """Return the phase in (-pi, pi]."""
    turns = np.float32(2 * np.pi)
    return np.asarray(phase_rad - turns * np.rint(phase_rad / turns), np.float32)
