"""A triangle mesh from a file as a shape to be measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta

from fringed.errors import DataError
from fringed.simulation.shapes.shape import Shape, ShapeOptions, mesh_shape
from fringed.surface_files.reading import read_surface


class MeshOptions(ShapeOptions, frozen=True, kw_only=True):
    """A triangle mesh from a file."""

    path: Annotated[str, Meta(min_length=1, description="a .ply, .stl or .obj file")]
    scale: Annotated[float, Meta(gt=0, description="millimetres per unit of the file")] = 1.0
    centre: Annotated[bool, Meta(description="put the middle of its bounding box on the origin")] = True


def mesh_file(options: MeshOptions) -> Shape:
    """Load the mesh.

    Raises
    ------
    DataError
        the file is missing, of another format, truncated, contradicts itself or has no triangles.
    """
    read = read_surface(Path(options.path).expanduser())
    if read.faces is None:
        raise DataError(f"{options.path} holds points without faces; a scene needs triangles")
    vertices = read.vertices * options.scale
    if options.centre and len(vertices):
        vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    try:
        return mesh_shape(vertices, read.faces, read.albedo)
    except DataError as error:
        raise DataError(f"{options.path}: {error}") from error
