"""What each camera pixel sees: where, lit by which projector pixel, and how brightly.

Owns the tracing of one pose of one scene, and the truth that follows from it; knows nothing of patterns and time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from fringed.config.simulated import SimulationConfig
from fringed.data import Float32Array, Float64Array, Truth, UInt8Array
from fringed.simulation import optics
from fringed.simulation.rows import for_rows

BLUR_LEVELS = 8
BLUR_REACH = 0.3  # of the working distance: beyond it from the focus the blur grows no more
_CELLS_PER_TRIANGLE = 0.5
_MAX_ENTRIES = 40_000_000


@dataclass(frozen=True)
class Geometry:
    """Everything that frames need to know of one scene at one pose; all (height, width).

    `column`, `row`: the projector's pixel. `level`: of blur, 0 to BLUR_LEVELS - 1. `depth`: z in mm. `gain`: the
    projector's light that comes back, 1 for a white plane at the working distance. `base`: the ambient light's.
    """

    column: Float32Array
    row: Float32Array
    level: Float32Array
    depth: Float32Array
    gain: Float32Array
    base: Float32Array
    flags: UInt8Array
    T_camera_object: Float64Array


def blur_sigmas_px(config: SimulationConfig) -> Float64Array:
    """Return the projector's blur (BLUR_LEVELS,) at each level: Gaussian sigma in projector pixels."""
    reach_mm = BLUR_REACH * config.geometry.working_distance_mm
    worst = config.projector.blur_px + max(config.projector.blur_px_per_mm, 1e-6) * reach_mm
    return np.linspace(config.projector.blur_px, worst, BLUR_LEVELS)


def trace(
    config: SimulationConfig, solid: Any, light: tuple[float, float], sensitivity: Float32Array, pose: Float64Array
) -> Geometry:
    """Trace every pixel. `light` is (specular, ambient), `sensitivity` (height, width) the sensor's own gain."""
    from fringed.simulation.trace_kernels import Buffers, trace_rows

    height, width = sensitivity.shape
    column, row, level, depth, gain, base = (np.empty((height, width), np.float32) for _ in range(6))
    out = Buffers(column, row, level, depth, gain, base, np.empty((height, width), np.uint8))
    view = _view(config, light)
    grids = (
        _grid(solid.triangles, np.eye(4), optics.camera_lens(config)),
        _grid(solid.triangles, view.T_projector_camera, optics.projector_lens(config)),
    )
    for_rows(height, lambda first, end: trace_rows((first, end), solid, grids, view, out))
    np.multiply(out.gain, sensitivity, out=out.gain)
    np.multiply(out.base, sensitivity, out=out.base)
    return Geometry(*out, T_camera_object=pose)


def _view(config: SimulationConfig, light: tuple[float, float]) -> Any:
    from fringed.simulation.trace_kernels import View

    throw = optics.throw_mm(config)
    reach = BLUR_REACH * config.geometry.working_distance_mm
    facing = config.geometry.working_distance_mm / throw  # cosine on a plane that faces the camera
    T = optics.T_projector_camera(config)
    numbers = [
        light[0],
        light[1],
        config.sensor.vignetting,
        config.projector.vignetting,
        throw,
        (BLUR_LEVELS - 1) / reach if config.projector.blur_px_per_mm > 0 else 0.0,
        BLUR_LEVELS - 1.0,
        throw**2 / facing,
    ]
    return View(
        optics.packed(optics.camera_lens(config)),
        optics.packed(optics.projector_lens(config)),
        T,
        -T[:3, :3].T @ T[:3, 3],
        np.array(numbers),
    )


def _grid(triangles: Float64Array, T_lens_camera: Float64Array, lens: Any) -> Any:
    """Sort triangles into the cells of a lens's perspective view that each may cover."""
    from fringed.simulation.grid_kernels import Grid, bin_triangles, box_triangles

    low, high = _extent(lens)
    spans = np.empty((len(triangles), 4))
    box_triangles(triangles, np.ascontiguousarray(T_lens_camera), low, high, spans)
    seen = spans[:, 2] >= spans[:, 0]
    if seen.any():
        low = np.maximum(low, spans[seen, :2].min(axis=0))
        high = np.minimum(high, spans[seen, 2:].max(axis=0))
    else:
        high = low
    if not (low < high).all():
        return Grid(np.array([0.0, 0.0, 1.0, 1.0]), 1, 1, np.zeros(2, np.int64), np.zeros(0, np.int32))
    size = int(np.clip(np.sqrt(_CELLS_PER_TRIANGLE * len(triangles)), 16, 1400))
    boxes, scale = _boxes(spans, low, high, size)
    while int(_entries(boxes).sum()) > _MAX_ENTRIES and size > 16:
        size //= 2
        boxes, scale = _boxes(spans, low, high, size)
    start = np.zeros(size * size + 1, np.int64)
    none = np.zeros(0, np.int32)
    bin_triangles(boxes, size, start, none, False)
    start = np.cumsum(start)
    items = np.zeros(int(start[-1]), np.int32)
    bin_triangles(boxes, size, start[:-1].copy(), items, True)
    return Grid(np.array([*low, *scale]), size, size, start, items)


def _boxes(spans: Any, low: Any, high: Any, size: int) -> tuple[Any, Any]:
    """Return the cells (n, 4) int32 of each triangle, widened by a rounding error, and cells per unit."""
    scale = size / ((high - low) * (1 + 1e-9))
    boxes = np.empty(spans.shape, np.int32)
    for axis in range(2):
        boxes[:, axis] = np.clip((spans[:, axis] - low[axis]) * scale[axis] - 1e-6, 0, size - 1)
        boxes[:, 2 + axis] = np.clip((spans[:, 2 + axis] - low[axis]) * scale[axis] + 1e-6, 0, size - 1)
    boxes[spans[:, 2] < spans[:, 0]] = (0, 0, -1, -1)
    return boxes, scale


def _entries(boxes: Any) -> Any:
    spans = boxes[:, 2:].astype(np.int64) - boxes[:, :2] + 1
    return spans[:, 0] * spans[:, 1]


def _extent(lens: Any) -> tuple[Float64Array, Float64Array]:
    """Return the normalised coordinates that the lens can see, with a margin for its distortion."""
    half = np.array([lens.width_px / lens.matrix[0, 0], lens.height_px / lens.matrix[1, 1]]) / 2
    margin = 1.15 + 2 * np.abs(lens.distortion).sum() * float((half**2).sum())
    return -half * margin, half * margin


def truth_of(config: SimulationConfig, geometry: Geometry, scene: Mapping[str, Any]) -> Truth:
    """Return what the traced geometry says of every pixel."""
    from fringed.simulation.lens_kernels import points_rows
    from fringed.simulation.trace_kernels import LIT, OBJECT, VISIBLE

    flags, depth = geometry.flags, geometry.depth
    points = np.empty((*depth.shape, 3), np.float32)
    lens = optics.packed(optics.camera_lens(config))
    for_rows(len(depth), partial(_points, points_rows, lens, depth, points))
    return Truth(
        xyz_mm=points,
        projector_px=np.stack([geometry.column, geometry.row], axis=-1),
        visible=((flags & VISIBLE) > 0).astype(np.uint8),
        lit=((flags & LIT) > 0).astype(np.uint8),
        is_object=((flags & OBJECT) > 0).astype(np.uint8),
        T_camera_object=geometry.T_camera_object,
        scene=scene,
    )


def _points(kernel: Any, lens: Any, depth: Any, points: Any, first: int, end: int) -> None:
    kernel(first, end, lens, depth, points)
