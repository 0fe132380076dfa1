"""What became of a rig since it was calibrated: two calibrations compared, and one put right by a pose of the board.

Owns the documents and the translation; the geometry is `calibration.solve`'s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Artifact, BoardView, Calibration, Float64Array
from fringed.errors import DataError
from fringed.hookspecs import Context
from fringed_plugins.calibrators.calibrate import observed

if TYPE_CHECKING:
    from fringed_plugins.calibration.solve.compare import Geometry
    from fringed_plugins.calibration.solve.infield import Corrected

_MM, _PX = {"units": "mm"}, {"units": "px"}
_DEPTHS = 5
_CERTAIN = 2.0
_USUAL = (0.9, 1.1)  # of the depth where a rig is aimed, where no poses say more


class CompareCalibrations:
    """Two calibrations of one rig to what differs: each number in its deviations, and points in millimetres.

    The displacement is between points of equal pixels of camera and projector, over the depths of the poses: what a
    scan would show. Numbers trade against each other, so their differences alone say little. It is drift where it is
    more than `max_drift_mm`, and more than twice what both calibrations' covariances leave.

    References
    ----------
    JCGM 100:2008 (GUM); VDI/VDE 2634 part 2, section 6 (monitoring).
    """

    name: ClassVar[str] = "compare-calibrations"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "two calibrations of one rig to their differences, in deviations and in millimetres"
    inputs: ClassVar[Mapping[str, Any]] = {"a": Calibration, "b": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Artifact

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        max_drift_mm: Annotated[
            float,
            Meta(gt=0, le=1e3, description="RMS displacement that is no drift in any case", extra_json_schema=_MM),
        ] = 0.03
        depths_mm: Annotated[
            tuple[Annotated[float, Meta(gt=0)], ...],
            Meta(max_length=50, description="where; empty: over the poses' depths", extra_json_schema=_MM),
        ] = ()

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Artifact:
        """Return JSON: `verdict` ("same" or "drifted"), `rms_mm`, `max_mm`, `expected_mm`, `depths_mm`, `parameters`.

        Raises
        ------
        DataError
            calibrations of other rigs, sizes or models.
        """
        from fringed_plugins.calibration.solve.compare import displacement_mm

        a, b = inputs["a"], inputs["b"]
        _comparable(a, b)
        depths: Float64Array = np.array(params.depths_mm or _depths_mm(a, b))
        try:
            off = displacement_mm(_geometry(a), _geometry(b), depths)
        except ValueError as error:
            raise DataError(f"{self.name}: {error}") from error
        length = np.linalg.norm(off, axis=-1)
        if not np.isfinite(length).any():
            raise DataError(
                f"no point at {depths.min():g} to {depths.max():g} mm lies in both pictures; give depths_mm"
            )
        rms, most = float(np.sqrt(np.nanmean(length**2))), float(np.nanmax(length))
        expected = float(np.hypot(_trueness_mm(a, depths), _trueness_mm(b, depths)))
        same = rms <= max(params.max_drift_mm, _CERTAIN * expected)
        table = {
            "a": a.id or a.hash, "b": b.id or b.hash, "verdict": "same" if same else "drifted",
            "rms_mm": rms, "max_mm": most, "expected_mm": expected, "max_drift_mm": params.max_drift_mm,
            "depths_mm": depths.tolist(),
            "parameters": _numbers(a, b),
        }  # fmt: skip
        return Artifact("comparison.json", "application/json", np.frombuffer(json.dumps(table).encode(), np.uint8))


class InfieldCorrection:
    """One or a few poses of a board, and a calibration, to the calibration with the projector where it stands now.

    For a rig that was knocked: the lenses are taken as they were, the projector's place is estimated anew. A view that
    contradicts the lenses is refused: then the rig has to be calibrated.

    References
    ----------
    Zhang & Huang 2006; the adjustment of `calibrate`, with the lenses held.
    """

    name: ClassVar[str] = "infield-correction"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "a pose of a board and a calibration to one with the projector's present place"
    inputs: ClassVar[Mapping[str, Any]] = {"views": (BoardView,), "calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Calibration

    class Params(hookspecs.Params, frozen=True, kw_only=True):
        """Parameters."""

        max_rms_px: Annotated[
            float, Meta(gt=0, le=10, description="largest residual that is accepted, RMS", extra_json_schema=_PX)
        ] = 0.3

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> Calibration:
        """Return the corrected calibration; its residuals say how far the projector had moved.

        Raises
        ------
        DataError
            views of another rig, or that contradict the calibration.
        """
        from fringed_plugins.calibration.solve.infield import corrected
        from fringed_plugins.calibration.solve.observations import Rig

        views, old = inputs["views"], inputs["calibration"]
        _check_views(views, old)
        geometry = _geometry(old)
        begun = Rig(geometry.camera, geometry.projector, old.T_projector_camera, np.zeros((0, 4, 4)))
        try:
            found = corrected([observed(v, k) for k, v in enumerate(views)], begun, accepted_px=params.max_rms_px)
        except ValueError as error:
            raise DataError(f"no correction: {error}") from error
        told = (
            f"put right by {len(views)} pose(s): the projector had turned by {found.turned_deg:.3f} degrees and moved "
            f"by {found.moved_mm:.2f} mm; its residuals fell from {found.before_px:.2f} to {found.after_px:.3f} px"
        )
        context.log("info", told)
        residuals = {
            **old.residuals, "infield_turned_deg": found.turned_deg, "infield_moved_mm": found.moved_mm,
            "infield_before_px": found.before_px, "infield_after_px": found.after_px,
        }  # fmt: skip
        result: Calibration = replace(
            old, T_projector_camera=found.rig.T_projector_camera, source="infield", residuals=residuals,
            covariance=_covariance(old, found), notes=(*old.notes, told), id="",
        )  # fmt: skip
        return result


def _comparable(a: Calibration, b: Calibration) -> None:
    if a.rig and b.rig and a.rig != b.rig:
        raise DataError(
            f"the calibrations are of the rigs {a.rig!r} and {b.rig!r}; only those of one rig can be compared"
        )
    if "pixel" in (a.model, b.model):
        raise DataError(
            "a calibration with a model of each pixel has no numbers to compare; verify it with an artefact"
        )


def _geometry(calibration: Calibration) -> Geometry:
    from fringed_plugins.calibration.rig import Pinhole
    from fringed_plugins.calibration.solve.compare import Geometry

    camera, projector = (
        Pinhole(lens.width_px, lens.height_px, lens.matrix, lens.distortion)
        for lens in (calibration.camera, calibration.projector)
    )
    return Geometry(camera, projector, calibration.T_projector_camera)


def _depths_mm(a: Calibration, b: Calibration) -> list[float]:
    from fringed_plugins.calibration.reference import axes_crossing_mm

    used = [fit.T_camera_board[2, 3] for one in (a, b) for fit in one.views if not fit.note]
    if used:
        return [float(depth) for depth in np.linspace(min(used), max(used), _DEPTHS)]
    try:
        aim = axes_crossing_mm(a.T_projector_camera)
    except ValueError as error:
        raise DataError(f"depths_mm is not given, and {error}") from error
    return [float(aim * part) for part in np.linspace(*_USUAL, _DEPTHS)]


def _trueness_mm(one: Calibration, depths: Float64Array) -> float:
    """Return the deviation of points that a calibration's covariance leaves, RMS; 0 where it has none."""
    from fringed_plugins.calibration.pixel.uncertainty import trueness_mm

    if one.covariance is None:
        return 0.0
    rig = _geometry(one)
    sigma = trueness_mm(
        rig.camera, rig.projector, rig.T_projector_camera, one.covariance, one.parameters, depths_mm=depths
    )
    return float(np.sqrt(np.nanmean((sigma**2).sum(axis=-1))))


def _numbers(a: Calibration, b: Calibration) -> list[dict[str, Any]]:
    from fringed_plugins.calibration.pixel.derivatives import NUMBERS
    from fringed_plugins.calibration.solve.adjustment import lens_numbers
    from fringed_plugins.calibration.solve.compare import normalised
    from fringed_plugins.calibration.solve.observations import rotation_vector

    values, spreads = [], []
    middle = a.T_projector_camera[:3, :3]
    for one in (a, b):
        geometry = _geometry(one)
        turn = rotation_vector(one.T_projector_camera[:3, :3] @ middle.T)
        values.append(np.concatenate([
            lens_numbers(geometry.camera), lens_numbers(geometry.projector), turn, one.T_projector_camera[:3, 3],
        ]))  # fmt: skip
        known = (
            dict(zip(one.parameters, np.sqrt(np.diag(one.covariance)), strict=True))
            if one.covariance is not None
            else {}
        )
        spreads.append(np.array([float(known.get(name, 0.0)) for name in NUMBERS]))
    difference, ratio = normalised((values[0], spreads[0]), (values[1], spreads[1]))
    return [
        {
            "name": name, "a": float(values[0][k]), "b": float(values[1][k]), "difference": float(difference[k]),
            "deviations": float(ratio[k]) if np.isfinite(ratio[k]) else None,
        }
        for k, name in enumerate(NUMBERS)
    ]  # fmt: skip


def _check_views(views: Any, old: Calibration) -> None:
    if not isinstance(views, (list, tuple)) or not views or not all(isinstance(v, BoardView) for v in views):
        raise DataError("infield-correction takes one or more board views named 'views'")
    sizes = ((old.camera.width_px, old.camera.height_px), (old.projector.width_px, old.projector.height_px))
    for number, view in enumerate(views):
        name = view.name or f"view {number + 1}"
        if not view.found:
            raise DataError(f"{name} shows no board: {view.reason}")
        if (view.camera_size_px, view.projector_size_px) != sizes:
            raise DataError(
                f"{name} is of pictures of {view.camera_size_px} and {view.projector_size_px} px, the calibration of "
                f"{sizes[0]} and {sizes[1]}"
            )
        if old.rig and view.provenance.rig and old.rig != view.provenance.rig:
            raise DataError(f"{name} is of the rig {view.provenance.rig!r}, the calibration of {old.rig!r}")
    if old.model == "pixel":
        raise DataError("a calibration with a model of each pixel cannot be put right by a pose; fit it anew")


def _covariance(old: Calibration, found: Corrected) -> Float64Array | None:
    """Return the old lenses' covariance, and with it that of the projector's new place, in the old order."""
    from fringed_plugins.calibration.pixel.derivatives import NUMBERS

    if old.covariance is None:
        return None
    at = [old.parameters.index(name) if name in old.parameters else None for name in NUMBERS]
    lenses = np.array([
        [0.0 if i is None or j is None else old.covariance[i, j] for j in at[:18]] for i in at[:18]
    ])  # fmt: skip
    whole = found.covariance_with(lenses)
    result = old.covariance.copy()
    kept = [(place, i) for place, i in enumerate(at) if i is not None]
    for place, i in kept:
        for other, j in kept:
            result[i, j] = whole[place, other]
    return result
