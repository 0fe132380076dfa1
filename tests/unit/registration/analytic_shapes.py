"""Shapes with known principal curvatures, seen by a pinhole camera or sampled on a sheared, tilted grid.

Each shape is (implicit, curvatures): a function of points (..., 3) that is negative inside, and k1 >= k2 (..., 2),
positive where the shape bulges out.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def sphere(radius=60.0):
    def curvature(p):
        return np.broadcast_to([1 / radius, 1 / radius], (*p.shape[:-1], 2))

    return (lambda p: np.linalg.norm(p, axis=-1) - radius), curvature


def cylinder(radius=40.0):
    def curvature(p):
        return np.broadcast_to([1 / radius, 0.0], (*p.shape[:-1], 2))

    return (lambda p: np.hypot(p[..., 0], p[..., 2]) - radius), curvature


def torus(large=50.0, small=20.0):
    """A ring around the z axis, whose inner half is a saddle."""

    def implicit(p):
        return np.hypot(np.hypot(p[..., 0], p[..., 1]) - large, p[..., 2]) - small

    def curvature(p):
        cosine = (np.hypot(p[..., 0], p[..., 1]) - large) / small
        around = cosine / (large + small * cosine)
        return np.stack(np.broadcast_arrays(1 / small, around), axis=-1)

    return implicit, curvature


def saddle(a=60.0, b=90.0):
    """The height z = y^2 / 2 b - x^2 / 2 a, air below it: the camera's side."""

    def curvature(p):
        x, y = p[..., 0], p[..., 1]
        zx, zy, w = -x / a, y / b, np.sqrt(1 + (x / a) ** 2 + (y / b) ** 2)
        H = ((1 + zy**2) * (-1 / a) + (1 + zx**2) / b) / (2 * w**3)
        root = np.sqrt(H**2 + 1 / (a * b * w**4))
        return np.stack([H + root, H - root], axis=-1)

    return (lambda p: p[..., 1] ** 2 / (2 * b) - p[..., 0] ** 2 / (2 * a) - p[..., 2]), curvature


SHAPES = {"sphere": sphere(), "cylinder": cylinder(), "torus": torus(), "saddle": saddle()}


def seen(shape, turn_deg=(0.0, 0.0, 0.0), n=121, pitch=0.5, distance=500.0):
    """Return what a camera at the origin sees of a shape at `distance`: points, where, and k1, k2 there.

    `pitch` is that of the grid at the shape's middle; rays cross the shape's surface from outside.
    """
    implicit, curvature = shape
    R = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    u = (np.arange(n) - (n - 1) / 2) * pitch / distance
    rays = np.dstack([*np.meshgrid(u, u), np.ones((n, n))])

    def value(depth):
        return implicit((rays * depth[..., None] - [0, 0, distance]) @ R)

    low, high = np.full((n, n), np.nan), np.full((n, n), np.nan)
    depths = np.arange(distance - 100.0, distance + 100.0, 2.0)
    before = value(np.full((n, n), depths[0]))
    for depth in depths[1:]:
        now = value(np.full((n, n), depth))
        hit = np.isnan(low) & (before > 0) & (now <= 0)
        low[hit], high[hit] = depth - 2.0, depth
        before = now
    for _ in range(45):
        middle = 0.5 * (low + high)
        inside = value(middle) <= 0
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    points = rays * (0.5 * (low + high))[..., None]
    return points, np.isfinite(low), curvature((points - [0, 0, distance]) @ R)
