"""What the processors of registration share: parameters, surfaces of products, products of results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from msgspec import Meta

from fringed.data import IterationRecord, Mesh, Model, RangeImage, Registration
from fringed.hookspecs import Context, Params
from fringed_plugins.registration.clouds import prepare_cloud
from fringed_plugins.registration.meshing.sampling import sampled
from fringed_plugins.registration.register import Options
from fringed_plugins.registration.result import Alignment, Iteration, Report
from fringed_plugins.registration.scan import Scan
from fringed_plugins.registration.surface import Surface, prepare
from fringed_plugins.registration.verify import Limits

Row = tuple[float, float, float, float]
MM = {"units": "mm"}
MESH_POINTS = 200_000


class PairParams(Params, frozen=True, kw_only=True):
    """What all of them take."""

    points: Annotated[
        int, Meta(ge=500, le=2_000_000, description="most points of the last stage until it is near; it ends with all")
    ] = 40_000
    iterations: Annotated[
        int, Meta(ge=0, le=1000, description="most iterations of each stage; 0: the method's own, 20 to 100")
    ] = 0
    min_overlap: Annotated[float, Meta(ge=0.0, le=1.0, description="least part of the model on the reference")] = 0.2
    max_rms_mm: Annotated[
        float,
        Meta(ge=0.0, description="greatest residual; 0: 5 x noise or 0.1 % of the extent", extra_json_schema=MM),
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


def surface_of(view: RangeImage, name: str) -> Surface:
    """Return a prepared range image; raise ValueError where it has no surface."""
    return prepare(view.xyz_mm, view.rejected, view.sigma_mm, f"{name} {view.id}".strip())


def scan_of(view: RangeImage | Model | Mesh, name: str, threads: int, report: Report) -> Scan:
    """Return a prepared view, with a grid or without; raise ValueError where it has no surface.

    A model's points have its normals where it knows any; a mesh's triangles are sampled evenly.
    """
    if isinstance(view, RangeImage):
        return surface_of(view, name)
    called = f"{name} {view.id}".strip()

    def tell() -> None:
        report(0.0, f"preparing the {name}")

    if isinstance(view, Model):
        return prepare_cloud(view.points_mm, view.normals, name=called, threads=threads, tell=tell)
    points, normals = sampled(view.vertices_mm, view.faces, MESH_POINTS)
    return prepare_cloud(points, normals, name=called, threads=threads, tell=tell)


def report_to(context: Context) -> Report:
    """Return what passes progress on, and cancels."""
    return lambda fraction, text: context.progress(min(max(fraction, 0.0), 1.0), text)


def product_of(alignment: Alignment, reference: str, model: str) -> Registration:
    """Return a result as a product; `reference` and `model` are ids."""
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


def alignment_of(product: Registration) -> Alignment:
    """Return a product as a result: the other way round."""
    history = tuple(
        Iteration(h.rms_mm, h.pairs, h.threshold_mm, h.rotation_rad, h.translation_mm, h.stage, h.alpha_mm)
        for h in product.history
    )
    return Alignment(
        np.asarray(product.T_reference_model), product.converged, product.reason, product.rms_mm, product.overlap,
        product.covariance, history,
    )  # fmt: skip


def _record(made: Iteration) -> IterationRecord:
    return IterationRecord(
        made.rms_mm, made.pairs, made.threshold_mm, made.rotation_rad, made.translation_mm, made.stage, made.alpha_mm
    )
