"""A phase map and a calibration to a range image, by whichever model the calibration has.

Owns what has to fit together, and says why it does not; the geometry is in `calibration`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from msgspec import Meta

from fringed.data import Calibration, Float32Array, Lens, PhaseMap, PixelModel, Provenance, RangeImage
from fringed.errors import DataError
from fringed.hookspecs import Context, Params

if TYPE_CHECKING:
    from fringed_plugins.calibration.depth_kernel import PixelForm
    from fringed_plugins.calibration.rig import Axis, Pinhole
    from fringed_plugins.calibration.triangulate import Points, Tolerances

_MM = {"units": "mm"}
_PX = {"units": "px on the object"}
_MIN_SENSITIVITY = 0.05
_BEYOND = 0.05  # of the range of depths that a pixel model was fitted in


class RangeParams(Params, frozen=True, kw_only=True):
    """Which points are kept."""

    min_depth_mm: Annotated[float, Meta(ge=0, description="nearest depth kept", extra_json_schema=_MM)] = 0.0
    max_depth_mm: Annotated[
        Annotated[float, Meta(gt=0)] | None,
        Meta(description="farthest depth kept; unset: no limit", extra_json_schema=_MM),
    ] = None
    max_bend: Annotated[
        float,
        Meta(gt=0, le=1e3, description="largest departure from the neighbours' line", extra_json_schema=_PX),
    ] = 1.5
    max_slope: Annotated[
        float,
        Meta(gt=0, le=1e3, description="steepest surface, tangent to the view", extra_json_schema={"units": "1"}),
    ] = 8.0
    max_sigma_ratio: Annotated[
        float,
        Meta(gt=1, le=1e6, description="largest deviation over the median's", extra_json_schema={"units": "1"}),
    ] = 7.0
    keep_flyers: Annotated[
        bool, Meta(description="keep points that continue no surface, or deviate much more than most")
    ] = False
    any_rig: Annotated[
        bool, Meta(description="your word that phase and calibration are of one rig, though named differently")
    ] = False


def checked(
    inputs: Mapping[str, Any], name: str, params: RangeParams, context: Context
) -> tuple[PhaseMap, Calibration]:
    """Return the phase map and the calibration that belongs to it.

    Raises
    ------
    DataError
        something else, or of another rig, camera or projector.
    """
    phase, calibration = inputs.get("phase"), inputs.get("calibration")
    if not isinstance(phase, PhaseMap) or not isinstance(calibration, Calibration):
        raise DataError(
            f"{name} takes a PhaseMap 'phase' and a Calibration 'calibration'; it was given "
            f"{type(phase).__name__} and {type(calibration).__name__}: calibrate the rig, or name its calibration file"
        )
    check_pair(phase, calibration, params.any_rig, context)
    return phase, calibration


def check_pair(phase: PhaseMap, calibration: Calibration, any_rig: bool, context: Context) -> None:
    """Raise DataError where a phase map is of another rig, camera or projector than the calibration."""
    _check_sizes(phase, calibration)
    taken, known = phase.provenance.rig, calibration.rig
    if any_rig or not taken or not known or taken == known:
        return
    told = f"the phase was taken by the rig {taken!r}, the calibration {calibration.hash} is of {known!r}"
    if not phase.provenance.replayed:
        raise DataError(
            f"{told}; calibrate this rig, or name its own calibration file. Where both names mean one rig, set "
            "any_rig = true"
        )
    context.log("warning", f"{told}: a station that replays has a name of its own; make sure they are one rig")


def _check_sizes(phase: PhaseMap, calibration: Calibration) -> None:
    height, width = phase.phase_rad.shape
    camera, projector = calibration.camera, calibration.projector
    if (camera.width_px, camera.height_px) != (width, height):
        raise DataError(
            f"the phase map is {width} x {height} px, the calibration's camera {camera.width_px} x {camera.height_px}; "
            "use the calibration of this camera at this resolution"
        )
    known = projector.width_px if phase.orientation == "columns" else projector.height_px
    if phase.projector_px not in (0, known):
        raise DataError(
            f"the fringes were made for a projector of {phase.projector_px} {phase.orientation}, the calibration is "
            f"for {known}; use the calibration of this projector"
        )


def pinhole(lens: Lens) -> Pinhole:
    """Return the lens as algorithms take it."""
    from fringed_plugins.calibration.rig import Pinhole

    return Pinhole(lens.width_px, lens.height_px, lens.matrix, lens.distortion)


def rig_of(phase: PhaseMap, calibration: Calibration) -> tuple[Pinhole, Axis, tuple[float, float]]:
    """Return the camera, the projector's axis that the phase counts along, and (period_px, initial_rad).

    Raises
    ------
    DataError
        an impossible calibration, or fringes that tell no depth.
    """
    from fringed_plugins.calibration.rig import projector_axis, sensitivity

    try:
        axis = projector_axis(pinhole(calibration.projector), calibration.T_projector_camera, phase.orientation)
    except ValueError as error:
        raise DataError(f"the calibration {calibration.hash} cannot be used: {error}") from error
    if sensitivity(axis) < _MIN_SENSITIVITY:
        other = "rows" if phase.orientation == "columns" else "columns"
        raise DataError(
            f"camera and projector stand side by side along the fringes, so that {phase.orientation} tell no depth; "
            f"project fringes along {other}"
        )
    return pinhole(calibration.camera), axis, (phase.period_px, phase.initial_phase_rad)


def range_image(
    phase: PhaseMap, absolute_rad: Float32Array, calibration: Calibration, params: RangeParams, context: Context
) -> RangeImage:
    """Return the points of `absolute_rad`, which stands for the phase map's own phase.

    Raises
    ------
    DataError
        as `rig_of`, a pixel model of another direction or picture, or a covariance that cannot be used.
    """
    from fringed_plugins.calibration.triangulate import Tolerances

    tolerances = Tolerances(
        near_mm=params.min_depth_mm,
        far_mm=params.max_depth_mm or float("inf"),
        bend_px=params.max_bend,
        step_px=params.max_slope,
        sigma_ratio=params.max_sigma_ratio,
        flyers=params.keep_flyers,
    )
    by_model = _by_pixels if calibration.model == "pixel" else _by_stereo
    points = by_model(phase, absolute_rad, calibration, tolerances, context.threads)
    simulated = phase.provenance.simulated or calibration.source == "exact-simulated"
    digest = calibration.hash  # of a model of each pixel, it is a hash of many megabytes
    return RangeImage(
        xyz_mm=points.xyz_mm,
        rejected=points.rejected,
        intensity=points.intensity,
        sigma_mm=points.sigma_mm if phase.sigma_rad is not None else None,
        calibration=digest,
        provenance=Provenance(calibration=digest, rig=calibration.rig, simulated=simulated),
    )


def _by_stereo(
    phase: PhaseMap, absolute_rad: Float32Array, calibration: Calibration, tolerances: Tolerances, threads: int
) -> Points:
    from fringed_plugins.calibration.triangulate import Measured, triangulate

    camera, axis, fringes = rig_of(phase, calibration)
    measured = Measured(absolute_rad, phase.rejected, phase.sigma_rad, phase.background)
    spread = _spread(phase, calibration, axis) if phase.sigma_rad is not None else None
    return triangulate(measured, camera, axis, fringes, tolerances=tolerances, spread=spread, threads=threads)


def _spread(phase: PhaseMap, calibration: Calibration, axis: Axis) -> Float32Array | None:
    """Return what the calibration's covariance leaves, or None where nothing is known of it."""
    from fringed_plugins.calibration.pixel.spread import spread_table
    from fringed_plugins.calibration.stereo import aim_mm

    if calibration.covariance is None:
        return None
    lenses = (pinhole(calibration.camera), pinhole(calibration.projector))
    known = (calibration.covariance, calibration.parameters)
    try:
        return spread_table(
            lenses, calibration.T_projector_camera, known, around_mm=aim_mm(axis), orientation=phase.orientation
        )
    except ValueError as error:
        raise DataError(f"the covariance of the calibration {calibration.hash} cannot be used: {error}") from error


def _by_pixels(
    phase: PhaseMap, absolute_rad: Float32Array, calibration: Calibration, tolerances: Tolerances, threads: int
) -> Points:
    from dataclasses import replace

    from fringed_plugins.calibration.triangulate import Measured, triangulate_pixels

    model = calibration.pixel_model
    assert model is not None  # the contract's own check
    _check_model(phase, calibration, model)
    near, far = model.z_range_mm
    margin = _BEYOND * (far - near)
    tolerances = replace(
        tolerances, near_mm=max(tolerances.near_mm, near - margin), far_mm=min(tolerances.far_mm, far + margin)
    )
    measured = Measured(absolute_rad, phase.rejected, phase.sigma_rad, phase.background)
    form = _form(phase, calibration, model)
    return triangulate_pixels(
        measured, pinhole(calibration.camera), form, scatter_mm=model.sigma_mm, tolerances=tolerances, threads=threads
    )


def _check_model(phase: PhaseMap, calibration: Calibration, model: PixelModel) -> None:
    if model.orientation != phase.orientation:
        raise DataError(
            f"the calibration's pixel model is of fringes that count {model.orientation}, these count "
            f"{phase.orientation}; project fringes along {model.orientation}, or fit a model of {phase.orientation}"
        )
    count, *size = model.coefficients.shape
    if tuple(size) != phase.phase_rad.shape:
        raise DataError(
            f"the pixel model has {size[1]} x {size[0]} px, the phase map {phase.phase_rad.shape[1]} x "
            f"{phase.phase_rad.shape[0]}; fit it with this camera at this resolution"
        )
    if count != 3 and (model.form != "polynomial" or count % 3):
        raise DataError(f"a pixel model of form {model.form!r} has not {count} coefficients; fit it again")
    if model.form == "height" and calibration.reference_plane is None:
        raise DataError(
            "heights are measured from a reference plane, and the calibration has none; fit the model again"
        )


def _form(phase: PhaseMap, calibration: Calibration, model: PixelModel) -> PixelForm:
    """Return the model for phases of the given period: the projector's column or row is what counts."""
    from fringed_plugins.calibration.depth_kernel import HEIGHT, POLYNOMIAL, RATIONAL, PixelForm

    kinds = {"rational": RATIONAL, "polynomial": POLYNOMIAL, "height": HEIGHT}
    stretch = phase.period_px / model.period_px
    shift = phase.initial_phase_rad * stretch - model.initial_phase_rad + model.phase_offset_rad
    plane = calibration.reference_plane if calibration.reference_plane is not None else np.zeros(4)
    return PixelForm(
        kinds[model.form], model.coefficients, plane, stretch * model.phase_scale, shift * model.phase_scale
    )
