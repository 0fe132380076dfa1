"""A freeform surface z(x, y) as a fine mesh."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from fringed.simulation.shapes.basic import Size
from fringed.simulation.shapes.formula import evaluate
from fringed.simulation.shapes.shape import Shape, ShapeOptions, grid_faces, mesh_shape

BUMPS = (
    "28*exp(-((x-35)**2+(y-25)**2)/1800) - 22*exp(-((x+45)**2+(y+30)**2)/1500) "
    "+ 18*exp(-((x+40)**2+(y-50)**2)/1100) + 5*sin(x/23)*cos(y/19)"
)


class FreeformOptions(ShapeOptions, frozen=True, kw_only=True):
    """A surface over the x-y plane, z towards the camera."""

    formula: Annotated[str, Meta(min_length=1, description="z in mm, of x and y in mm")] = BUMPS
    width_mm: Size = 260.0
    height_mm: Size = 220.0
    pitch_mm: Annotated[Size, Meta(description="distance of the mesh's vertices")] = 0.6


def freeform(options: FreeformOptions) -> Shape:
    """Return the surface, sampled at `pitch_mm`.

    Raises
    ------
    ValueError
        the formula is none, or the mesh would have more than 4 million vertices.
    """
    columns = int(np.ceil(options.width_mm / options.pitch_mm)) + 1
    rows = int(np.ceil(options.height_mm / options.pitch_mm)) + 1
    if rows * columns > 4_000_000 or min(rows, columns) < 2:
        raise ValueError(f"pitch_mm {options.pitch_mm:g} gives {columns} x {rows} vertices; choose 2 to 4 million")
    x, y = np.meshgrid(
        np.linspace(-options.width_mm / 2, options.width_mm / 2, columns),
        np.linspace(options.height_mm / 2, -options.height_mm / 2, rows),
    )
    z = evaluate(options.formula, x, y)
    return mesh_shape(np.stack([x, y, z], axis=-1).reshape(-1, 3), grid_faces(rows, columns))
