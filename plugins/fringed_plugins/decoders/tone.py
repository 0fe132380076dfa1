"""The projector's tone curve: measured on a ramp, verified on another surface, watched in every scan.

Owns what a calibration remembers of it: `tone_curve`, and the residuals whose names begin with `tone_`. The
algorithms are in `phase.nonlinear`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Calibration, FrameSet
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.decoders.common import full_scale_dn
from fringed_plugins.decoders.tone_drift import PROMISE

VERIFIED = "tone_verified"
_GRID = 40_000
_FEW = (3, 4)


class ToneResponse:
    """Grey ramp and calibration to a calibration with the tone curve of this projector.

    Each pixel's own scale and offset are removed, the lamp's drift is told from tone by levels that come again, and a
    smooth rising curve is laid through the levels. Everything else of the calibration is kept, but for what was
    verified of an older curve. Encoders invert the curve: the light of compensated fringes is sinusoidal before any
    blur, and stays so behind it.

    References
    ----------
    Guo, He & Chen 2004; Zhang & Yau 2007, section 3.
    """

    name: ClassVar[str] = "tone-response"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a grey ramp and the calibration to a calibration with the measured tone curve"
    inputs: ClassVar[Mapping[str, Any]] = {"frames": FrameSet, "calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset({"calibration"})
    output: ClassVar[type] = Calibration

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        min_contrast: Annotated[
            float,
            Meta(gt=0, lt=1, description="smallest range of a pixel over full scale", extra_json_schema={"units": "1"}),
        ] = 0.1
        max_rms: Annotated[
            float,
            Meta(gt=0, le=1, description="largest scatter of the levels about the curve, over its range"),
        ] = 0.01

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Calibration:
        """Return the calibration.

        Raises
        ------
        DataError
            frames that are no grey ramp or too dark, a curve that does not fit them, or no calibration to extend.
        """
        from fringed_plugins.phase.nonlinear.response import measure_response

        frames, calibration = _ramp(inputs, self.name), _calibration(inputs, self.name)
        greys = [float(pattern.max()) for pattern in frames.sequence.patterns]
        context.progress(0.1, "fitting the tone curve")
        try:
            found = measure_response(frames.frames, greys, full_scale_dn(frames), params.min_contrast)
        except ValueError as error:
            raise DataError(f"the ramp {frames.id or 'without id'} gives no tone curve: {error}") from error
        if found.rms > params.max_rms:
            raise DataError(
                f"the levels scatter by {found.rms:.2%} of the range about any smooth curve, allowed "
                f"{params.max_rms:.2%}; the lamp flickers against the exposure, or somebody moved: expose for whole "
                "periods of the mains (10 or 20 ms at 50 Hz) and take the ramp again"
            )
        context.log(
            "info",
            f"tone curve of {len(found.greys)} levels and {found.pixels} pixels: levels scatter {found.rms:.3%}, lamp "
            f"drift {found.drift:+.2%}, flicker {found.flicker:.2%}, curve known to {found.deviation.mean():.3%}",
        )
        kept = {key: value for key, value in calibration.residuals.items() if not key.startswith("tone_")}
        residuals = {
            **kept,
            "tone_rms": found.rms,
            "tone_deviation": float(found.deviation.mean()),
            "tone_drift": found.drift,
            "tone_flicker": found.flicker,
            "tone_levels": float(len(found.greys)),
            "tone_pixels": float(found.pixels),
            VERIFIED: 0.0,
        }
        return replace(calibration, tone_curve=found.curve, residuals=residuals)

    @classmethod
    def warm_up(cls) -> None:
        """Import what the fit needs."""
        from fringed_plugins.phase.nonlinear.curve import monotone_curve

        monotone_curve(np.linspace(0, 255, 9), np.linspace(0, 1, 9), np.ones(9))


class ToneVerify:
    """Two sets of one surface, plain and compensated, to a calibration that says whether the tone curve holds there.

    Both sets have 12 equal steps, or another multiple of 3 and 4. Each holds several sets of 3 and of 4 steps, whose
    phases are compared with that of all 12: what is left is the ripple of the tone curve, on this very surface. A
    surface that looks like the one of the ramp is refused: a compensation has to hold where it was not measured.

    References
    ----------
    Zhang & Yau 2007, section 4; Zuo et al. 2018, section 6.
    """

    name: ClassVar[str] = "tone-verify"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "plain and compensated fringes on another surface to a calibration with a verified curve"
    inputs: ClassVar[Mapping[str, Any]] = {
        "plain": FrameSet, "compensated": FrameSet, "ramp": FrameSet, "calibration": Calibration,
    }  # fmt: skip
    optional: ClassVar[frozenset[str]] = frozenset({"ramp"})
    output: ClassVar[type] = Calibration

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        max_ripple_rad: Annotated[
            float, Meta(gt=0, le=3, description="RMS ripple of 3 steps that passes", extra_json_schema={"units": "rad"})
        ] = 0.02
        max_likeness: Annotated[
            float, Meta(gt=0, le=1, description="correlation with the ramp's surface from which on it is the same one")
        ] = 0.97
        another_surface: Annotated[
            bool, Meta(description="your word that the surface is another one than the ramp's, where nothing can tell")
        ] = False

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Calibration:
        """Return the calibration with `tone_verified` 1 or 0, the ripple before and after, and the second harmonic.

        Raises
        ------
        DataError
            sets that cannot be compared, or the surface that the curve was measured on.
        """
        sets = {name: _fringes(inputs, name, self.name) for name in ("plain", "compensated")}
        calibration = _calibration(inputs, self.name)
        _check_compensation(sets["plain"], sets["compensated"], calibration)
        _check_surface(inputs.get("ramp"), sets["compensated"], params)
        context.progress(0.1, "comparing few steps with many")
        residuals = dict(calibration.residuals)
        for name, ending in (("plain", "_before_rad"), ("compensated", "_rad")):
            ripples, second = _ripples(sets[name])
            residuals |= {f"tone_ripple_{steps}{ending}": value for steps, value in ripples.items()}
            residuals[PROMISE if name == "compensated" else f"{PROMISE}_before"] = abs(second)
            context.check_cancelled()
        before, after = residuals["tone_ripple_3_before_rad"], residuals["tone_ripple_3_rad"]
        passed = after <= params.max_ripple_rad and after < before
        residuals[VERIFIED] = float(passed)
        context.log(
            "info" if passed else "warning",
            f"ripple of 3 steps {before:.4f} rad before, {after:.4f} after; of 4 steps "
            f"{residuals['tone_ripple_4_before_rad']:.4f} and {residuals['tone_ripple_4_rad']:.4f}: "
            + ("the tone curve is verified" if passed else f"NOT verified, allowed {params.max_ripple_rad:g} rad"),
        )
        return replace(calibration, residuals=residuals)


def _calibration(inputs: Mapping[str, Any], name: str) -> Calibration:
    calibration = inputs.get("calibration")
    if not isinstance(calibration, Calibration):
        raise DataError(
            f"{name} adds to a calibration of this rig, and there is none: a tone curve is kept with the geometry "
            "that it belongs to. Calibrate the rig first, and name the file in the configuration (calibration = ...)"
        )
    return calibration


def _ramp(inputs: Mapping[str, Any], name: str) -> FrameSet:
    frames = inputs.get("frames")
    if not isinstance(frames, FrameSet):
        raise DataError(f"{name} takes a FrameSet named 'frames'; it was given {type(frames).__name__}")
    uniform = all(pattern.shape[:2] == (1, 1) for pattern in frames.sequence.patterns)
    if not uniform or frames.sequence.precompensated:
        raise DataError(
            f"{name} reads uniform grey pictures, not compensated; patterns of family {frames.sequence.family!r} are "
            "others: take the ramp with the encoder grey-ramp"
        )
    return frames


def _fringes(inputs: Mapping[str, Any], role: str, name: str) -> FrameSet:
    frames = inputs.get(role)
    if not isinstance(frames, FrameSet):
        raise DataError(f"{name} takes a FrameSet named {role!r}; it was given {type(frames).__name__}")
    members = frames.sequence.frames
    steps = len(members)
    if len(frames.sequence.groups()) != 1 or any(m.style != "sinusoidal" for m in members) or steps % 12:
        raise DataError(
            f"{name}: the set {role!r} has {steps} frames in {len(frames.sequence.groups())} groups; it takes "
            "sinusoids of one frequency in 12 or 24 equal steps"
        )
    return frames


def _check_compensation(plain: FrameSet, compensated: FrameSet, calibration: Calibration) -> None:
    if plain.sequence.precompensated or not compensated.sequence.precompensated or calibration.tone_curve is None:
        raise DataError(
            "tone-verify compares fringes with and without compensation; the plain set is "
            f"{'' if plain.sequence.precompensated else 'not '}compensated, the other is "
            f"{'' if compensated.sequence.precompensated else 'not '}, and the calibration has "
            f"{'no' if calibration.tone_curve is None else 'a'} tone curve: measure one with `fringe tone measure`, "
            "make the calibration that it writes the station's, and verify then"
        )
    if plain.frames.shape != compensated.frames.shape:
        raise DataError(f"the sets have shapes {plain.frames.shape} and {compensated.frames.shape}; take both alike")


def _check_surface(ramp: Any, fringes: FrameSet, params: ToneVerify.Params) -> None:
    """Refuse the surface of the ramp: what it was fitted on proves nothing."""
    from fringed_plugins.phase.nonlinear.ripple import likeness

    if params.another_surface:
        return
    if not isinstance(ramp, FrameSet):
        raise DataError(
            "the ramp that the tone curve was measured on is not at hand, so nothing tells whether this is another "
            "surface; measure the curve again, or give your word with another_surface = true"
        )
    if ramp.frames.shape[1:] != fringes.frames.shape[1:]:
        raise DataError(
            f"the ramp has {ramp.frames.shape[1:]} pixels, the fringes {fringes.frames.shape[1:]}; take both alike"
        )
    white = ramp.frames[int(np.argmax([pattern.max() for pattern in ramp.sequence.patterns]))]
    alike = likeness(white, fringes.frames.mean(axis=0))
    if alike > params.max_likeness:
        raise DataError(
            f"this looks like the surface that the tone curve was measured on (correlation {alike:.3f}, from "
            f"{params.max_likeness:g} on it counts as the same): a compensation is verified on another one; put an "
            "object of other shape and depth before the rig"
        )


def _ripples(frames: FrameSet) -> tuple[dict[int, float], float]:
    """Return the RMS ripple (rad) of 3 and 4 steps, and the second harmonic over the fundamental."""
    from fringed_plugins.phase.nonlinear.harmonics import second_harmonic
    from fringed_plugins.phase.nonlinear.ripple import fringe_vector, subset_ripple

    shifts = [frame.shift_rad for frame in frames.sequence.frames]
    stack, top = frames.frames, full_scale_dn(frames)
    size = np.abs(fringe_vector(stack, shifts))
    valid = (stack.max(axis=0) < top) & (size > max(0.03 * top, 0.25 * float(np.percentile(size, 99))))
    try:
        found = {steps: subset_ripple(stack, shifts, steps, valid).rms_rad for steps in _FEW}
    except ValueError as error:
        raise DataError(f"the set {frames.id or 'without id'} cannot be verified with: {error}") from error
    chosen = np.flatnonzero(valid.ravel())
    chosen = chosen[:: -(-len(chosen) // _GRID)]
    grid = stack.reshape(len(stack), -1)[:, chosen].astype(np.float32)
    return found, second_harmonic(grid, shifts)[0]
