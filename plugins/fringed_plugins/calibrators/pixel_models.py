"""Absolute phases of planes at known places to a calibration with a model of each pixel.

Owns parameters, where the planes are taken from, and what a calibration says of the fit; the fits are in
`calibration.pixel`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Calibration, PhaseMap, PixelModel
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.calibrators.ranging import check_pair, pinhole

if TYPE_CHECKING:
    from fringed_plugins.calibration.pixel.fit import PixelFit, Planes

Float64Array = npt.NDArray[np.float64]
_MM = {"units": "mm"}


class FitPixelModel:
    """Absolute phases of planes at known places, and a calibration, to the calibration with a model of each pixel.

    The projector is not modelled: whatever its lens does, a pixel sees it as a smooth curve from phase to depth. The
    camera's lens and the places of the planes are the calibration's. `triangulate` then uses the curves, between the
    nearest and the farthest plane. A plane's phase that does not fit the others at a pixel is left out there, if there
    are two more planes than coefficients or more. Everything else of the calibration is kept.

    References
    ----------
    thesis.md, section 3, eqs. 3.2-3.7 and 3.21-3.27.
    """

    name: ClassVar[str] = "fit-pixel-model"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "phases of planes at known places to a calibration with a model of each pixel"
    inputs: ClassVar[Mapping[str, Any]] = {"phases": (PhaseMap,), "calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Calibration

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        form: Annotated[
            Literal["rational", "polynomial", "height"],
            Meta(description="z = (a + b p) / (1 + c p); polynomials; or h = L d / (d + 2 pi f0 D) over a plane"),
        ] = "rational"
        degree: Annotated[
            int, Meta(ge=1, le=5, description="of the polynomials", extra_json_schema={"units": "1"})
        ] = 4  # fmt: skip
        whole_rig: Annotated[
            bool, Meta(description="one L, D and f0 for all pixels, as in the thesis; form 'height'")
        ] = False
        depths_mm: Annotated[
            tuple[float, ...],
            Meta(description="of planes across the camera's axis, in the phases' order", extra_json_schema=_MM),
        ] = ()
        planes: Annotated[
            tuple[tuple[float, float, float, float], ...],
            Meta(description="nx, ny, nz, d of n . X = d (mm) in the camera's frame", extra_json_schema=_MM),
        ] = ()
        poses: Annotated[
            tuple[str, ...], Meta(description="names of the calibration's views, whose board was the plane")
        ] = ()
        any_rig: Annotated[
            bool, Meta(description="your word that phases and calibration are of one rig, though named differently")
        ] = False

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Calibration:
        """Return the calibration.

        Raises
        ------
        DataError
            phases that are not absolute or not alike, planes that are missing, too few or not told apart.
        """
        phases, calibration = _phases(inputs, params, context)
        equations = _equations(params, calibration, len(phases))
        seen = _seen(phases, equations)
        context.check_cancelled()
        context.progress(0.2, "fitting each pixel")
        first = phases[0]
        try:
            fit, plane, facts = _fit(seen, calibration, params, context.threads)
        except ValueError as error:
            raise DataError(f"no model of form {params.form!r} fits: {error}") from error
        known = float(np.isfinite(fit.coefficients[-1]).mean())
        model = PixelModel(
            form=params.form,
            coefficients=fit.coefficients.astype(np.float32),
            orientation=first.orientation,
            period_px=first.period_px,
            initial_phase_rad=first.initial_phase_rad,
            z_range_mm=(fit.near_mm, fit.far_mm),
            phase_offset_rad=fit.offset_rad,
            phase_scale=fit.scale,
            sigma_mm=fit.sigma_mm,
        )
        _tell(fit, known, context)
        facts |= {"pixel_planes": float(len(phases)), "pixel_known": known, "pixel_sigma_mm": fit.sigma_mm}
        facts |= {"pixel_scatter_mm": fit.scatter_mm} if np.isfinite(fit.scatter_mm) else {}
        kept = {name: value for name, value in calibration.residuals.items() if not name.startswith("pixel_")}
        return replace(
            calibration, model="pixel", pixel_model=model, reference_plane=plane, residuals=kept | facts
        )  # fmt: skip


def _phases(
    inputs: Mapping[str, Any], params: FitPixelModel.Params, context: Context
) -> tuple[tuple[PhaseMap, ...], Calibration]:  # fmt: skip
    phases, calibration = inputs.get("phases"), inputs.get("calibration")
    if not isinstance(phases, (list, tuple)) or not phases or not isinstance(calibration, Calibration):
        raise DataError(
            "fit-pixel-model takes PhaseMaps 'phases', one of each plane, and a Calibration 'calibration'; it was "
            f"given {type(phases).__name__} and {type(calibration).__name__}"
        )
    for number, phase in enumerate(phases, 1):
        check_pair(phase, calibration, params.any_rig, context)
        if phase.kind != "absolute":
            raise DataError(f"the phase of plane {number} is {phase.kind}; a model of each pixel needs absolute phases")
        if phase.orientation != phases[0].orientation:
            raise DataError(
                f"the phase of plane {number} counts {phase.orientation}, that of the first one "
                f"{phases[0].orientation}; take all along the same direction"
            )
    return tuple(phases), calibration


def _equations(params: FitPixelModel.Params, calibration: Calibration, count: int) -> Float64Array:
    given = {"depths_mm": params.depths_mm, "planes": params.planes, "poses": params.poses}
    told = [name for name, value in given.items() if value]
    if len(told) != 1:
        raise DataError(
            f"the planes' places are given by {' and '.join(told) or 'nothing'}; give one of depths_mm, planes or poses"
        )
    if len(given[told[0]]) != count:
        raise DataError(f"{count} phases, and {len(given[told[0]])} {told[0]}; give one for each phase, in their order")
    if params.depths_mm:
        return np.array([[0.0, 0.0, 1.0, depth] for depth in params.depths_mm])
    if params.planes:
        return np.array(params.planes, np.float64)
    known = {view.name or view.view: view for view in calibration.views} | {v.view: v for v in calibration.views}
    missing = [name for name in params.poses if name not in known]
    if missing:
        names = ", ".join(view.name or view.view for view in calibration.views) or "none"
        raise DataError(f"the calibration has no view {', '.join(missing)}; its views are {names}")
    poses = [known[name].T_camera_board for name in params.poses]
    return np.array([[*pose[:3, 2], pose[:3, 2] @ pose[:3, 3]] for pose in poses])


def _seen(phases: tuple[PhaseMap, ...], equations: Float64Array) -> Planes:
    """Return the planes, each phase as if its fringes had the first one's period and initial phase."""
    from fringed_plugins.calibration.pixel.fit import Planes

    first = phases[0]
    values, sigmas = [], []
    for phase in phases:
        stretch = phase.period_px / first.period_px
        clean = np.where(phase.rejected == 0, phase.phase_rad, np.float32(np.nan)).astype(np.float64)
        values.append(((clean - phase.initial_phase_rad) * stretch + first.initial_phase_rad).astype(np.float32))
        sigmas.append(None if phase.sigma_rad is None else phase.sigma_rad * np.float32(stretch))
    known = [sigma for sigma in sigmas if sigma is not None]
    return Planes(np.stack(values), equations, np.stack(known) if len(known) == len(sigmas) else None)


def _fit(
    seen: Planes, calibration: Calibration, params: FitPixelModel.Params, threads: int
) -> tuple[PixelFit, Float64Array | None, dict[str, float]]:
    """Return the fit, the reference plane of the calibration, and what is worth telling."""
    from fringed_plugins.calibration.pixel.fit import fit_polynomial, fit_rational
    from fringed_plugins.calibration.pixel.heights import heights_of_pixels, heights_of_rig

    camera = pinhole(calibration.camera)
    if params.form == "polynomial":
        return fit_polynomial(seen, camera, params.degree, threads), calibration.reference_plane, {}
    fit = fit_rational(seen, camera, threads)
    if params.form == "rational":
        return fit, calibration.reference_plane, {}
    plane = calibration.reference_plane
    if plane is None:
        plane = _farthest(seen.equations)
    fit = heights_of_pixels(fit, camera, plane, threads)
    if not params.whole_rig:
        return fit, plane, {}
    fit, rig = heights_of_rig(fit, seen, camera, plane)
    return fit, plane, {
        "pixel_L_mm": rig.distance_mm, "pixel_D_mm": rig.baseline_mm, "pixel_f0_per_mm": rig.frequency_per_mm
    }  # fmt: skip


def _farthest(equations: Float64Array) -> Float64Array:
    """Return the plane that the optical axis meets last, its normal towards the camera."""
    with np.errstate(divide="ignore"):
        plane = equations[int(np.argmax(equations[:, 3] / equations[:, 2]))]
    scaled: Float64Array = plane / np.linalg.norm(plane[:3])
    return scaled if scaled[3] < 0 else -scaled


def _tell(fit: PixelFit, known: float, context: Context) -> None:
    if np.isfinite(fit.scatter_mm):
        context.log(
            "info",
            f"planes scatter {fit.scatter_mm:.4f} mm about the model, which is known to {fit.sigma_mm:.4f} mm, from "
            f"{fit.near_mm:.1f} to {fit.far_mm:.1f} mm; {known:.1%} of the pixels have one",
        )
        return
    context.log(
        "warning",
        "there are no more planes than coefficients, so that nothing tells how good the model is, nor whether a phase "
        f"is wrong; it holds from {fit.near_mm:.1f} to {fit.far_mm:.1f} mm. Take a few planes more",
    )
