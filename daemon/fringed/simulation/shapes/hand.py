"""A plaster relief of a hand on a slab.

Owns the model: palm, fingers and thumb as blended capsules, seen as a height over the slab.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

import numpy as np
from msgspec import Meta

from fringed.data import Array
from fringed.simulation.shapes.basic import Size
from fringed.simulation.shapes.shape import Shape, ShapeOptions, grid_faces, mesh_shape

Point = tuple[float, float, float]

# Each finger: its joints from knuckle to tip as (x, y, radius) in mm; the middle of the palm is near (0, -30).
_FINGERS: tuple[tuple[Point, ...], ...] = (
    ((-31, 2, 9.5), (-39, 32, 8.6), (-43, 52, 7.8), (-46, 67, 6.9)),
    ((-11, 10, 10.4), (-15, 48, 9.4), (-17, 74, 8.5), (-18, 93, 7.4)),
    ((11, 12, 10.8), (11, 54, 9.8), (11, 82, 8.8), (11, 102, 7.6)),
    ((32, 6, 10.4), (37, 44, 9.4), (40, 69, 8.5), (42, 87, 7.4)),
    ((36, -52, 13.0), (60, -24, 11.0), (74, 0, 9.4), (80, 14, 8.0)),
)
_PALM: tuple[tuple[Point, Point], ...] = (
    ((-26, -6, 14.0), (-24, -70, 17.0)),
    ((-8, 0, 14.5), (-8, -74, 15.0)),
    ((12, 0, 14.5), (8, -74, 15.0)),
    ((29, -4, 14.0), (20, -70, 15.0)),
    ((26, -66, 17.0), (40, -46, 15.0)),
    ((-2, -70, 17.0), (-2, -112, 17.0)),
)
_SINK = 0.25  # of a radius: how deep a capsule sits in the slab


class HandOptions(ShapeOptions, frozen=True, kw_only=True):
    """A plaster hand, palm down, 220 mm tall, on a slab."""

    slab_mm: Annotated[Size, Meta(description="thickness of the slab")] = 15.0
    width_mm: Size = 210.0
    height_mm: Size = 250.0
    pitch_mm: Annotated[float, Meta(ge=0.2, le=10, extra_json_schema={"units": "mm"})] = 0.7


def hand(options: HandOptions) -> Shape:
    """Return the mesh of relief and slab, the slab's upper side at z = 0."""
    columns, rows = (int(np.ceil(size / options.pitch_mm)) + 1 for size in (options.width_mm, options.height_mm))
    x, y = np.meshgrid(
        np.linspace(-options.width_mm / 2, options.width_mm / 2, columns, dtype=np.float32),
        np.linspace(options.height_mm / 2, -options.height_mm / 2, rows, dtype=np.float32),
    )
    relief = np.stack([x - 8, y - 2, _height(x - 8, y - 2)], axis=-1) + np.array([8, 2, 0], np.float32)
    vertices, faces = _with_sides(relief, options.slab_mm)
    return mesh_shape(vertices, faces)


def _height(x: Array, y: Array) -> Array:
    fingers = np.full_like(x, -20.0)
    for joints in _FINGERS:
        finger = np.full_like(x, -20.0)
        for a, b in pairwise(joints):
            finger = _higher(finger, _bone(x, y, a, b), 4.0)
        for joint in joints[1:-1]:  # knuckles are thicker than what is between them
            finger = finger + 1.1 * np.exp(-((x - joint[0]) ** 2 + (y - joint[1]) ** 2) / (0.75 * joint[2]) ** 2)
        tip, last = joints[-1], joints[-2]
        nail = (tip[0] + 0.1 * (tip[0] - last[0]), tip[1] + 0.1 * (tip[1] - last[1]))
        finger = finger - 0.9 * _plateau(np.hypot(x - nail[0], y - nail[1]) / (0.62 * tip[2]))
        fingers = _higher(fingers, finger, 3.0)
    palm = np.full_like(x, -20.0)
    for a, b in _PALM:
        palm = _higher(palm, _bone(x, y, a, b), 12.0)
    for joints in _FINGERS[:4]:  # the row of knuckles, and the tendons that lead to it
        knuckle, end = joints[0], (0.35 * joints[0][0], -70.0)
        palm = palm + 3.0 * np.exp(-((x - knuckle[0]) ** 2 + (y - knuckle[1] + 3) ** 2) / 7.5**2)
        palm = palm + 1.2 * np.exp(-((_to_line(x, y, knuckle[:2], end)[0] / 3.2) ** 2))
    return np.asarray(_higher(_higher(fingers, palm, 8.0), np.zeros_like(x), 3.0), dtype=np.float32)


def _to_line(x: Array, y: Array, a: tuple[float, ...], b: tuple[float, ...]) -> tuple[Array, Array]:
    """Return the distance to a line from a to b, and where along it, 0 to 1."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    along = np.clip(((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy), 0, 1)
    return np.hypot(x - a[0] - along * dx, y - a[1] - along * dy), along


def _bone(x: Array, y: Array, a: Point, b: Point) -> Array:
    """Return the height of a capsule that lies in the slab; beside it the height falls steeply."""
    distance, along = _to_line(x, y, a[:2], b[:2])
    radius = a[2] + (b[2] - a[2]) * along
    inside = np.sqrt(np.maximum(radius**2 - distance**2, 0.04 * radius**2))
    outside = 4.9 * np.maximum(distance - 0.98 * radius, 0)  # goes on where the circle gets too steep
    return np.asarray(inside - outside + (1 - 2 * _SINK) * radius, dtype=x.dtype)


def _higher(a: Array, b: Array, blend_mm: float) -> Array:
    """Return the smooth maximum."""
    h = np.maximum(blend_mm - np.abs(a - b), 0) / blend_mm
    return np.asarray(np.maximum(a, b) + h * h * (blend_mm / 4), dtype=a.dtype)


def _plateau(r: Array) -> Array:
    return np.asarray(1 / (1 + r**8), dtype=r.dtype)


def _with_sides(relief: Array, slab_mm: float) -> tuple[Array, Array]:
    """Add the slab's four sides and its back to a relief (rows, columns, 3)."""
    rows, columns = relief.shape[:2]
    edge = np.concatenate([relief[0, :-1], relief[:-1, -1], relief[-1, :0:-1], relief[:0:-1, 0]])
    below = edge.copy()
    below[:, 2] = -slab_mm
    band = np.stack([edge, below])
    first = rows * columns
    sides = grid_faces(2, len(edge), closed=True) + first
    corners = first + 2 * len(edge)
    x0, x1, y0, y1 = relief[0, 0, 0], relief[0, -1, 0], relief[0, 0, 1], relief[-1, 0, 1]
    back = np.array([[x0, y0, -slab_mm], [x1, y0, -slab_mm], [x1, y1, -slab_mm], [x0, y1, -slab_mm]])
    vertices = np.concatenate([relief.reshape(-1, 3), band.reshape(-1, 3), back])
    bottom = np.array([[0, 1, 2], [0, 2, 3]]) + corners
    return vertices, np.concatenate([grid_faces(rows, columns), sides, bottom])
