"""A closed, star-shaped head r(direction), seen from all sides by virtual pinhole cameras; no two share a point.

Object frame: y downwards, z away from the first camera, as in its frame. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

DISTANCE_MM = 800.0
REACH_MM = 135.0
AXES = (72.0, 108.0, 92.0)
# direction, sharpness, height: nose, brow, sockets, chin, ears, an odd cheek, a bump and a hollow behind
BUMPS = (
    ((0.0, 0.1, -1.0), 60.0, 18.0),
    ((0.0, -0.35, -1.0), 14.0, 5.0),
    ((-0.4, -0.15, -1.0), 50.0, -7.0),
    ((0.4, -0.15, -1.0), 50.0, -7.0),
    ((0.05, 0.85, -0.8), 40.0, 8.0),
    ((-1.0, 0.05, 0.1), 60.0, 12.0),
    ((1.0, 0.0, 0.05), 50.0, 10.0),
    ((-0.7, 0.5, -0.6), 30.0, 5.0),
    ((0.4, -0.4, 1.0), 25.0, 7.0),
    ((-0.5, 0.3, 0.9), 35.0, -6.0),
    ((0.6, 0.4, 0.8), 40.0, 6.0),
    ((0.2, -1.0, 0.3), 20.0, 5.0),
)


def radius(u):
    """Return r in mm along unit directions (..., 3)."""
    r = 1 / np.sqrt((u[..., 0] / AXES[0]) ** 2 + (u[..., 1] / AXES[1]) ** 2 + (u[..., 2] / AXES[2]) ** 2)
    for at, sharpness, height in BUMPS:
        c = np.array(at) / np.linalg.norm(at)
        along = u[..., 0] * c[0] + u[..., 1] * c[1] + u[..., 2] * c[2]
        r = r + height * np.exp(sharpness * (along - 1))
    return r


def above(x):
    """Return |x| - r(x / |x|) of object points (..., 3): negative inside."""
    length = np.sqrt(np.einsum("...i,...i->...", x, x))
    return length - radius(x / length[..., None])


def distance(x, step=1e-3):
    """Return signed distances in mm of object points (n, 3) near the surface, and outward normals."""
    gradient = np.stack([above(x + step * e) - above(x - step * e) for e in np.eye(3)], axis=-1) / (2 * step)
    slope = np.linalg.norm(gradient, axis=-1)
    return above(x) / slope, gradient / slope[..., None]


@dataclass(frozen=True)
class View:
    xyz_mm: np.ndarray
    T_camera_object: np.ndarray
    clean_mm: np.ndarray


def pose(turn_deg, tilt_deg=0.0):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("yx", [turn_deg, tilt_deg], degrees=True).as_matrix()
    T[2, 3] = DISTANCE_MM
    return T


def see(T, pitch_mm=1.5, size=(176, 152), noise_mm=0.0, seed=0):
    """March the rays of a pinhole camera; NaN where nothing is met. Noise along the ray."""
    rays, points = _seen(tuple(T.ravel()), pitch_mm, size)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (*size, 1)) * noise_mm
    return View((points + rays * noise).astype(np.float32), T, points)


def grey(x):
    """Return an intensity of object points (..., 3), a smooth pattern, 40 to 216."""
    return 128 + 88 * np.sin(x[..., 0] / 14.0) * np.cos(x[..., 1] / 17.0)


@lru_cache(maxsize=40)
def _seen(pose_values, pitch_mm, size):
    T = np.array(pose_values).reshape(4, 4)
    h, w = size
    v, u = np.mgrid[0:h, 0:w]
    rays = np.dstack([(u - w / 2 + 0.3) * pitch_mm, (v - h / 2 - 0.2) * pitch_mm, np.full((h, w), DISTANCE_MM)])
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    start, turned = -T[:3, :3].T @ T[:3, 3], rays @ T[:3, :3]
    depth = np.full((h, w), np.nan)
    closest = np.linalg.norm(np.cross(turned, start), axis=2)
    passing = closest < REACH_MM
    depth[passing] = _march(turned[passing], start, closest[passing])
    return rays, rays * depth[..., None]


def _march(directions, start, closest_mm, step=4.0):
    """Return the distance along each ray to its first crossing: march from the bounding sphere, then bisect."""
    middle = -(directions @ start)
    half = np.sqrt(np.maximum(REACH_MM**2 - closest_mm**2, 0.0))
    at, found = middle - half, np.full(len(directions), np.nan)
    active = np.arange(len(directions))
    while active.size:
        at[active] += step
        value = above(start + directions[active] * at[active, None])
        found[active[value < 0]] = at[active[value < 0]]
        active = active[(value >= 0) & (at[active] < (middle + half)[active])]
    hit = np.isfinite(found)
    a, b, along = found[hit] - step, found[hit], directions[hit]
    for _ in range(25):
        c = 0.5 * (a + b)
        inside = above(start + along * c[:, None]) < 0
        a, b = np.where(inside, a, c), np.where(inside, c, b)
    found[hit] = 0.5 * (a + b)
    return found
