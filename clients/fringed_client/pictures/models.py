"""A model from four sides, a shaded mesh or oriented points, coloured by view or by intensity.

Owns these colours and the points that fill triangles; `layers` draws.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex, to_rgb

from fringed.data import Array, Model
from fringed.errors import UsageError
from fringed_client.pictures.figures import APART
from fringed_client.pictures.layers import Layer, draw_layers, filled
from fringed_client.pictures.shading import CLAY, VIEWS, View, turned

By = Literal["views", "intensity", "clay"]
PALER = 0.3  # what surfaces have of white, that their shade is seen
NAMED_VIEWS = 14


def draw_model(
    path: Path, model: Model, by: By | None = None, azimuth_deg: float = 38.0, elevation_deg: float = 18.0
) -> Path:
    """Draw a model along X-Y, Y-Z, X-Z and from the side by an azimuth and from above by an elevation.

    Triangles are drawn filled where the model has them, else its oriented points. Colours are by view (the default
    where the model knows its points' views), by intensity, or those of clay.

    Raises
    ------
    UsageError
        colours by views that the model does not know, or by what there is not.
    """
    by = by or ("clay" if model.view_index is None else "views")
    colours, legend = _colours(model, by)
    layer = Layer(model.points_mm, model.normals, colours)
    layer = layer if model.faces is None or not len(model.faces) else filled(layer, model.faces)
    what = f"{len(model.points_mm):,} points"
    what += f", {len(model.faces):,} triangles" if model.faces is not None else ""
    views = f" of {len(model.views)} views" if model.views else ""
    title = f"model{views}: {what}" + (", colours are intensities" if by == "intensity" else "")
    sides = [VIEWS["x-y"], VIEWS["y-z"], VIEWS["x-z"], _direction(azimuth_deg, elevation_deg)]
    return draw_layers(path, {"": [layer]}, sides, title, legend, model.provenance.simulated)


def _direction(azimuth_deg: float, elevation_deg: float) -> View:
    return turned(f"azimuth {azimuth_deg:g}°, elevation {elevation_deg:g}°", azimuth_deg, elevation_deg)


def _colours(model: Model, by: str) -> tuple[Array, dict[str, Any]]:
    """Return a colour for each point (n, 3), and what the colours mean."""
    count = len(model.points_mm)
    if by == "clay":
        return np.broadcast_to(CLAY, (count, 3)), {}
    if by == "intensity":
        return np.repeat(0.12 + 0.88 * model.intensity[:, None] / 255.0, 3, axis=1), {}
    if by != "views":
        raise UsageError(f"a model cannot be coloured by {by!r}; by views, intensity or clay")
    if model.view_index is None:
        raise UsageError("this model does not know which view each of its points is of; colour it by intensity or clay")
    present = int(max(len(model.views), model.view_index.max(initial=0) + 1))
    palette = view_colours(present)
    share = np.bincount(model.view_index, minlength=present) / max(count, 1)
    legend = {
        f"view {i + 1}{_named(model, i)}: {share[i]:.0%} of the points": to_hex(palette[i])
        for i in range(min(present, NAMED_VIEWS))
    }
    if present > NAMED_VIEWS:
        legend[f"and {present - NAMED_VIEWS} more"] = "none"
    return palette[model.view_index], legend


def _named(model: Model, view: int) -> str:
    return f" ({model.views[view]})" if view < len(model.views) and len(model.views) <= 4 else ""


def view_colours(count: int) -> Array:
    """Return `count` colours (count, 3) that all eyes tell apart: six of their own, more along one colour map."""
    named = np.array([to_rgb(colour) for colour in APART[:-1]])
    colours = named[:count] if count <= len(named) else colormaps["viridis"](np.linspace(0, 1, count))[:, :3]
    return np.asarray(PALER + (1 - PALER) * colours, np.float64)
