"""Several surfaces in colours of their own, seen together from several sides at one scale.

Owns how surfaces hide one another and how the views share a figure; `shading` renders each surface.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Patch
from scipy.spatial import cKDTree

from fringed.data import Array, Mesh, Model, RangeImage
from fringed_client.pictures.figures import ACCENT, DPI, FAINT, INK, figure, save, titled
from fringed_client.pictures.geometry import grid_normals
from fringed_client.pictures.shading import PAPER, Rendering, View, Window, render_points, tinted, window_of
from fringed_client.pictures.views import show

NAMES = {"x-y": "X–Y", "y-z": "Y–Z", "x-z": "X–Z", "oblique": "oblique"}
WIDE_IN, HIGH_IN = 9.4, 7.4  # of all panels together, without their labels
LEFT_IN, ABOVE_IN, BELOW_IN = 0.68, 0.24, 0.42  # what a panel's own labels need
TORN = 0.5  # of the points without a normal: the grid has no surface, its points are shown flat
MOST_GRID_POINTS = 500_000
FILLED_POINTS = 250_000  # that triangles are filled with
NEIGHBOURS = 16
Surface = RangeImage | Model | Mesh


@dataclass(frozen=True)
class Layer:
    """Points (n, 3) in mm, unit normals (n, 3), and a colour from 0 to 1: (3,) for all or (n, 3) for each."""

    points_mm: Array
    normals: Array
    colour: Array

    def moved(self, T: Array) -> Layer:
        """Return the layer in another frame; T (4, 4)."""
        return Layer(moved(self.points_mm, T), self.normals @ T[:3, :3].T, self.colour)


def moved(points_mm: Array, T: Array) -> Array:
    """Return points (n, 3) in another frame; T (4, 4)."""
    placed: Array = points_mm.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    return placed


def sided(image: Surface) -> bool:
    """Tell whether somebody knows on which side of its surface a view was seen."""
    return not isinstance(image, Model) or bool(image.normals.any())


def layer_of(image: Surface, colour: Array) -> Layer:
    """Return a view as a layer: a surface, or points that face the camera where few normals are known."""
    points, normals = grid_of(image)
    known = np.isfinite(normals[:, 2])
    if known.sum() < TORN * len(points):
        towards = -points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)
        return Layer(points, np.where(known[:, None], normals, towards), colour)
    return Layer(points[known], normals[known], colour)


def grid_of(image: Surface) -> tuple[Array, Array]:
    """Return kept points (n, 3) and their normals (n, 3), NaN where unknown; every other one of very many.

    Points without a grid whose normals nobody has said get those of their neighbours, away from the middle of all.
    """
    if isinstance(image, Mesh):
        layer = filled(Layer(image.vertices_mm, _vertex_normals(image), np.zeros(3)), image.faces)
        return layer.points_mm, layer.normals
    if isinstance(image, Model):
        some = slice(None, None, max(1, int(np.ceil(len(image.points_mm) / MOST_GRID_POINTS))))
        points, given = np.asarray(image.points_mm[some], np.float64), np.asarray(image.normals[some], np.float64)
        if not sided(image):
            given = _neighbours_normals(points)
        unknown = ~(np.linalg.norm(given, axis=1, keepdims=True) > 0)
        return points, np.where(unknown, np.nan, given)
    kept = (image.rejected == 0) & np.isfinite(image.xyz_mm).all(axis=2)
    xyz = np.where(kept[..., None], image.xyz_mm, np.nan).astype(np.float32)
    normals = grid_normals(xyz)
    step = max(1, int(np.ceil(np.sqrt(kept.sum() / MOST_GRID_POINTS))))
    chosen = np.zeros_like(kept)
    chosen[::step, ::step] = kept[::step, ::step]
    return np.asarray(xyz[chosen], np.float64), np.asarray(normals[chosen], np.float64)


def _neighbours_normals(points: Array) -> Array:
    """Return unit normals (n, 3) of the planes through each point's neighbours, away from the middle of all."""
    if len(points) <= NEIGHBOURS:
        return np.zeros_like(points)
    near = points[cKDTree(points).query(points, NEIGHBOURS, workers=1)[1]]
    off = near - near.mean(axis=1, keepdims=True)
    normals: Array = np.linalg.eigh(np.einsum("nki,nkj->nij", off, off))[1][:, :, 0]
    away = np.einsum("ni,ni->n", normals, points - points.mean(axis=0))
    return np.where(away[:, None] < 0, -normals, normals)


def _vertex_normals(mesh: Mesh) -> Array:
    """Return unit normals (n, 3) of a mesh's vertices: of their triangles, by area."""
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    total = np.stack(
        [np.bincount(mesh.faces.ravel(), np.repeat(across[:, k], 3), len(mesh.vertices_mm)) for k in range(3)], axis=1
    )
    normals: Array = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return normals


def filled(layer: Layer, faces: Array, count: int = FILLED_POINTS) -> Layer:
    """Return a layer of points on the triangles (m, 3), as dense everywhere: about `count`, at least one in each."""
    corners = layer.points_mm.astype(np.float64)[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    whole = float(area.sum())
    each = np.ceil(area * (count / whole)).astype(np.int64) if whole > 0 else np.ones(len(faces), np.int64)
    face = np.repeat(np.arange(len(faces)), np.maximum(each, 1))
    u, v = np.random.default_rng(0).random((2, len(face)))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    weights = np.stack([1 - u - v, u, v], axis=1)[..., None]
    at = faces[face]
    normals = (layer.normals[at] * weights).sum(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    colours = np.broadcast_to(layer.colour, layer.points_mm.shape)
    return Layer((corners[face] * weights).sum(axis=1), normals, (colours[at] * weights).sum(axis=1))


def composed(
    layers: Sequence[Layer], view: View, width_px: int, window: Window | None = None, flat: float = 0.0
) -> Rendering:
    """Render layers together: each pixel shows the nearest layer; `flat` 1 leaves no shade."""
    window = window or window_of([layer.points_mm for layer in layers], view, width_px)
    picture: Array | None = None
    for layer in layers:
        depth = layer.points_mm @ view.matrix[2].astype(np.float64)
        colours = np.broadcast_to(np.asarray(layer.colour, np.float64), (len(depth), 3))
        one = render_points(
            layer.points_mm, layer.normals, view, width_px, np.column_stack([colours, depth - window.low[2]]), window
        )
        if one.values is None:  # too few points that face this way
            continue
        if picture is None:
            picture, nearest = np.broadcast_to(PAPER, one.rgb.shape).copy(), np.full(one.covered.shape, np.inf)
            extent = one.extent_mm
        ahead = one.covered & (one.values[..., 3] < nearest)  # false where NaN
        nearest[ahead] = one.values[..., 3][ahead]
        picture[ahead] = tinted(one.rgb, np.nan_to_num(one.values[..., :3]), flat)[ahead]
    if picture is None:
        return render_points(np.zeros((0, 3)), np.zeros((0, 3)), view, width_px)
    return Rendering((picture * 255 + 0.5).astype(np.uint8), extent, np.isfinite(nearest))


def draw_layers(
    path: Path,
    rows: Mapping[str, Sequence[Layer]],
    views: Sequence[View],
    title: str,
    legend: Mapping[str, Any],
    simulated: bool,
) -> Path:
    """Draw rows of layers, by name, along several directions: one figure, one scale, axes in mm.

    `legend` gives names to colours.
    """
    together = [layer.points_mm for layers in rows.values() for layer in layers]
    sheet = _Sheet.of([window_of(together, view, 1000) for view in views], len(rows), title, legend)
    drawn = figure(*sheet.size_in)
    drawn.set_layout_engine("none")  # places are exact, so that all panels have one scale
    for row, (name, layers) in enumerate(rows.items()):
        for column, view in enumerate(views):
            axes = drawn.add_axes(sheet.place(row, column))
            width_px = max(60, round(float(max(sheet.sizes_mm[column])) * sheet.inch_mm * DPI))
            show(axes, composed(layers, view, width_px, window_of(together, view, width_px)), view)
            axes.set_anchor("NW")
            heading = ", ".join(part for part in (name, NAMES.get(view.name, view.name)) if part)
            titled(axes, heading, False)
            axes.set_title(heading, loc="left", fontsize=9.5, color=INK, pad=4)
    width, height = sheet.size_in
    drawn.text(0.12 / width, 1 - 0.1 / height, sheet.title, ha="left", va="top", fontsize=10.5, color=INK)
    if simulated:
        drawn.text(1 - 0.12 / width, 1 - 0.1 / height, "SIMULATED", ha="right", va="top", fontsize=8, color=ACCENT,
                   fontweight="bold")  # fmt: skip
    patches = [Patch(facecolor=colour, edgecolor=FAINT, linewidth=0.4, label=name) for name, colour in legend.items()]
    if patches:
        drawn.legend(handles=patches, loc="lower left", bbox_to_anchor=(0.05 / width, 0.0), fontsize=8.5,
                     frameon=False, labelcolor=INK, ncols=sheet.legend_columns)  # fmt: skip
    return save(drawn, path, 224)


@dataclass(frozen=True)
class _Sheet:
    """Where panels of one scale stand: `sizes_mm` (n, 2) of the columns' views, `inch_mm` inches for each mm."""

    sizes_mm: Array
    rows: int
    inch_mm: float
    title: str
    legend_columns: int
    legend_in: float

    @classmethod
    def of(cls, windows: Sequence[Window], rows: int, title: str, legend: Mapping[str, Any]) -> _Sheet:
        sizes = np.array([(window.high - window.low)[:2] for window in windows], np.float64)
        inch = min(WIDE_IN / float(sizes[:, 0].sum()), HIGH_IN / (rows * float(sizes[:, 1].max())))
        width = float(sizes[:, 0].sum()) * inch + LEFT_IN * len(sizes)
        columns = max(1, min(len(legend) or 1, int(11 * width) // (max([len(name) for name in legend] or [1]) + 7)))
        told = "\n".join(textwrap.wrap(title, max(30, int(11.5 * width) - 12)))
        return cls(sizes, rows, inch, told, columns, 0.1 + 0.2 * -(-len(legend) // columns))

    @property
    def _head_in(self) -> float:
        return 0.17 + 0.17 * len(self.title.splitlines())

    @property
    def _row_in(self) -> float:
        return float(self.sizes_mm[:, 1].max()) * self.inch_mm + ABOVE_IN + BELOW_IN

    @property
    def size_in(self) -> tuple[float, float]:
        width = float(self.sizes_mm[:, 0].sum()) * self.inch_mm + LEFT_IN * len(self.sizes_mm) + 0.12
        return max(width, 4.0), self._head_in + self._row_in * self.rows + self.legend_in

    def place(self, row: int, column: int) -> tuple[float, float, float, float]:
        """Return a panel's left, bottom, width and height in the figure, which is 1 x 1."""
        width, height = self.size_in
        left = LEFT_IN * (column + 1) + float(self.sizes_mm[:column, 0].sum()) * self.inch_mm
        own = self.sizes_mm[column] * self.inch_mm
        top = self._head_in + self._row_in * row + ABOVE_IN
        return left / width, 1 - (top + own[1]) / height, own[0] / width, own[1] / height
