"""Shaded views along X-Y, Y-Z, X-Z and oblique, and values painted on a shaded surface.

Owns their axes and scale bars; `shading` renders.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from fringed.data import Array, Model, RangeImage
from fringed_client.pictures.figures import INK, colour_bar, figure, labelled, limits, save, titled
from fringed_client.pictures.geometry import cloud_of
from fringed_client.pictures.shading import PAPER, VIEWS, Rendering, View, render_points, tinted

_NAMES = {"x-y": "X–Y, from the camera", "y-z": "Y–Z, from the side", "x-z": "X–Z, from above", "oblique": "oblique"}
NARROW_PX = 330
_STEPS_MM = tuple(digit * 10.0**power for power in range(-4, 4) for digit in (1, 2, 5))


def draw_views(
    folder: Path, surface: RangeImage | Model, width_px: int = 640, names: tuple[str, ...] = tuple(VIEWS)
) -> Mapping[str, Path]:
    """Draw the shaded views into `folder` as `shaded-<view>.png`; returns their paths by view."""
    cloud = points_of(surface)
    return {name: draw_view(folder / f"shaded-{name}.png", surface, name, width_px, cloud) for name in names}


def draw_view(
    path: Path,
    surface: RangeImage | Model,
    name: str,
    width_px: int = 640,
    cloud: tuple[Array, Array] | None = None,
) -> Path:
    """Draw one shaded view: "x-y", "y-z", "x-z" or "oblique"; `cloud` is what `points_of` gave, where it is known."""
    points, normals = cloud or points_of(surface)
    rendering = render_points(points, normals, VIEWS[name], width_px)
    return _draw_rendering(path, rendering, VIEWS[name], surface.provenance.simulated)


def points_of(surface: RangeImage | Model) -> tuple[Array, Array]:
    """Return points (n, 3) and unit normals (n, 3) of a range image or a model."""
    if isinstance(surface, Model):
        return surface.points_mm, surface.normals
    points, normals, _ = cloud_of(surface.xyz_mm)
    return points, normals


def _draw_rendering(path: Path, rendering: Rendering, view: View, simulated: bool) -> Path:
    height, width = rendering.rgb.shape[:2]
    drawn = figure(width / 110 + 1.0, height / 110 + 0.95)
    axes = drawn.add_subplot()
    show(axes, rendering, view)
    titled(axes, _NAMES.get(view.name, view.name), simulated, narrow=width < NARROW_PX)
    return save(drawn, path)


def show(axes: Any, rendering: Rendering, view: View) -> None:
    """Show a rendering with axes in mm, or with a scale bar where the view is along none."""
    left, right, bottom, top = rendering.extent_mm
    across, down = sum(view.right), sum(view.down)
    if view.right_label:
        axes.imshow(rendering.rgb, extent=(left * across, right * across, bottom * down, top * down))
        labelled(axes, view.right_label, view.down_label)
        return
    axes.imshow(rendering.rgb, extent=(left, right, bottom, top))
    axes.set_axis_off()
    _scale_bar(axes, rendering)


def _scale_bar(axes: Any, rendering: Rendering) -> None:
    left, right, bottom, top = rendering.extent_mm
    length = max([s for s in _STEPS_MM if s <= abs(right - left) / 3.5] or [_STEPS_MM[0]])
    x, y = left + 0.03 * (right - left), bottom - 0.03 * (bottom - top)
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2, solid_capstyle="butt")
    axes.text(
        x + length / 2, y - 0.012 * (bottom - top), f"{length:g} mm", ha="center", va="bottom", fontsize=8, color=INK
    )


@dataclass(frozen=True)
class Painted:
    """A surface with a value for each point: points (n, 3) in mm, unit normals (n, 3), values (n,)."""

    points_mm: Array
    normals: Array
    values: Array
    title: str


def draw_painted(
    path: Path,
    surfaces: Sequence[Painted],
    label: str,
    *,
    signed: bool = True,
    simulated: bool = False,
    view: str = "x-y",
) -> Path:
    """Paint values on shaded surfaces, side by side over one colour map (a diverging one when they are signed)."""
    together = np.concatenate([surface.values for surface in surfaces])
    top = max(abs(limit) for limit in limits(together, 1, 99)) if signed else limits(together, 1, 99)[1]
    norm = Normalize(-top if signed else 0.0, top)
    colours = colormaps["RdBu_r" if signed else "viridis"]
    shown = [
        _painted(render_points(s.points_mm, s.normals, VIEWS[view], 620, s.values), norm, colours) for s in surfaces
    ]
    height = max(picture.rgb.shape[0] for picture in shown)
    width = sum(picture.rgb.shape[1] for picture in shown)
    drawn = figure(width / 110 + 1.2 + 0.7 * len(shown), height / 110 + 0.95)
    aspects = [picture.rgb.shape[1] / picture.rgb.shape[0] for picture in shown]
    panels = drawn.subplots(1, len(shown), squeeze=False, width_ratios=aspects)[0]  # of one height
    for axes, picture, surface in zip(panels, shown, surfaces, strict=True):
        show(axes, picture, VIEWS[view])
        titled(axes, surface.title, simulated, narrow=len(shown) > 1)
    colour_bar(drawn, ScalarMappable(norm, colours), panels, label, "both" if signed else "max")
    return save(drawn, path)


def _painted(rendering: Rendering, norm: Normalize, colours: Any) -> Rendering:
    assert rendering.values is not None
    colour = colours(norm(np.nan_to_num(rendering.values)))[..., :3]
    known = rendering.covered & np.isfinite(rendering.values)
    shown = np.where(known[..., None], tinted(rendering.rgb, colour), PAPER)
    return Rendering((shown * 255).astype(np.uint8), rendering.extent_mm, rendering.covered)
