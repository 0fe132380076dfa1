"""Normals and neighbourhoods of organised points, for pictures.

Owns display geometry only; what is measured on surfaces is the plug-ins' work.
"""

from __future__ import annotations

import cv2
import numpy as np

from fringed.data import Array, Float32Array


def grid_normals(xyz_mm: Array, window: int = 5) -> Float32Array:
    """Return unit normals `(height, width, 3)` towards the camera, from points smoothed over `window` pixels.

    NaN where there is no point or too few neighbours.
    """
    valid = np.isfinite(xyz_mm[..., 2])
    weight = cv2.blur(valid.astype(np.float32), (window, window))
    smooth: Array = cv2.blur(np.where(valid[..., None], xyz_mm, 0).astype(np.float32), (window, window))
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = smooth / weight[..., None]
    smooth[weight < 0.5] = np.nan
    across, down = np.full_like(smooth, np.nan), np.full_like(smooth, np.nan)
    across[:, 1:-1] = smooth[:, 2:] - smooth[:, :-2]
    down[1:-1] = smooth[2:] - smooth[:-2]
    normals = np.cross(down, across)  # x right, y down, z away: this order points to the camera
    with np.errstate(invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    normals[~valid] = np.nan
    return np.asarray(normals, np.float32)


def cloud_of(xyz_mm: Array, values: Array | None = None) -> tuple[Float32Array, Float32Array, Array | None]:
    """Return points (n, 3), normals (n, 3) and values (n,) of an organised range image's kept pixels."""
    normals = grid_normals(xyz_mm)
    kept = np.isfinite(xyz_mm[..., 2]) & np.isfinite(normals[..., 2])
    return (
        np.asarray(xyz_mm[kept], np.float32),
        np.asarray(normals[kept], np.float32),
        None if values is None else values[kept],
    )
