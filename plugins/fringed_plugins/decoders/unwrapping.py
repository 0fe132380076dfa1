"""Spatial unwrapping: of one wrapped phase, and of the thesis's difference of object and reference.

Owns parameters and the translation between the contract's types and arrays; the algorithms are in `unwrap`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Float32Array, PhaseMap, Provenance, Reject
from fringed.errors import DataError
from fringed.hookspecs import Context

_PX, _ONE = {"units": "px"}, {"units": "1"}


class UnwrapParams(hookspecs.Params, frozen=True, kw_only=True):
    """Parameters."""

    method: Annotated[
        Literal["quality-guided", "branch-cut", "least-squares"],
        Meta(description="how neighbours are joined", extra_json_schema=_ONE),
    ] = "quality-guided"
    min_region_px: Annotated[int, Meta(ge=1, description="smaller regions are dropped", extra_json_schema=_PX)] = 400
    weigh_by_modulation: Annotated[
        bool, Meta(description="trust dark pixels less; branch cuts do not weigh", extra_json_schema=_ONE)
    ] = True
    longest_cut_px: Annotated[
        int, Meta(ge=1, le=4096, description="branch-cut: the longest cut between two residues", extra_json_schema=_PX)
    ] = 200
    max_iterations: Annotated[
        int, Meta(ge=1, le=10000, description="least-squares: iterations until it fails", extra_json_schema=_ONE)
    ] = 200


class Unwrap:
    """One wrapped phase, unwrapped in space.

    The result is "relative": the multiple of 2 pi of each connected region is a convention, such that the
    region's median lies within (-pi, pi]. Steps of more than half a period come out wrong by multiples of
    2 pi; no spatial method can know better. Decode several frequencies where there are steps.

    References
    ----------
    Herraez et al. 2002; Goldstein, Zebker, Werner 1988; Ghiglia, Romero 1994.
    """

    name: ClassVar[str] = "unwrap"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "one wrapped phase, unwrapped in space"
    inputs: ClassVar[Mapping[str, Any]] = {"phase": PhaseMap}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = PhaseMap

    Params: ClassVar[type[hookspecs.Params]] = UnwrapParams

    def run(self, inputs: Mapping[str, Any], params: UnwrapParams, context: Context) -> PhaseMap:
        """Return the unwrapped phase.

        Raises
        ------
        DataError
            a phase that is not wrapped, or that least squares cannot fit.
        """
        phase = inputs.get("phase")
        if not isinstance(phase, PhaseMap):
            raise DataError(f"unwrap takes a PhaseMap named 'phase'; it was given {type(phase).__name__}")
        _check_wrapped("phase", phase, self.name)
        context.check_cancelled()
        whole = replace(phase, id="", scan="", provenance=Provenance(), confidence=None, wrapped_rad=phase.phase_rad)
        return _unwrapped(whole, params, context)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        _warm_up()


class UnwrapDifference:
    """Object phase minus reference phase, unwrapped in space.

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
            phase maps that are not wrapped, or not of the same fringes and size; least squares that do not fit.
        """
        reference, body = inputs.get("reference"), inputs.get("object")
        if not isinstance(reference, PhaseMap) or not isinstance(body, PhaseMap):
            raise DataError("unwrap-difference takes the wrapped phase maps 'reference' and 'object'")
        _check_pair(reference, body)
        context.check_cancelled()
        difference = PhaseMap(
            phase_rad=_wrapped(body.phase_rad - reference.phase_rad),
            modulation=np.minimum(reference.modulation, body.modulation),
            background=body.background,
            rejected=reference.rejected | body.rejected,
            kind="wrapped",
            period_px=body.period_px,
            orientation=body.orientation,
            sigma_rad=_both_sigmas(reference, body),
            wrapped_rad=body.phase_rad,
            difference_to=next(iter(reference.provenance.inputs), reference.id),
            projector_px=body.projector_px,
        )
        return _unwrapped(difference, params, context)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load the kernels."""
        _warm_up()


def _unwrapped(wrapped: PhaseMap, params: UnwrapParams, context: Context) -> PhaseMap:
    """Return the map with its phase unwrapped, and say what regions it has."""
    context.progress(0.1, "unwrapping")
    quality = wrapped.modulation if params.weigh_by_modulation else None
    try:
        phase_rad, sizes = _by_method(wrapped.phase_rad, quality, params, context)
    except ValueError as error:
        raise DataError(f"the phase cannot be unwrapped: {error}") from error
    lost = (wrapped.rejected == 0) & ~np.isfinite(phase_rad)
    told = ", ".join(f"{size} px" for size in sizes[:5]) + (", ..." if len(sizes) > 5 else "")
    dropped = np.count_nonzero(lost)
    context.log("info", f"{len(sizes)} connected regions: {told or 'nothing left'}; {dropped} px dropped")
    rejected = wrapped.rejected | np.where(lost, np.uint16(Reject.ISOLATED), np.uint16(0))
    return replace(wrapped, phase_rad=phase_rad, rejected=rejected, kind="relative")


def _by_method(
    phase_rad: Float32Array, quality: Float32Array | None, params: UnwrapParams, context: Context
) -> tuple[Any, tuple[int, ...]]:
    """Return the unwrapped phase and the sizes of its regions."""
    least, threads = params.min_region_px, context.threads
    if params.method == "branch-cut":
        from fringed_plugins.unwrap.branch_cut import unwrap_branch_cut

        cut = unwrap_branch_cut(phase_rad, params.longest_cut_px, least, threads)
        level = "warning" if cut.charged else "info"
        context.log(level, f"{cut.residues} residues; {cut.charged} clusters of them found no balance")
        return cut.phase_rad, cut.sizes
    if params.method == "least-squares":
        return _by_least_squares(phase_rad, quality, params, context)
    from fringed_plugins.unwrap.spatial import unwrap

    result = unwrap(phase_rad, quality, least, threads)
    return result.phase_rad, result.sizes


def _by_least_squares(
    phase_rad: Float32Array, quality: Float32Array | None, params: UnwrapParams, context: Context
) -> tuple[Any, tuple[int, ...]]:
    from fringed_plugins.unwrap.least_squares import Limits, unwrap_least_squares

    def told(iteration: int, residual: float) -> None:
        context.progress(0.1 + 0.8 * iteration / params.max_iterations, f"residual {residual:.2g}")

    limits = Limits(iterations=params.max_iterations)
    fit = unwrap_least_squares(
        phase_rad, quality, params.min_region_px, limits=limits, told=told, threads=context.threads
    )
    if not fit.converged:
        raise DataError(
            f"least-squares unwrapping: {fit.reason}; the residual is {fit.residual:.2g}, it must be below "
            f"{limits.residual:g}: allow more max_iterations, mask what is dark, or use the method quality-guided"
        )
    context.log("info", f"{fit.iterations} iterations; {fit.reason}")
    return fit.phase_rad, fit.sizes


def _warm_up() -> None:
    from fringed_plugins.unwrap.branch_cut import unwrap_branch_cut
    from fringed_plugins.unwrap.least_squares import unwrap_least_squares
    from fringed_plugins.unwrap.spatial import unwrap

    wild = np.float32(3) * np.sin(np.arange(400, dtype=np.float32) ** 2).reshape(20, 20)
    calm = np.zeros((20, 20), np.float32)
    calm[:, 10] = np.nan
    for phase in (calm, wild):
        unwrap(phase, np.ones_like(phase), threads=1)
        unwrap_branch_cut(phase, threads=1)
    unwrap_least_squares(wild, calm + 1, threads=1)


def _check_wrapped(name: str, phase: PhaseMap, plugin: str) -> None:
    if phase.kind != "wrapped":
        raise DataError(f"the {name}'s phase is {phase.kind}; {plugin} takes wrapped phases")


def _check_pair(reference: PhaseMap, body: PhaseMap) -> None:
    for name, phase in (("reference", reference), ("object", body)):
        _check_wrapped(name, phase, UnwrapDifference.name)
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
