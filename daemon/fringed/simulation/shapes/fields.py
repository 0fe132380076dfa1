"""Signed distances and how they blend, for objects that are modelled rather than measured.

Owns ellipsoids, capsules and smooth unions; arrays in, arrays out. Points are three arrays x, y, z of one
shape, float32 (three times as fast as one array of triples); distances are in millimetres, negative inside.
"""

from __future__ import annotations

import numpy as np

from fringed.data import Array

Vector = tuple[float, float, float]
Points = tuple[Array, Array, Array]


def ellipsoid(p: Points, centre: Vector, radii: Vector) -> Array:
    """Return the distance to an ellipsoid, right to first order near its surface."""
    k0: Array = np.zeros((), np.float32)
    k1 = k0
    for x, c, r in zip(p, centre, radii, strict=True):
        q = (x - np.float32(c)) * np.float32(1 / r)
        k0 = k0 + q * q
        q *= np.float32(1 / r)
        k1 = k1 + q * q
    k0 = np.asarray(np.sqrt(k0))
    return np.asarray(k0 * (k0 - 1) / np.maximum(np.sqrt(k1), np.float32(1e-9)))


def capsule(p: Points, ends: tuple[Vector, Vector], radii: tuple[float, float]) -> Array:
    """Return the distance to a capsule whose radius changes from one end to the other."""
    along = np.subtract(ends[1], ends[0])
    unit = (along / float(along @ along)).astype(np.float32)
    from_a = [x - np.float32(a) for x, a in zip(p, ends[0], strict=True)]
    h = np.clip(sum(x * u for x, u in zip(from_a, unit, strict=True)), 0, 1)
    square: Array = np.zeros((), np.float32)
    for x, step in zip(from_a, along.astype(np.float32), strict=True):
        x = x - h * step
        square = square + x * x
    return np.asarray(np.sqrt(square) - (np.float32(radii[0]) + np.float32(radii[1] - radii[0]) * h))


def union(a: Array, b: Array, blend_mm: float) -> Array:
    """Return the smooth union of two distances."""
    h = np.maximum(blend_mm - np.abs(a - b), 0) / blend_mm
    return np.asarray(np.minimum(a, b) - h * h * (blend_mm / 4), dtype=a.dtype)


def carve(a: Array, b: Array, blend_mm: float) -> Array:
    """Return `a` without what is inside `b`, the edge smoothed."""
    return -union(-a, b, blend_mm)


def bump(p: Points, centre: Vector, radius_mm: float) -> Array:
    """Return a smooth bump, 1 at its centre and 0.37 at `radius_mm`."""
    square: Array = np.zeros((), np.float32)
    for x, c in zip(p, centre, strict=True):
        square = square + (x - np.float32(c)) ** 2
    return np.asarray(np.exp(square * np.float32(-1 / radius_mm**2)))
