"""Registers triangulation: phase and calibration to range images.

Owns parameters and the translation between the contract's types and arrays; the geometry is in
`calibration`, imported when first used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt
from msgspec import Meta

from fringed import __version__
from fringed.data import Calibration, Float32Array, FrameSet, PhaseMap, RangeImage
from fringed.errors import DataError
from fringed.hookspecs import Context, hookimpl
from fringed_plugins.calibrators.ranging import RangeParams, checked, range_image, rig_of
from fringed_plugins.decoders.tone_drift import warn_of_drift

_MM = {"units": "mm"}
_DEPTH_PLANE_FRACTION = 0.3
_PLANE_RAD = 0.3


class Triangulate:
    """Absolute phase to points: each camera ray meets the surface of its projector column or row.

    Both lenses' distortions are taken exactly. The deviation of a point along its ray is the phase's times the
    geometry's sensitivity, and what the calibration's covariance leaves there. A calibration with a model of each pixel
    (`fit-pixel-model`) is used by that model, within the depths that it was fitted in. Points that continue no surface
    (flyers) are dropped (`DISCONTINUITY`). Of the optional `frames` it looks at the second harmonic, and warns where
    the projector's tone has drifted.

    References
    ----------
    Zhang & Huang 2006; thesis.md, section 3.
    """

    name: ClassVar[str] = "triangulate"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "absolute phase and calibration to a range image"
    inputs: ClassVar[Mapping[str, Any]] = {"phase": PhaseMap, "calibration": Calibration, "frames": FrameSet}
    optional: ClassVar[frozenset[str]] = frozenset({"frames"})
    output: ClassVar[type] = RangeImage

    class Params(RangeParams, frozen=True, kw_only=True):
        """Parameters."""

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> RangeImage:
        """Return the range image.

        Raises
        ------
        DataError
            a phase that is not absolute, or a calibration of another rig, camera or projector.
        """
        phase, calibration = checked(inputs, self.name, params, context)
        if phase.kind != "absolute":
            raise DataError(
                f"triangulate takes an absolute phase; this one is {phase.kind}: decode several frequencies, or unwrap "
                "the difference to a reference plane and use 'reference-plane'"
            )
        context.check_cancelled()
        frames = inputs.get("frames")
        if isinstance(frames, FrameSet):
            warn_of_drift(frames, calibration, context)
        return range_image(phase, phase.phase_rad, calibration, params, context)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        from fringed_plugins.calibration.rig import Pinhole, projector_axis
        from fringed_plugins.calibration.triangulate import Measured, triangulate

        matrix = np.array([[8.0, 0, 3.5], [0, 8.0, 3.5], [0, 0, 1]])
        lens, transform, zeros = Pinhole(8, 8, matrix, np.zeros(5)), np.eye(4), np.zeros((8, 8), np.float32)
        transform[0, 3] = -1.0
        mask = np.zeros((8, 8), np.uint16)
        axis = projector_axis(lens, transform, "columns")
        triangulate(Measured(zeros, mask, zeros, zeros), lens, axis, (8.0, 0.0), threads=1)


class ReferencePlane:
    """The unwrapped difference to the reference plane, to points.

    The plane's own absolute phase is predicted from the calibration for every pixel; with the difference
    added the geometry is the full one, not the textbook's h = L dphi / (dphi + 2 pi f0 D), which holds for
    an ideal rig only. The multiple of 2 pi of each region, which spatial unwrapping cannot know, is the
    given one where the reference plane itself is in view (many differences near 0), and otherwise the one
    that brings the region's median nearest to `expected_depth_mm`. Where that depth decides, a warning says
    so if it was left to the default: the whole region may then be off by whole periods of depth. `sigma_mm`
    is the noise of the phase and does not contain this doubt.

    References
    ----------
    thesis.md, section 3, eqs. 3.2-3.7 and 3.21-3.27.
    """

    name: ClassVar[str] = "reference-plane"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "phase difference to the reference plane and calibration to a range image"
    inputs: ClassVar[Mapping[str, Any]] = {"phase": PhaseMap, "calibration": Calibration}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = RangeImage

    class Params(RangeParams, frozen=True, kw_only=True):
        """Parameters."""

        expected_depth_mm: Annotated[
            float,
            Meta(ge=0, description="middle of the object; 0: where the rig is aimed", extra_json_schema=_MM),
        ] = 0.0
        offset_periods: Annotated[
            int, Meta(ge=-1000, le=1000, description="added to every region", extra_json_schema={"units": "periods"})
        ] = 0  # fmt: skip

    def run(self, inputs: Mapping[str, Any], params: Params, context: Context) -> RangeImage:
        """Return the range image.

        Raises
        ------
        DataError
            a phase that is no difference, or a calibration without a reference plane or of another rig.
        """
        from fringed_plugins.calibration.reference import period_depth_mm, phase_at_depth, plane_depth

        phase, calibration = checked(inputs, self.name, params, context)
        if phase.kind != "relative":
            raise DataError(f"reference-plane takes a relative phase (a difference); this one is {phase.kind}")
        if calibration.reference_plane is None:
            raise DataError(
                "the calibration has no reference plane; calibrate with one, or several frequencies with 'triangulate'"
            )
        context.check_cancelled()
        camera, axis, fringes = rig_of(phase, calibration)
        depth = plane_depth(camera, calibration.reference_plane, context.threads)
        plane_rad = phase_at_depth(camera, axis, fringes, depth, context.threads)
        context.progress(0.4, "reference plane")
        expected = params.expected_depth_mm or _aim_mm(calibration)
        expected_rad = phase_at_depth(camera, axis, fringes, np.full_like(depth, expected), context.threads) - plane_rad
        shift, guessed = _shift_rad(phase, expected_rad.astype(np.float32))
        if guessed.any():
            step = period_depth_mm(camera, axis, fringes, expected, guessed)
            share = np.count_nonzero(guessed) / np.count_nonzero(np.isfinite(phase.phase_rad))
            _tell_guess(context, params.expected_depth_mm > 0, (expected, step, share))
        shift += np.float32(2 * np.pi * params.offset_periods)
        absolute = (plane_rad + phase.phase_rad + shift).astype(np.float32)
        context.progress(0.6, "triangulation")
        return range_image(phase, absolute, calibration, params, context)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        Triangulate.warm_up()


def _aim_mm(calibration: Calibration) -> float:
    from fringed_plugins.calibration.reference import axes_crossing_mm

    try:
        return axes_crossing_mm(calibration.T_projector_camera)
    except ValueError as error:
        raise DataError(f"expected_depth_mm is not given, and {error}") from error


def _shift_rad(phase: PhaseMap, expected_rad: Float32Array) -> tuple[Float32Array, npt.NDArray[np.bool_]]:
    """Return the multiple of 2 pi to add at each pixel, and where what is expected decided it."""
    from fringed_plugins.calibration.reference import nearest_orders
    from fringed_plugins.unwrap.regions import connected_regions

    regions = connected_regions(np.isfinite(phase.phase_rad))
    shifts = nearest_orders(phase.phase_rad, regions, expected_rad)
    near_plane = np.bincount(regions[np.abs(phase.phase_rad) < _PLANE_RAD], minlength=len(shifts))
    sizes = np.maximum(np.bincount(regions.ravel(), minlength=len(shifts)), 1)
    on_plane = near_plane > _DEPTH_PLANE_FRACTION * sizes
    shifts[on_plane] = 0.0
    return shifts[regions], (regions > 0) & ~on_plane[regions]


def _tell_guess(context: Context, given: bool, guess: tuple[float, float, float]) -> None:
    """Log that a depth decided the period; `guess` is that depth, a period's depth (mm), the share of pixels."""
    expected, step, share = guess
    if given:
        text = f"expected_depth_mm = {expected:g} decides the period of {share:.0%} of the pixels"
        context.log("info", f"{text}; one period is {step:.1f} mm of depth there")
        return
    context.log(
        "warning",
        f"the depth of {share:.0%} of the pixels is a guess: the reference plane is not in view there, and "
        f"expected_depth_mm is not given, so that {expected:.1f} mm, where the rig is aimed, decides; it may be wrong "
        f"by multiples of {step:.1f} mm, one period. Set expected_depth_mm to the depth of the object's middle, within "
        f"{step / 2:.1f} mm; or show the plane beside the object, or use several frequencies",
    )


@hookimpl
def register_processors() -> Sequence[type[Any]]:
    """Return triangulation and the reference-plane method."""
    return (Triangulate, ReferencePlane)
