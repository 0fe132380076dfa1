"""Registration and merging as processors: fetch arrays, call the algorithm, return the product.

Owns parameters, limits and the wording towards the user; the mathematics is in `registration`.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed.data import IterationRecord, Model, RangeImage, Registration
from fringed.errors import ConvergenceError, DataError
from fringed.hookspecs import Context, Params, hookimpl
from fringed_plugins.registration.chaining import Chain, ChainBrokenError, Link, chain
from fringed_plugins.registration.family.method import Method
from fringed_plugins.registration.family.pair import register_by
from fringed_plugins.registration.family.presets import METHODS
from fringed_plugins.registration.merging import merge
from fringed_plugins.registration.network import close_loops
from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.result import Alignment, Iteration, Report
from fringed_plugins.registration.surface import Surface, prepare
from fringed_plugins.registration.verify import Limits

Row = tuple[float, float, float, float]
_MM = {"units": "mm"}


class _PairParams(Params, frozen=True, kw_only=True):
    """What both processors take."""

    points: Annotated[int, Meta(ge=500, le=2_000_000, description="most smoothed points of the last stage")] = 40_000
    iterations: Annotated[
        int, Meta(ge=0, le=1000, description="most iterations of each stage; 0: the method's own, 20 to 100")
    ] = 0
    min_overlap: Annotated[float, Meta(ge=0.0, le=1.0, description="least part of the model on the reference")] = 0.2
    max_rms_mm: Annotated[
        float,
        Meta(ge=0.0, description="greatest residual; 0: 5 x noise or 0.1 % of the extent", extra_json_schema=_MM),
    ] = 0.0

    def options(self, threads: int, start: Sequence[Row] | None = None) -> Options:
        """Return the algorithm's options."""
        plain = Options()
        return Options(
            T_reference_model=None if start is None else np.array(start, np.float64),
            fine_points=self.points,
            fine_iterations=min(plain.fine_iterations, self.iterations or plain.fine_iterations),
            medium_points=min(plain.medium_points, self.points),
            medium=replace(plain.medium, iterations=self.iterations or plain.medium.iterations),
            limits=Limits(self.min_overlap, self.max_rms_mm),
            threads=threads,
        )


def _surface(view: RangeImage, name: str) -> Surface:
    sigma = view.sigma_mm
    return prepare(view.xyz_mm, view.rejected, sigma, f"{name} {view.id}".strip())


def _report(context: Context) -> Report:
    return lambda fraction, text: context.progress(min(max(fraction, 0.0), 1.0), text)


def _record(made: Iteration) -> IterationRecord:
    return IterationRecord(
        made.rms_mm, made.pairs, made.threshold_mm, made.rotation_rad, made.translation_mm, made.stage, made.alpha_mm
    )


def _product(alignment: Alignment, reference: str, model: str) -> Registration:
    return Registration(
        reference=reference,
        model=model,
        T_reference_model=alignment.T_reference_model,
        converged=alignment.converged,
        reason=alignment.reason,
        rms_mm=alignment.rms_mm,
        overlap=alignment.overlap,
        covariance=alignment.covariance,
        history=tuple(map(_record, alignment.history)),
    )


def _method(name: str) -> Method | None:
    """Return the method of the literature that is meant, None for the default one."""
    if name == "default":
        return None
    if name not in METHODS:
        close = difflib.get_close_matches(name, [*METHODS, "default"], 3)
        meant = f"did you mean {' or '.join(close)}? " if close else ""
        raise DataError(f"no registration method is called {name!r}; {meant}There are default, {', '.join(METHODS)}")
    return METHODS[name]


class Register:
    """Bring one range image to another's frame: by the default method, or by one of the literature, verified."""

    name: ClassVar[str] = "register"
    version: ClassVar[str] = "2.0.0"
    summary: ClassVar[str] = "views brought together from anywhere, foot to foot, verified; or by a named method"
    inputs: ClassVar[Mapping[str, Any]] = {"reference": RangeImage, "model": RangeImage}
    optional: ClassVar[frozenset[str]] = frozenset()
    output: ClassVar[type] = Registration

    class Params(_PairParams, frozen=True, kw_only=True):
        """Parameters of `register`."""

        method: Annotated[str, Meta(description="`default`, or a method of the literature: " + ", ".join(METHODS))] = (
            "default"
        )
        search: Annotated[
            bool, Meta(description="whether a refuted start is followed by guesses (default method only)")
        ] = True
        T_reference_model: Annotated[
            tuple[Row, Row, Row, Row] | None,
            Meta(description="start as four rows of four numbers; null: find one", extra_json_schema=_MM),
        ] = None

    def run(self, inputs: Mapping[str, Any], params: Any, context: Context) -> Registration:
        """Return the registration, `converged` or not with its reason.

        Raises
        ------
        DataError
            range images that cannot be registered, or a start that is not rigid.
        """
        reference, model = inputs["reference"], inputs["model"]
        options = replace(params.options(context.threads, params.T_reference_model), search=params.search)
        method = _method(params.method)
        try:
            context.progress(0.0, "preparing the reference")
            fixed = _surface(reference, "reference")
            context.progress(0.0, "preparing the model")
            moving = _surface(model, "model")
            if method is None:
                alignment = register(fixed, moving, options, _report(context))
            else:
                alignment = register_by(method, fixed, moving, options, params.iterations or None, _report(context))
        except DataError:
            raise
        except ValueError as error:
            raise DataError(f"cannot register: {error}") from error
        if not alignment.converged:
            context.log("warning", f"the registration did not converge: {alignment.reason}")
        return _product(alignment, reference.id, model.id)


class Merge:
    """Register views in sequence and integrate them in one model without redundancy."""

    name: ClassVar[str] = "merge"
    version: ClassVar[str] = "2.0.0"
    summary: ClassVar[str] = "views registered and chained, loops closed, overlaps fused by how well each is seen"
    inputs: ClassVar[Mapping[str, Any]] = {"views": (RangeImage,), "registrations": (Registration,)}
    optional: ClassVar[frozenset[str]] = frozenset({"registrations"})
    output: ClassVar[type] = Model

    class Params(_PairParams, frozen=True, kw_only=True):
        """Parameters of `merge`."""

        reference: Annotated[int, Meta(ge=0, le=254, description="view whose frame the model takes")] = 0
        close_loops: Annotated[
            bool, Meta(description="register every pair that overlaps, and share out what the loops do not close")
        ] = True
        require_convergence: Annotated[
            bool, Meta(description="false: a view that registers nowhere is left out and said to be")
        ] = True
        normal_window_px: Annotated[
            int, Meta(ge=3, le=31, description="side of the window for normals, odd", extra_json_schema={"units": "px"})
        ] = 7

    def run(self, inputs: Mapping[str, Any], params: Any, context: Context) -> Model:
        """Return the model.

        Raises
        ------
        DataError
            views that cannot be registered at all.
        ConvergenceError
            a pair did not converge; the message names it.
        """
        views: tuple[RangeImage, ...] = tuple(inputs["views"])
        if not views:
            raise DataError("cannot merge: there are no views; give at least one range image")
        given: tuple[Registration, ...] = tuple(inputs.get("registrations") or ())
        report = _report(context)
        try:
            surfaces = []
            for number, view in enumerate(views):
                report(0.0, f"preparing view {number}")
                surfaces.append(_surface(view, f"view {number}"))
            linked = chain(
                surfaces,
                params.options(context.threads),
                params.reference,
                _known(views, given),
                params.require_convergence,
                lambda part, text: report(0.4 * part, text),
            )
            for link in linked.links:
                if not link.alignment.converged:
                    name = f"view {link.view} ({views[link.view].id})"
                    context.log("warning", f"{name} is left out of the model: {link.alignment.reason}")
            if params.close_loops and len(linked.T_model_view) > 2:
                linked = self._closed(views, surfaces, linked, params, context)
            return _merged(views, surfaces, linked, params, lambda part, text: report(0.6 + 0.4 * part, text))
        except ChainBrokenError as error:
            pair = f"view {error.view} ({views[error.view].id}) to view {error.partner} ({views[error.partner].id})"
            raise ConvergenceError(
                f"cannot merge: {pair} does not register: {error.alignment.reason}; give views with more overlap, "
                "or set require_convergence = false to leave it out"
            ) from error
        except DataError:
            raise
        except ValueError as error:
            raise DataError(f"cannot merge: {error}") from error

    def _closed(
        self, views: Sequence[RangeImage], surfaces: Sequence[Surface], linked: Chain, params: Any, context: Context
    ) -> Chain:
        """Return the chain with poses in which all pairs that overlap have their say."""
        report = _report(context)
        links = {(link.partner, link.view): link.alignment for link in linked.links if link.alignment.converged}
        network = close_loops(
            surfaces, linked.T_model_view, links, params.options(context.threads),
            lambda part, text: report(0.4 + 0.2 * part, text),
        )  # fmt: skip
        for edge in network.refused:
            context.log(
                "warning",
                f"view {edge.j} ({views[edge.j].id}) to view {edge.i} ({views[edge.i].id}) contradicts all others and "
                "is left out of the loops",
            )
        before, after = network.before[1], network.closed[1]
        context.log("info", f"{len(network.edges)} pairs: loops off by {before:.4f} mm, {after:.4f} mm shared out")
        return replace(linked, T_model_view=network.T_model_view)


def _known(views: Sequence[RangeImage], given: Sequence[Registration]) -> dict[tuple[int, int], Alignment]:
    """Return the given registrations by (reference, model), counted as the views are."""
    number = {view.id: index for index, view in enumerate(views) if view.id}
    known: dict[tuple[int, int], Alignment] = {}
    for one in given:
        if one.reference not in number or one.model not in number:
            raise DataError(
                f"a registration joins {one.reference!r} and {one.model!r}; the views are "
                f"{', '.join(number) or 'nameless'}"
            )
        known[number[one.reference], number[one.model]] = Alignment(
            np.asarray(one.T_reference_model),
            one.converged,
            one.reason,
            one.rms_mm,
            one.overlap,
            one.covariance,
            tuple(
                Iteration(h.rms_mm, h.pairs, h.threshold_mm, h.rotation_rad, h.translation_mm, h.stage, h.alpha_mm)
                for h in one.history
            ),
        )
    return known


def _merged(
    views: Sequence[RangeImage], surfaces: Sequence[Surface], linked: Chain, params: Any, report: Report
) -> Model:
    placed = sorted(linked.T_model_view)
    poses = np.array([linked.T_model_view[i] for i in placed])
    cloud = merge(
        [surfaces[i] for i in placed], [views[i].intensity for i in placed], poses, params.normal_window_px, report
    )

    def product(link: Link) -> Registration:
        return _product(link.alignment, views[link.partner].id, views[link.view].id)

    return Model(
        points_mm=cloud.points,
        normals=cloud.normals,
        intensity=cloud.intensity,
        views=tuple(views[i].id for i in placed),
        T_model_view=poses,
        registrations=tuple(map(product, linked.links)),
        view_index=cloud.view_index,
    )


@hookimpl
def register_processors() -> Sequence[type[Any]]:
    """Return the processors of this module."""
    return [Register, Merge]
