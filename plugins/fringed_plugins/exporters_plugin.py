"""Registers the exporters: PLY, PCD, XYZ, STL, OBJ, organised TIFF and NPZ.

Owns which product becomes which geometry; the bytes are written by `mesh`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from fringed import __version__, hookspecs
from fringed.data import Mesh, Model, PhaseMap, RangeImage
from fringed.errors import DataError
from fringed.hookspecs import hookimpl
from fringed_plugins.mesh import binary, images, text
from fringed_plugins.mesh.geometry import Geometry, from_grid


class PlainParams(hookspecs.Params, frozen=True, kw_only=True):
    """No parameters."""


class MeshedParams(hookspecs.Params, frozen=True, kw_only=True):
    """How a range image becomes triangles."""

    max_edge_mm: Annotated[
        float,
        Meta(
            ge=0,
            le=1e6,
            description="longest edge of a triangle; 0: six times the points' distance",
            extra_json_schema={"units": "mm"},
        ),
    ] = 0.0


class PlyParams(MeshedParams, frozen=True, kw_only=True):
    """Points, or triangles too."""

    mesh: Annotated[bool, Meta(description="join a range image's points by triangles")] = False


class PcdParams(hookspecs.Params, frozen=True, kw_only=True):
    """Grid or list."""

    organised: Annotated[bool, Meta(description="keep a range image's grid, with NaN where nothing is")] = True


class PlyExporter:
    """Binary little-endian PLY: points with normals and intensity where known, and triangles."""

    name: ClassVar[str] = "ply"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "PLY, binary: points, normals, intensity, triangles"
    suffix: ClassVar[str] = ".ply"
    media_type: ClassVar[str] = "model/ply"
    accepts: ClassVar[tuple[type, ...]] = (RangeImage, Model, Mesh)
    Params: ClassVar[type[hookspecs.Params]] = PlyParams

    def export(self, product: Any, params: PlyParams) -> bytes:
        """Return the file; raise DataError when no point is left."""
        return _written(self, product, lambda: binary.ply(geometry(product, params.mesh, params.max_edge_mm)))


class PcdExporter:
    """Binary PCD 0.7 of the Point Cloud Library."""

    name: ClassVar[str] = "pcd"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "PCD 0.7, binary: points, normals, intensity"
    suffix: ClassVar[str] = ".pcd"
    media_type: ClassVar[str] = "application/x-pcd"
    accepts: ClassVar[tuple[type, ...]] = (RangeImage, Model, Mesh)
    Params: ClassVar[type[hookspecs.Params]] = PcdParams

    def export(self, product: Any, params: PcdParams) -> bytes:
        """Return the file; raise DataError when no point is left."""
        return _written(self, product, lambda: self._content(product, params.organised))

    @staticmethod
    def _content(product: Any, organised: bool) -> bytes:
        points = geometry(product)
        if not (organised and isinstance(product, RangeImage)):
            return binary.pcd(points)
        height, width = product.rejected.shape
        grid = replace(points, vertices=product.xyz_mm.reshape(-1, 3), intensity=product.intensity.ravel())
        return binary.pcd(grid, (width, height))


class XyzExporter:
    """Plain text, a point a line."""

    name: ClassVar[str] = "xyz"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "XYZ, text: a point a line, with normal and intensity"
    suffix: ClassVar[str] = ".xyz"
    media_type: ClassVar[str] = "text/plain"
    accepts: ClassVar[tuple[type, ...]] = (RangeImage, Model, Mesh)
    Params: ClassVar[type[hookspecs.Params]] = PlainParams

    def export(self, product: Any, params: PlainParams) -> bytes:
        """Return the file; raise DataError when no point is left."""
        return _written(self, product, lambda: text.xyz(geometry(product)))


class StlExporter:
    """Binary STL of a mesh, or of a range image joined along its grid."""

    name: ClassVar[str] = "stl"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "STL, binary: triangles"
    suffix: ClassVar[str] = ".stl"
    media_type: ClassVar[str] = "model/stl"
    accepts: ClassVar[tuple[type, ...]] = (RangeImage, Model, Mesh)
    Params: ClassVar[type[hookspecs.Params]] = MeshedParams

    def export(self, product: Any, params: MeshedParams) -> bytes:
        """Return the file; raise DataError when there are no triangles."""
        if isinstance(product, Model) and (product.faces is None or len(product.faces) == 0):
            raise DataError(
                "stl: a Model without faces has no triangles, and STL holds nothing else; merge with surface=open or "
                "surface=watertight, export the model as ply, pcd or xyz, or give one of its views, a RangeImage, "
                "which is joined along its grid"
            )
        return _written(self, product, lambda: binary.stl(geometry(product, True, params.max_edge_mm)))


class ObjExporter:
    """Wavefront OBJ of a mesh or points, or of a range image joined along its grid."""

    name: ClassVar[str] = "obj"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "OBJ, text: vertices, normals, triangles"
    suffix: ClassVar[str] = ".obj"
    media_type: ClassVar[str] = "model/obj"
    accepts: ClassVar[tuple[type, ...]] = (RangeImage, Model, Mesh)
    Params: ClassVar[type[hookspecs.Params]] = MeshedParams

    def export(self, product: Any, params: MeshedParams) -> bytes:
        """Return the file; raise DataError when no point is left."""
        return _written(self, product, lambda: text.obj(geometry(product, True, params.max_edge_mm)))


class TiffExporter:
    """Organised range image: three float32 samples X, Y, Z (mm) for each pixel, NaN where nothing is."""

    name: ClassVar[str] = "tiff"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "TIFF, organised: float32 X, Y, Z of every pixel"
    suffix: ClassVar[str] = ".tiff"
    media_type: ClassVar[str] = "image/tiff"
    accepts: ClassVar[tuple[type, ...]] = (RangeImage,)
    Params: ClassVar[type[hookspecs.Params]] = PlainParams

    def export(self, product: Any, params: PlainParams) -> bytes:
        """Return the file; raise DataError when no point is left."""
        return _written(self, product, lambda: images.tiff(product.xyz_mm, "; ".join(notes(product))))


class NpzExporter:
    """NumPy archive of every array of the product, under its own name; nothing is pickled.

    Beside them `id`, `simulated`, and what else there is of `calibration`, `kind`, `period_px`, `orientation`.
    """

    name: ClassVar[str] = "npz"
    version: ClassVar[str] = __version__
    summary: ClassVar[str] = "NPZ: every array of the product by name"
    suffix: ClassVar[str] = ".npz"
    media_type: ClassVar[str] = "application/x-npz"
    accepts: ClassVar[tuple[type, ...]] = (RangeImage, Model, Mesh, PhaseMap)
    Params: ClassVar[type[hookspecs.Params]] = PlainParams

    def export(self, product: Any, params: PlainParams) -> bytes:
        """Return the file."""
        return _written(self, product, lambda: images.npz(_arrays(product)))


def geometry(product: Any, meshed: bool = False, max_edge_mm: float = 0.0) -> Geometry:
    """Return what of a product can be drawn.

    Raises
    ------
    ValueError
        nothing is left of it.
    """
    return replace(_bare(product, meshed, max_edge_mm), notes=notes(product))


def notes(product: Any) -> tuple[str, ...]:
    """Return what a file should say of a product: that it is simulated, its identity, its calibration."""
    origin = product.provenance
    calibration = getattr(product, "calibration", "") or origin.calibration
    lines = ["SIMULATED: not measured"] if origin.simulated else []
    lines += [f"id {product.id}"] if product.id else []
    return (*lines, f"calibration {calibration}") if calibration else tuple(lines)


def _bare(product: Any, meshed: bool, max_edge_mm: float) -> Geometry:
    if isinstance(product, RangeImage):
        return from_grid(product.xyz_mm, product.intensity, meshed, max_edge_mm)
    if isinstance(product, Model):
        return Geometry(product.points_mm, product.normals, product.intensity, product.faces)
    grey = None if product.albedo is None else np.rint(255 * np.clip(product.albedo, 0, 1)).astype(np.uint8)
    return Geometry(product.vertices_mm, None, grey, product.faces)


def _arrays(product: Any) -> dict[str, Any]:
    values = {item.name: getattr(product, item.name) for item in fields(product)}
    found = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    names = ("id", "calibration", "kind", "period_px", "orientation")
    found.update({name: np.array(values[name]) for name in names if isinstance(values.get(name), (str, float))})
    found["simulated"] = np.array(product.provenance.simulated)
    return found


def _written(exporter: Any, product: Any, write: Callable[[], bytes]) -> bytes:
    if not isinstance(product, exporter.accepts):
        allowed = ", ".join(accepted.__name__ for accepted in exporter.accepts)
        raise DataError(f"{exporter.name} writes {allowed}; it was given {type(product).__name__}")
    try:
        return write()
    except ValueError as error:
        raise DataError(f"{exporter.name}: {error}") from error


@hookimpl
def register_exporters() -> Sequence[type[Any]]:
    """Return the exporters."""
    return (PlyExporter, PcdExporter, XyzExporter, StlExporter, ObjExporter, TiffExporter, NpzExporter)
