"""Range images of artefacts by arithmetic: a pinhole camera, exact intersections, noise along the rays."""

from __future__ import annotations

import numpy as np

FIELD_MM, DISTANCE_MM = 400.0, 1000.0


def rays(width=348, height=260):
    """Return directions (height, width, 3), z = 1, of a camera that sees 400 mm at 1000 mm."""
    v, u = np.mgrid[:height, :width]
    focal = width * DISTANCE_MM / FIELD_MM
    return np.stack([(u - (width - 1) / 2) / focal, (v - (height - 1) / 2) / focal, np.ones(u.shape)], axis=-1)


def sphere_depth(ray, centre, radius):
    """Return the near z of a sphere, NaN beside it."""
    a, b = np.einsum("...i,...i", ray, ray), ray @ np.asarray(centre, float)
    root = b * b - a * (np.dot(centre, centre) - radius**2)
    return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, np.nan)


def plane_depth(ray, normal, through):
    """Return z of a plane through a point."""
    return np.dot(normal, through) / (ray @ np.asarray(normal, float))


def stairs_depth(ray, heights, tread_mm=40.0, half_mm=90.0, base_mm=1000.0):
    """Return z of treads side by side at the heights above a base, NaN around."""
    z = np.full(ray.shape[:2], np.nan)
    left = -tread_mm * len(heights) / 2
    for number, height in enumerate(heights):
        x, y = (ray[..., axis] * (base_mm - height) for axis in (0, 1))
        low = left + number * tread_mm
        z[(x > low) & (x < low + tread_mm) & (np.abs(y) < half_mm)] = base_mm - height
    return z


def points(ray, depth, noise_mm=0.06, seed=0, sideways_mm=None):
    """Return float32 points (height, width, 3) with noise along the rays, and which are valid."""
    length = np.linalg.norm(ray, axis=-1)
    noise = np.random.default_rng(seed).normal(0, 1, depth.shape) * noise_mm
    along = depth * length + noise + (0 if sideways_mm is None else sideways_mm)
    return (ray / length[..., None] * along[..., None]).astype(np.float32), np.isfinite(depth)
