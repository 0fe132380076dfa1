"""Known artefacts in a range image to verifications, in the terms of VDI/VDE 2634 part 2.

Owns which figures each artefact has; the geometry is in `calibration.artefacts`, imported when first used, the traffic
light in `judging`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__
from fringed.data import Calibration, RangeImage, Verification
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.calibrators.judging import (
    FORM_SHARE,
    LENGTH_SHARE,
    Findings,
    Scene,
    VerifyParams,
    check_size,
    expanded,
    scatter_notes,
    scene_of,
    verification,
)

if TYPE_CHECKING:
    from fringed_plugins.calibration.artefacts.sphere import Sphere
    from fringed_plugins.calibration.artefacts.step import Steps

_MM = {"units": "mm"}
_INPUTS: Mapping[str, Any] = {"range": RangeImage, "calibration": Calibration}
_OPTIONAL = frozenset({"calibration"})


def _field_mm(scene: Scene) -> float:
    from fringed_plugins.calibration.artefacts.cells import cells_of

    return cells_of(scene.xyz_mm, scene.valid).field_mm


def _direction(normal: Any) -> dict[str, float]:
    """Return the parts of a unit normal as figures, for whoever draws the deviations."""
    return {f"normal_{axis}": float(value) for axis, value in zip("xyz", normal, strict=True)}


class VerifyPlane:
    """A range image of a plane to its flatness measurement error.

    The error is the range of the signed distances from the least-squares plane, of means over `smooth_px` squared;
    3 per mille of them are left out. The plane is the largest smooth piece of surface in view.

    References
    ----------
    VDI/VDE 2634 part 2 (2012), flatness measurement error.
    """

    name: ClassVar[str] = "verify-plane"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a range image of a flat plate to its flatness measurement error and a traffic light"
    inputs: ClassVar[Mapping[str, Any]] = _INPUTS
    optional: ClassVar[frozenset[str]] = _OPTIONAL
    output: ClassVar[type] = Verification

    class Params(VerifyParams, frozen=True, kw_only=True):
        """Parameters."""

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Verification:
        """Return `flatness_error`, with the RMS of points and of means beside it.

        Raises
        ------
        DataError
            no plane in view, two of them, or too few points.
        """
        from fringed_plugins.calibration.artefacts.plane import plane_of

        scene = scene_of(inputs, self.name, params)
        context.progress(0.1, "looking for the plane")
        try:
            plane = plane_of(scene.xyz_mm, scene.valid, scene.sigma_mm, params.smooth_px)
            field = _field_mm(scene)
        except ValueError as error:
            raise DataError(f"{self.name}: {error}") from error
        found, form = Findings(), plane.form
        doubt = float(np.hypot(form.range_u_mm, params.artefact_uncertainty_mm))
        found.judged("flatness_error", form.range_mm, doubt, FORM_SHARE, field)
        found.figures |= {"rms": form.rms_mm, "raw_rms": form.raw_rms_mm, "noise": form.noise_mm, "field": field}
        found.figures |= _direction(plane.normal) | {"offset": plane.offset_mm}
        found.notes += scatter_notes(form.noise_mm, scene.sigma_mm, plane.inside, form.strays)
        return verification("plane", scene, plane.inside, found, (inputs, params, context))


class VerifySphere:
    """A range image of one sphere, or of the two of a ball bar, to probing errors and the sphere-spacing error.

    Form is the range of the radial deviations from the least-squares sphere of free radius, of means over `smooth_px`
    squared, 3 per mille left out; size is that sphere's diameter minus the nominal one. Spacing is between centres of
    spheres with the nominal radius held, where one is given: a cap tells radius and distance badly apart. Pixels count
    that look at the sphere at `max_incidence_deg` from its normal or less.

    References
    ----------
    VDI/VDE 2634 part 2 (2012), probing error and sphere-spacing error.
    """

    name: ClassVar[str] = "verify-sphere"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a range image of a sphere or a ball bar to probing and sphere-spacing errors"
    inputs: ClassVar[Mapping[str, Any]] = _INPUTS
    optional: ClassVar[frozenset[str]] = _OPTIONAL
    output: ClassVar[type] = Verification

    class Params(VerifyParams, frozen=True, kw_only=True):
        """Parameters."""

        radius_mm: Annotated[
            float, Meta(ge=0, le=1e5, description="nominal, of every sphere; 0: unknown", extra_json_schema=_MM)
        ] = 0.0
        spacing_mm: Annotated[
            float,
            Meta(ge=0, le=1e5, description="nominal, between the centres; 0: one sphere", extra_json_schema=_MM),
        ] = 0.0
        max_incidence_deg: Annotated[
            float,
            Meta(ge=20, le=85, description="between view and normal", extra_json_schema={"units": "deg"}),
        ] = 60.0

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Verification:
        """Return `probing_error_form`, `probing_error_size` and `sphere_spacing_error`, those that can be told.

        Raises
        ------
        DataError
            no sphere, only one of a bar, too little of it in view, or of quite another size.
        """
        from fringed_plugins.calibration.artefacts.sphere import Cap
        from fringed_plugins.calibration.artefacts.spheres import find_spheres

        scene = scene_of(inputs, self.name, params)
        radius, spacing = expanded(params.radius_mm, params), expanded(params.spacing_mm, params)
        cap = Cap(params.max_incidence_deg, radius, params.smooth_px)
        context.progress(0.1, "looking for spheres")
        count = 2 if params.spacing_mm else 1
        try:
            spheres = find_spheres(scene.xyz_mm, scene.valid, scene.sigma_mm, count=count, cap=cap)
            field = _field_mm(scene)
        except ValueError as error:
            raise DataError(f"{self.name}: {error}") from error
        for sphere in spheres:
            check_size("sphere's radius", sphere.radius_mm, radius)
        found = _sphere_findings(spheres, (radius, spacing), params, field)
        for sphere in spheres:
            found.notes += scatter_notes(sphere.form.noise_mm, scene.sigma_mm, sphere.inside, sphere.form.strays)
        inside = np.logical_or.reduce([sphere.inside for sphere in spheres])
        artefact = "ball-bar" if count == 2 else "sphere"
        return verification(artefact, scene, inside, found, (inputs, params, context))


def _sphere_findings(
    spheres: list[Sphere], nominal: tuple[float, float], params: VerifySphere.Params, field: float
) -> Findings:
    found, own = Findings(), params.artefact_uncertainty_mm
    radius, spacing = nominal
    rough = max(spheres, key=lambda one: one.form.range_mm)
    found.judged("probing_error_form", rough.form.range_mm, np.hypot(rough.form.range_u_mm, own), FORM_SHARE, field)
    if radius:
        off = max(spheres, key=lambda one: abs(one.radius_mm - radius))
        doubt = 2 * np.hypot(np.sqrt(off.covariance[3, 3]), own)
        found.judged("probing_error_size", 2 * (off.radius_mm - radius), doubt, LENGTH_SHARE, field)
        found.nominal["radius"] = radius
    else:
        found.notes.append("no nominal radius: the probing error of size cannot be told")
    if len(spheres) == 2:
        fixed, doubt = _spacing([one.fixed_centre_mm for one in spheres], [one.fixed_covariance for one in spheres])
        free, _ = _spacing([one.centre_mm for one in spheres], [one.covariance[:3, :3] for one in spheres])
        check_size("spacing of the spheres", fixed, spacing)
        found.judged("sphere_spacing_error", fixed - spacing, np.hypot(doubt, own), LENGTH_SHARE, field)
        found.figures |= {"spacing": fixed, "spacing_error_free_radii": free - spacing}
        found.nominal["spacing"] = spacing
    for number, one in enumerate(spheres, 1):
        end = f"_{number}" if len(spheres) > 1 else ""
        found.figures |= {f"radius{end}": one.radius_mm, f"rms{end}": one.form.rms_mm}
        found.uncertainties[f"radius{end}"] = float(np.sqrt(one.covariance[3, 3]))
        found.figures |= {f"raw_rms{end}": one.form.raw_rms_mm, f"noise{end}": one.form.noise_mm}
        found.figures |= {f"centre_{axis}{end}": float(value) for axis, value in zip("xyz", one.centre_mm, strict=True)}
        found.notes.append(f"sphere {number}: a cap of {one.cap_deg:.0f} degrees, {one.covered:.0%} of it with points")
    found.figures["field"] = field
    return found


def _spacing(centres: list[Any], covariances: list[Any]) -> tuple[float, float]:
    apart = centres[1] - centres[0]
    length = float(np.linalg.norm(apart))
    along = apart / length
    return length, float(np.sqrt(along @ (covariances[0] + covariances[1]) @ along))


class VerifyStep:
    """A range image of parallel planes at known heights to the error of each height.

    All planes are fitted at once, with one direction. Heights are counted from the lowest (farthest) plane that belongs
    to them; each error's uncertainty has the direction's in it.

    References
    ----------
    VDI/VDE 2634 part 2 (2012), length measurement errors; ISO 5436-1 for heights between parallel planes.
    """

    name: ClassVar[str] = "verify-step"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a range image of parallel planes at known heights to the error of each height"
    inputs: ClassVar[Mapping[str, Any]] = _INPUTS
    optional: ClassVar[frozenset[str]] = _OPTIONAL
    output: ClassVar[type] = Verification

    class Params(VerifyParams, frozen=True, kw_only=True):
        """Parameters."""

        heights_mm: Annotated[
            tuple[Annotated[float, Meta(gt=0, le=1e5)], ...],
            Meta(max_length=100, description="nominal, above the lowest plane", extra_json_schema=_MM),
        ] = (10.0,)

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Verification:
        """Return `step_error`, the worst, and `step_N_height` and `step_N_error` of each.

        Raises
        ------
        DataError
            no parallel planes, or none at these heights.
        """
        from fringed_plugins.calibration.artefacts.step import steps_of

        scene = scene_of(inputs, self.name, params)
        heights = [expanded(height, params) for height in params.heights_mm]
        context.progress(0.1, "looking for parallel planes")
        try:
            steps = steps_of(scene.xyz_mm, scene.valid, heights, scene.sigma_mm, params.smooth_px)
            field = _field_mm(scene)
        except ValueError as error:
            raise DataError(f"{self.name}: {error}") from error
        found = _step_findings(steps, params, field)
        return verification("step", scene, steps.inside > 0, found, (inputs, params, context))


def _step_findings(steps: Steps, params: VerifyStep.Params, field: float) -> Findings:
    found = Findings()
    errors = steps.heights_mm - steps.nominal_mm
    doubts = np.hypot(np.sqrt(np.diag(steps.covariance)), params.artefact_uncertainty_mm)
    worst = int(np.argmax(np.abs(errors)))
    found.judged("step_error", errors[worst], doubts[worst], LENGTH_SHARE, field)
    rough = max(plane.form.range_mm for plane in steps.planes)
    for number, (height, error, doubt) in enumerate(zip(steps.heights_mm, errors, doubts, strict=True), 1):
        found.figures |= {f"step_{number}_height": float(height), f"step_{number}_error": float(error)}
        found.uncertainties[f"step_{number}_error"] = float(doubt)
        found.nominal[f"step_{number}"] = float(steps.nominal_mm[number - 1])
    residual = steps.residual_mm[steps.inside > 0]
    found.figures |= {"raw_rms": float(np.sqrt(np.mean(residual**2))), "largest_flatness_error": rough, "field": field}
    found.figures |= _direction(steps.normal) | {"offset": steps.lowest_mm}
    if len(steps.heights_mm) < len(params.heights_mm):
        found.notes.append(
            "the plane that the heights are above is out of view: they are counted from the lowest of them"
        )
    return found
