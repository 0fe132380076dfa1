"""The thesis's way to phase: the difference of object and reference, unwrapped in space.

Owns parameters and the translation between the contract's types and arrays; the algorithm is in `unwrap`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Float32Array, PhaseMap, Reject, UInt16Array
from fringed.errors import DataError
from fringed.hookspecs import Context


class UnwrapParams(hookspecs.Params, frozen=True, kw_only=True):
    """Parameters."""

    min_region_px: Annotated[
        int, Meta(ge=1, description="smaller regions are dropped", extra_json_schema={"units": "px"})
    ] = 400


class UnwrapDifference:
    """Object phase minus reference phase, unwrapped along the most reliable pixels first.

    The result is "relative". The multiple of 2 pi of each region is a convention: the region's median
    lies within (-pi, pi], so that what is seen of the reference plane itself is near 0. Steps of more
    than half a period, and whatever a shadow cuts off, come out wrong by multiples of 2 pi; no spatial
    method can know better. Positive or negative, the sign follows the side that the projector is on.

    References
    ----------
    Herraez et al. 2002; thesis.md, sections 2 and 3.
    """

    name: ClassVar[str] = "unwrap-difference"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "object minus reference phase, unwrapped in space"
    inputs: ClassVar[Mapping[str, Any]] = {"reference": PhaseMap, "object": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    Params: ClassVar[type[hookspecs.Params]] = UnwrapParams

    def run(self, inputs: Mapping[str, Any], params: UnwrapParams, context: Context) -> PhaseMap:
        """Return the unwrapped difference.

        Raises
        ------
        DataError
            phase maps that are not wrapped, or not of the same fringes and size.
        """
        from fringed_plugins.unwrap.spatial import unwrap

        reference, body = inputs.get("reference"), inputs.get("object")
        if not isinstance(reference, PhaseMap) or not isinstance(body, PhaseMap):
            raise DataError("unwrap-difference takes the wrapped phase maps 'reference' and 'object'")
        _check_pair(reference, body)
        context.check_cancelled()
        difference = body.phase_rad - reference.phase_rad
        modulation = np.minimum(reference.modulation, body.modulation)
        context.progress(0.1, "unwrapping")
        result = unwrap(_wrapped(difference), modulation, params.min_region_px, context.threads)
        rejected: UInt16Array = reference.rejected | body.rejected
        lost = (rejected == 0) & ~np.isfinite(result.phase_rad)
        rejected = rejected | np.where(lost, np.uint16(Reject.ISOLATED), np.uint16(0))
        sizes = ", ".join(f"{size} px" for size in result.sizes[:5])
        context.log("info", f"{len(result.sizes)} connected regions: {sizes or 'nothing left'}")
        return PhaseMap(
            phase_rad=result.phase_rad,
            modulation=modulation,
            background=body.background,
            rejected=rejected,
            kind="relative",
            period_px=body.period_px,
            orientation=body.orientation,
            sigma_rad=_both_sigmas(reference, body),
            wrapped_rad=body.phase_rad,
            difference_to=next(iter(reference.provenance.inputs), reference.id),
            projector_px=body.projector_px,
        )

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        from fringed_plugins.unwrap.spatial import unwrap

        unwrap(np.zeros((8, 8), np.float32), threads=1)


def _check_pair(reference: PhaseMap, body: PhaseMap) -> None:
    for name, phase in (("reference", reference), ("object", body)):
        if phase.kind != "wrapped":
            raise DataError(f"the {name}'s phase is {phase.kind}; unwrap-difference takes wrapped phases")
    if reference.phase_rad.shape != body.phase_rad.shape:
        raise DataError(
            f"the reference has {reference.phase_rad.shape} pixels, the object {body.phase_rad.shape}; "
            "take both with the same camera settings"
        )
    mine = (body.period_px, body.orientation, body.initial_phase_rad)
    other = (reference.period_px, reference.orientation, reference.initial_phase_rad)
    if mine != other:
        raise DataError(
            f"the object's fringes (period, orientation, initial phase) are {mine}, the reference's {other}; "
            "they must be the same"
        )


def _wrapped(phase_rad: Float32Array) -> Float32Array:
    turns = np.float32(2 * np.pi)
    return np.asarray(phase_rad - turns * np.rint(phase_rad / turns), np.float32)


def _both_sigmas(reference: PhaseMap, body: PhaseMap) -> Float32Array | None:
    if reference.sigma_rad is None or body.sigma_rad is None:
        return None
    return np.hypot(reference.sigma_rad, body.sigma_rad)
