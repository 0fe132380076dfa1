"""A smooth head-like relief and a flat hand-like one, seen by virtual pinhole cameras through ray marching.

Independent of the simulated rig: the surface is a formula, every camera samples it anew, so no two views
share a point. Object frame: x to the right, y downwards, z away from the camera, as in the camera's frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

DISTANCE_MM = 1000.0
REACH_MM = 125.0


def head(x, y):
    """Depth in mm of a face of 150 x 200 mm: dome, nose, brow, eye sockets, lips, chin, an odd cheek."""

    def bump(cx, cy, sx, sy, height):
        return height * np.exp(-(((x - cx) / sx) ** 2) - ((y - cy) / sy) ** 2)

    dome = 75 * np.sqrt(np.maximum(1.2 - (x / 85) ** 2 - (y / 115) ** 2, 0.02))
    face = bump(0, 8, 11, 24, 20) + bump(0, -34, 48, 10, 6) + bump(0, 58, 20, 6, 6) + bump(0, 88, 22, 12, 8)
    sockets = bump(-30, -16, 14, 9, -9) + bump(30, -16, 14, 9, -9) + bump(-42, 28, 18, 16, 4) + bump(36, -70, 20, 18, 3)
    return -(dome + face + sockets)


def hand(x, y):
    """Depth in mm of a flat relief: five ridges that spread, on a palm, 16 mm high at most."""
    fingers = 1e-12 * np.ones_like(x)
    for degrees, length in ((-38, 62), (-16, 80), (0, 88), (14, 82), (34, 66)):
        a = np.radians(degrees)
        along, across = x * np.sin(a) - y * np.cos(a), x * np.cos(a) + y * np.sin(a)
        ends = 1 + np.exp(-(along - 8) / 5) + np.exp((along - length) / 4)
        fingers = fingers + (np.exp(-((across / 9) ** 2)) / ends) ** 4
    total = 10 * np.exp(-((x / 45) ** 4) - ((y - 40) / 45) ** 4) + 14 * fingers**0.25
    return -total


OUTLINES = {head: (80.0, 108.0), hand: (85.0, 100.0)}


@dataclass(frozen=True)
class View:
    xyz_mm: np.ndarray
    T_camera_object: np.ndarray
    clean_mm: np.ndarray


def pose(rotation_deg=(0.0, 0.0, 0.0), translation_mm=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix()
    T[:3, 3] = np.array([0.0, 0.0, DISTANCE_MM]) + translation_mm
    return T


def see(shape=head, T=None, pitch_mm=1.2, size=(208, 192), noise_mm=0.0, seed=0, columns=None):
    """March the rays of a pinhole camera (pitch at the working distance); NaN where nothing is met.

    `columns` (first, last) fractions of the object's width that exist, to cut the overlap.
    """
    T = pose() if T is None else T
    rays, points, local = _seen(shape, tuple(T.ravel()), pitch_mm, size)
    half_x, half_y = OUTLINES[shape]
    inside = (local[..., 0] / half_x) ** 2 + (local[..., 1] / half_y) ** 2 < 1
    if columns is not None:
        place = local[..., 0] / (2 * half_x) + 0.5
        inside &= (place >= columns[0]) & (place <= columns[1])
    points = np.where(inside[..., None], points, np.nan)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (*size, 1)) * noise_mm
    return View((points + rays * noise).astype(np.float32), T, points)


@lru_cache(maxsize=32)
def _seen(shape, pose_values, pitch_mm, size):
    """Return each pixel's ray and the point that it meets, in the camera's and in the object's frame."""
    T = np.array(pose_values).reshape(4, 4)
    h, w = size
    v, u = np.mgrid[0:h, 0:w]
    rays = np.dstack([(u - w / 2 + 0.3) * pitch_mm, (v - h / 2 - 0.2) * pitch_mm, np.full((h, w), DISTANCE_MM)])
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    depth = np.full((h, w), np.nan)
    passing = np.linalg.norm(np.cross(rays, T[:3, 3]), axis=2) < REACH_MM  # of the object's origin
    depth[passing] = _march(shape, rays[passing] @ T[:3, :3], -T[:3, :3].T @ T[:3, 3], np.linalg.norm(T[:3, 3]))
    points = rays * depth[..., None]
    return rays, points, (points - T[:3, 3]) @ T[:3, :3]


def _march(shape, directions, start, distance_mm, step=3.0):
    """Return the distance along each ray to the first crossing of z = shape(x, y): march, then bisect."""

    def below(distance, directions=directions):
        at = start + directions * distance[..., None]
        return at[..., 2] - shape(at[..., 0], at[..., 1])

    lo = np.full(len(directions), np.nan)
    near = distance_mm - REACH_MM - 10
    previous = below(np.full(len(directions), near))
    for d in np.arange(near + step, distance_mm + 0.8 * REACH_MM, step):
        value = below(np.full(len(directions), d))
        lo[np.isnan(lo) & (previous < 0) & (value >= 0)] = d - step
        previous = value
    hit = np.isfinite(lo)
    a, b, along = lo[hit], lo[hit] + step, directions[hit]
    for _ in range(32):
        middle = 0.5 * (a + b)
        inside = below(middle, along) >= 0
        a, b = np.where(inside, a, middle), np.where(inside, middle, b)
    lo[hit] = 0.5 * (a + b)
    return lo


def truth(reference, model):
    return reference.T_camera_object @ np.linalg.inv(model.T_camera_object)


def errors(T, reference, model):
    """Return the rotation error in degrees and the RMS error in mm of the model's points."""
    T0 = truth(reference, model)
    delta = np.linalg.inv(T0) @ T
    points = model.clean_mm[np.isfinite(model.clean_mm[..., 0])]
    off = points @ (T - T0)[:3, :3].T + (T - T0)[:3, 3]
    return np.degrees(Rotation.from_matrix(delta[:3, :3]).magnitude()), float(np.sqrt((off**2).sum(1).mean()))
