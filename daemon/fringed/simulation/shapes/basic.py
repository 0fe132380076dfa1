"""Objects of known geometry: plane, sphere, ball bar, steps. Exact: their planes are planes, their spheres spheres."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from fringed.simulation.shapes.shape import Shape, ShapeOptions, mesh_shape, sphere_shape

_MM: dict[str, Any] = {"units": "mm"}
Size = Annotated[float, Meta(gt=0, le=1e5, extra_json_schema=_MM)]


class PlaneOptions(ShapeOptions, frozen=True, kw_only=True):
    """A plane through the object's origin, facing z."""

    width_mm: Size = 700.0
    height_mm: Size = 600.0


class SphereOptions(ShapeOptions, frozen=True, kw_only=True):
    """A sphere around the object's origin."""

    radius_mm: Size = 60.0


class BallBarOptions(ShapeOptions, frozen=True, kw_only=True):
    """Two equal spheres on the object's x axis, the origin in the middle."""

    radius_mm: Size = 25.0
    spacing_mm: Annotated[Size, Meta(description="between the centres")] = 150.0


class StepsOptions(ShapeOptions, frozen=True, kw_only=True):
    """A block whose top is a flight of stairs from left to right, its base at z = 0."""

    heights_mm: Annotated[tuple[Size, ...], Meta(min_length=1, max_length=200)] = (10.0, 20.0, 30.0, 40.0, 50.0)
    tread_mm: Annotated[Size, Meta(description="width of one step")] = 40.0
    depth_mm: Annotated[Size, Meta(description="extent along y")] = 200.0


def plane(options: PlaneOptions) -> Shape:
    """Return a rectangle of two triangles."""
    x, y = options.width_mm / 2, options.height_mm / 2
    return mesh_shape([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], [[0, 1, 2], [0, 2, 3]])


def sphere(options: SphereOptions) -> Shape:
    """Return an exact sphere."""
    return sphere_shape([[0.0, 0.0, 0.0, options.radius_mm]])


def ball_bar(options: BallBarOptions) -> Shape:
    """Return two exact spheres; the bar between them is left out.

    Raises
    ------
    ValueError
        spheres that overlap.
    """
    if options.spacing_mm < 2 * options.radius_mm:
        raise ValueError(
            f"two spheres of radius {options.radius_mm:g} mm do not fit at a distance of {options.spacing_mm:g} mm; "
            f"spacing_mm has to be at least {2 * options.radius_mm:g}"
        )
    x = options.spacing_mm / 2
    return sphere_shape([[-x, 0.0, 0.0, options.radius_mm], [x, 0.0, 0.0, options.radius_mm]])


def steps(options: StepsOptions) -> Shape:
    """Return one box for each step; corners are not shared, so every face is flat."""
    left = -options.tread_mm * len(options.heights_mm) / 2
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for index, height in enumerate(options.heights_mm):
        low = np.array([left + index * options.tread_mm, -options.depth_mm / 2, 0.0])
        high = np.array([left + (index + 1) * options.tread_mm, options.depth_mm / 2, height])
        for corners in _box_sides(low, high):
            faces += [[len(vertices) + i for i in triangle] for triangle in ((0, 1, 2), (0, 2, 3))]
            vertices += corners
    return mesh_shape(np.array(vertices), np.array(faces))


def _box_sides(low: np.ndarray[Any, Any], high: np.ndarray[Any, Any]) -> list[list[list[float]]]:
    sides = []
    for axis in range(3):
        a, b = [other for other in range(3) if other != axis]
        for end in (low, high):
            corners = []
            for at_a, at_b in ((low, low), (high, low), (high, high), (low, high)):
                corner = [0.0, 0.0, 0.0]
                corner[axis], corner[a], corner[b] = float(end[axis]), float(at_a[a]), float(at_b[b])
                corners.append(corner)
            sides.append(corners)
    return sides
