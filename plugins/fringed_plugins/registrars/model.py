"""The processor `merge`: many views to one model, of points or of triangles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from fringed.data import Model, RangeImage, Registration
from fringed.errors import ConvergenceError, DataError
from fringed.hookspecs import Context
from fringed_plugins.registrars.common import (
    MM,
    PairParams,
    alignment_of,
    product_of,
    report_to,
    surface_of,
)
from fringed_plugins.registration.chaining import Chain, ChainBrokenError, chain
from fringed_plugins.registration.merging import merge
from fringed_plugins.registration.meshing.integrate import integrate
from fringed_plugins.registration.result import Alignment, Report, between
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.views.closing import Closed, close_loops


class Merge:
    """Register views in sequence, close their loops, and integrate them in one model without redundancy."""

    name: ClassVar[str] = "merge"
    version: ClassVar[str] = "3.0.0"
    summary: ClassVar[str] = (
        "views registered, loops closed, overlaps fused by how well each is seen: one cloud or mesh"
    )
    inputs: ClassVar[Mapping[str, Any]] = {"views": (RangeImage,), "registrations": (Registration,)}
    optional: ClassVar[frozenset[str]] = frozenset({"registrations"})
    output: ClassVar[type] = Model

    class Params(PairParams, frozen=True, kw_only=True):
        """Parameters of `merge`."""

        reference: Annotated[
            int, Meta(ge=0, le=254, description="view whose frame the model takes, counted from 0")
        ] = 0
        close_loops: Annotated[
            bool, Meta(description="register every pair that overlaps, and share out what the loops do not close")
        ] = True
        refine: Annotated[
            bool, Meta(description="with three views and more: bring all surfaces together at once, at last")
        ] = False
        require_convergence: Annotated[
            bool, Meta(description="false: a view that registers nowhere is left out and said to be")
        ] = True
        surface: Annotated[
            Literal["points", "open", "watertight"],
            Meta(description="merged points; triangles where views have looked; or closed, with what is guessed"),
        ] = "points"
        voxel_mm: Annotated[
            float,
            Meta(ge=0, description="side of the mesh's voxels; 0: the views' resolution", extra_json_schema=MM),
        ] = 0.0
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
        try:
            return _Merging(views, params, context).run(_known(views, given))
        except ChainBrokenError as error:
            pair = " to ".join(f"view {k + 1} ({views[k].id})" for k in (error.view, error.partner))
            raise ConvergenceError(
                f"cannot merge: {pair} does not register: {error.alignment.reason}; give views with more overlap, "
                "or set require_convergence = false to leave it out"
            ) from error
        except DataError:
            raise
        except ValueError as error:
            raise DataError(f"cannot merge: {error}") from error


@dataclass(frozen=True)
class _Merging:
    """One run: the views, what is wanted, and who hears of it."""

    views: Sequence[RangeImage]
    params: Merge.Params
    context: Context

    def run(self, known: Mapping[tuple[int, int], Alignment]) -> Model:
        report, wish = report_to(self.context), self.params
        surfaces = []
        for number, view in enumerate(self.views, 1):
            report(0.0, f"preparing view {number}")
            surfaces.append(surface_of(view, f"view {number}"))
        options = wish.options(self.context.threads)
        linked = chain(
            surfaces, options, wish.reference, known, wish.require_convergence, between(report, 0.0, 0.4)
        )  # fmt: skip
        for link in linked.links:
            if not link.alignment.converged:
                self._warn(f"{self._name(link.view)} is left out of the model: {link.alignment.reason}")
        if wish.close_loops and len(linked.T_model_view) > 2:
            made = {(link.partner, link.view): link.alignment for link in linked.links if link.alignment.converged}
            closed = close_loops(
                surfaces, linked.T_model_view, made, options, between(report, 0.4, 0.6), refine=wish.refine
            )
            self._tell(closed)
            linked = replace(linked, T_model_view=closed.T_model_view)
        return self._integrated(surfaces, linked, between(report, 0.6, 1.0))

    def _name(self, view: int) -> str:
        return f"view {view + 1} ({self.views[view].id})"

    def _warn(self, text: str) -> None:
        self.context.log("warning", text)

    def _tell(self, closed: Closed) -> None:
        """Log what the pairs say of each other, and which are left out."""
        for out in closed.graph.dropped:
            edge = closed.edges[out.edge]
            if edge.converged:  # pairs that merely overlap too little are nobody's worry
                self._warn(f"{self._name(edge.j)} to {self._name(edge.i)} is left out of the loops: {out.reason}")
        if closed.joint is not None and not closed.joint.converged:
            self._warn(f"the surfaces were not brought together at once: {closed.joint.reason}")
        before, after = closed.before[1], closed.after[1]
        self.context.log("info", f"{len(closed.edges)} pairs: off by {before:.4f} mm, {after:.4f} mm shared out")

    def _integrated(self, surfaces: Sequence[Surface], linked: Chain, report: Report) -> Model:
        """Return the model of the placed views: merged points, or triangles."""
        wish = self.params
        placed = sorted(linked.T_model_view)
        poses = np.array([linked.T_model_view[i] for i in placed])
        seen, images = [surfaces[i] for i in placed], [self.views[i].intensity for i in placed]
        names = tuple(self.views[i].id for i in placed)
        made = tuple(
            product_of(link.alignment, self.views[link.partner].id, self.views[link.view].id) for link in linked.links
        )
        if wish.surface == "points":
            cloud = merge(seen, images, poses, wish.normal_window_px, report)
            return Model(
                cloud.points, cloud.normals, cloud.intensity, names, poses, made, view_index=cloud.view_index,
                confidence=cloud.confidence,
            )  # fmt: skip
        mesh = integrate(
            seen, images, poses, wish.voxel_mm or None, watertight=wish.surface == "watertight", report=report,
            threads=self.context.threads,
        )  # fmt: skip
        return Model(
            mesh.vertices, mesh.normals, mesh.intensity, names, poses, made, mesh.faces, confidence=mesh.confidence
        )


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
        known[number[one.reference], number[one.model]] = alignment_of(one)
    return known
