"""A head with nose, eyes, brows, lips, chin and ears: a face that nobody has.

Owns the model, made of blended ellipsoids and capsules and sampled along rays from its middle, so that it is closed
and one piece. What differs from person to person is in `person`.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from fringed.data import Array, Float32Array
from fringed.simulation.rows import for_rows
from fringed.simulation.shapes.fields import Points, Vector, bump, capsule, carve, ellipsoid, union
from fringed.simulation.shapes.person import Proportions, proportions, uneven_mm
from fringed.simulation.shapes.shape import Shape, ShapeOptions, grid_faces, mesh_shape

_OUTSIDE_MM = 175.0
_BOTTOM_MM = -128.0
_STEPS = 9  # more would turn walls along a ray, such as the nose's sides, into stairs; now they are ramps
_ARRIVED_MM = 0.01


class HeadOptions(ShapeOptions, frozen=True, kw_only=True):
    """A face-like head, some 240 mm tall, its nose towards z."""

    seed: Annotated[int, Meta(ge=0, le=2**63 - 1, description="whose head; nine proportions differ")] = 0
    variant: Annotated[int, Meta(ge=0, le=2**63 - 1, description="whose head; all differs that does in people")] = 0
    columns: Annotated[int, Meta(ge=24, le=2000, description="vertices around")] = 420
    rows: Annotated[int, Meta(ge=16, le=2000, description="vertices from crown to neck")] = 310


def head(options: HeadOptions) -> Shape:
    """Return the mesh of the head."""
    person = proportions(options.seed, options.variant)
    directions = _directions(options.rows, options.columns)
    coarse = _directions(options.rows // 4 + 2, options.columns // 4)
    radius = np.full(coarse.shape[:2], _OUTSIDE_MM, np.float32)
    _approach(radius, coarse, person, 3 * _STEPS)
    start = _grown(radius, directions.shape[:2]) + 3.0
    _approach(start, directions, person, _STEPS)
    if options.variant:
        start += uneven_mm(directions, options.variant)
    points = directions * start[..., None]
    vertices = points.reshape(-1, 3)
    return mesh_shape(vertices, grid_faces(options.rows, options.columns, closed=True), _albedo(vertices, person))


def _directions(rows: int, columns: int) -> Float32Array:
    """Return unit vectors (rows, columns, 3) from crown to neck, closer to each other on the face."""
    turn = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    azimuth = turn - 0.35 * np.sin(turn)
    polar = np.linspace(0.0, np.pi, rows)[:, None]
    polar = polar + 0.12 * np.sin(2 * polar)
    flat = np.sin(polar)
    vectors = [flat * np.sin(azimuth), np.cos(polar) * np.ones_like(azimuth), flat * np.cos(azimuth)]
    return np.stack(vectors, axis=-1).astype(np.float32)


def _approach(radius: Float32Array, directions: Float32Array, person: Proportions, steps: int) -> None:
    """Move along each ray from outside to the surface; most rays need fewer than `steps`."""
    x, y, z = (np.ascontiguousarray(directions[..., axis]) for axis in range(3))

    def block(first: int, end: int) -> None:
        r = radius[first:end].reshape(-1)
        ray = [axis[first:end].reshape(-1) for axis in (x, y, z)]
        open_rays = np.arange(r.size)
        for _ in range(steps):
            at = r[open_rays]
            step = np.float32(0.95) * _distance((ray[0] * at, ray[1] * at, ray[2] * at), person)
            r[open_rays] = at - step
            moving = np.abs(step) > _ARRIVED_MM
            open_rays = open_rays[moving]
            ray = [axis[moving] for axis in ray]
            if not open_rays.size:
                break

    for_rows(len(radius), block)


def _grown(radius: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """Return the coarse radii on the finer grid, each the largest of its neighbours, so that it stays outside."""
    padded = np.pad(np.pad(radius, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), mode="edge")
    height, width = radius.shape
    largest = np.max([padded[i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=0)
    rows = np.rint(np.linspace(0, height - 1, shape[0])).astype(int)
    columns = np.rint(np.arange(shape[1]) * width / shape[1]).astype(int) % width
    return np.ascontiguousarray(largest[np.ix_(rows, columns)], dtype=np.float32)


def _distance(points: Points, person: Proportions) -> Array:
    """Return the distance to the head; it is symmetric, so one side is modelled."""
    p = (np.abs(points[0]) * np.float32(1 / person.width), points[1], points[2])
    d = _skull(p, person)
    d = _eyes(d, p, person)
    d = _nose(d, p, person)
    d = _mouth(d, p, person)
    d = _ears(d, p, person)
    return carve(d, p[1] - np.float32(_BOTTOM_MM), 8)


def _skull(p: Points, person: Proportions) -> Array:
    long, cheeks, forward = person.face_length_mm, person.cheeks, person.neck_forward_mm
    depth = 94 * person.skull_depth
    d = ellipsoid(p, (0, 30, 78 - depth), (74, 84 * person.skull_height, depth))
    d = union(d, ellipsoid(p, (0, -22, 14), (60, 86, 66)), 24)
    d = union(d, ellipsoid(p, (0, -72 - 0.6 * long, 22), (49 * person.jaw, 36 * person.jaw_height, 47)), 20)
    chin = (0, -97 - long, 58 + person.chin_out_mm)
    d = union(d, ellipsoid(p, chin, (19, 13 * person.chin, 17 * person.chin)), 16)
    cheek = (41 + person.cheeks_out_mm, -12 + person.cheeks_up_mm, 46)
    d = union(d, ellipsoid(p, cheek, (20 * cheeks, 13 * cheeks, 20)), 16)
    neck: tuple[Vector, Vector] = ((0, -70, -28 + forward), (0, -150, -40 + forward))
    d = union(d, capsule(p, neck, (50 * person.neck, 54 * person.neck)), 18)
    if person.forehead_mm:
        d = d - np.float32(person.forehead_mm) * bump(p, (0, 60, 62), 36)
    hollow = 2.2 + person.hollow_mm
    return d + hollow * bump(p, (38, -48 - 0.4 * long, 60), 16)  # the hollow below the cheekbone


def _eyes(d: Array, p: Points, person: Proportions) -> Array:
    x, wide, out = 31 * person.eyes, person.sockets, person.brow_out_mm
    d = carve(d, ellipsoid(p, (x, 13, 80), (18 * wide, 11 * wide, 18 * wide)), 14)
    brow: tuple[Vector, Vector] = ((11, 26, 76 + out), (43, 29, 60 + out))
    d = union(d, capsule(p, brow, (6.5 * person.brow, 5.0 * person.brow)), 12)
    d = union(d, ellipsoid(p, (x, 12, 55), (12.5 * person.eyeballs, 12, 12 * person.eyeballs)), 2)
    d = union(d, capsule(p, ((x - 12, 14, 61), (x, 20, 66)), (2.0, 3.0)), 5)
    d = union(d, capsule(p, ((x, 20, 66), (x + 13, 13, 56)), (3.0, 2.2)), 5)
    return union(d, capsule(p, ((x - 11, 8, 61), (x + 11, 7, 58)), (2.2, 2.2)), 5)


def _nose(d: Array, p: Points, person: Proportions) -> Array:
    out, wide, long = 8 * (person.nose - 1) * 4, person.nose_width, person.nose_length_mm
    bridge: tuple[Vector, Vector] = ((0, 24, 77 + person.bridge_out_mm), (0, -16 - long, 97 + out))
    d = union(d, capsule(p, bridge, (5.0 * person.bridge, 7.0 * wide)), 12)
    if person.hook_mm:
        d = d - np.float32(person.hook_mm) * bump(p, (0, 6 - 0.5 * long, 90 + 0.5 * out), 10)
    d = union(d, ellipsoid(p, (0, -20 - long, 98 + out), (10 * wide, 9, 11)), 7)
    d = union(d, ellipsoid(p, (12 * wide, -24 - long, 86 + out / 2), (7.5 * wide, 7.5, 11)), 5)
    return carve(d, ellipsoid(p, (6.5 * wide, -32 - long, 93 + out), (3.6, 5, 6)), 3)


def _mouth(d: Array, p: Points, person: Proportions) -> Array:
    full, wide, out, down = person.lips, person.mouth_width, person.mouth_out_mm, person.mouth_down_mm

    def line(ends: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        (x0, y0, z0), (x1, y1, z1) = ends
        return (x0, y0 - down, z0 + out), (x1 * wide, y1 - down, z1 + out)

    d = union(d, ellipsoid(p, (0, -56 - down, 66 + out), (30 * wide, 20, 19)), 14)
    d = d + 1.8 * bump(p, (0, -42 - down, 86 + out), 5)  # the groove between nose and lip
    d = union(d, capsule(p, line(((0, -52.5, 83.5), (23, -57.5, 74))), (4.4 * full, 2.2)), 3)
    d = union(d, capsule(p, line(((0, -62, 82.5), (20, -59.5, 75))), (5.4 * full, 2.4)), 3)
    d = carve(d, capsule(p, line(((0, -57, 89.5), (23, -58.3, 78.5))), (1.5, 0.7)), 2.5)
    return d + 3.2 * bump(p, (0, -75 - 0.75 * person.face_length_mm, 80 + out), 9)  # the hollow above the chin


def _ears(d: Array, p: Points, person: Proportions) -> Array:
    size = person.ears
    x, y, z = p[0] - np.float32(77), p[1] - np.float32(2 + person.ears_up_mm), p[2] + np.float32(14)
    lean, out = np.float32(0.22 + person.ears_lean), np.float32(0.28 + person.ears_out)
    scale = np.float32(1 / size)
    q = ((x + out * z) * scale, (y - lean * z) * scale, (z + lean * y) * scale)
    ear = ellipsoid(q, (0, 0, 0), (6.5, 32, 19))
    ear = carve(ear, ellipsoid(q, (7.5, 4, 2), (6.5, 22, 12)), 3)
    ear = union(ear, ellipsoid(q, (1, -2, 11), (4, 6, 4)), 4)
    return union(d, np.float64(size) * ear, 6)  # in double precision ever since: today's face stays to the bit


def _albedo(points: Array, person: Proportions) -> Float32Array:
    """Return skin that is 1, with darker lips, brows and irises, and a scalp a little darker."""
    p = (np.abs(points[:, 0]) / np.float32(person.width), points[:, 1], points[:, 2])
    x, down = np.float64(31 * person.eyes), person.mouth_down_mm
    front = p[2] > 40
    tint = np.ones(len(points), np.float32)
    lips = ellipsoid(p, (0, -57.5 - down, 80), (24 * person.mouth_width, 9 * person.lips, 16))
    tint -= 0.25 * _step(-lips, 1.0) * front
    brow = _step(-capsule(p, ((10, 31, 78), (42, 34, 62)), (4.5, 3.0)) + 3.0, 1.2)
    tint -= 0.35 * brow * front
    tint -= 0.45 * _step(5.5 - np.hypot(p[0] - x, p[1] - 13), 0.6) * front
    scalp = _step(p[1] - 22 - 0.8 * np.clip(p[2], -60, 68), 6.0)
    return np.asarray(tint - 0.15 * scalp, dtype=np.float32)


def _step(value: Array, softness: float) -> Array:
    return np.clip(value / (2 * softness) + 0.5, 0, 1)
