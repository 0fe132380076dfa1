"""How far measured surfaces are from the simulator's truth.

Owns the figures and their definitions; arrays in, numbers out.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, degrees
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fringed.data import Array, Float64Array, Model, RangeImage, Truth
from fringed_client.pictures.geometry import cloud_of

FLYER_MM = 1.0


def ray_error_mm(image: RangeImage, truth: Truth) -> Array:
    """Return the error along each camera ray `(height, width)` in mm, positive is too far; NaN where unknown."""
    measured = np.linalg.norm(image.xyz_mm, axis=2)
    return np.asarray(measured - np.linalg.norm(truth.xyz_mm, axis=2))


def view_figures(image: RangeImage, truth: Truth) -> dict[str, float]:
    """Return bias, scatter against the predicted one, completeness and flyers of one range image.

    `scatter_ratio` is the standard deviation of error / predicted sigma, over points that are no flyers.
    `completeness` counts the pixels whose point is truly visible, lit, and of the object.
    """
    error = ray_error_mm(image, truth)
    kept = image.rejected == 0
    wanted = (truth.visible > 0) & (truth.lit > 0) & (truth.is_object > 0)
    known = kept & np.isfinite(error)
    flyer = (kept & ~np.isfinite(error)) | (known & (np.abs(error) > FLYER_MM))
    good = known & ~flyer
    found = {
        "points": int(kept.sum()),
        "bias_mm": _of(np.mean, error[good]),
        "median_error_mm": _of(np.median, error[good]),
        "scatter_mm": _of(np.std, error[good]),
        "completeness": float(np.mean(kept[wanted])) if wanted.any() else 0.0,
        "flyers": int(flyer.sum()),
    }
    if image.sigma_mm is not None:
        sigma = image.sigma_mm[good]
        found["predicted_scatter_mm"] = _of(lambda s: np.sqrt(np.mean(s**2)), sigma)
        found["scatter_ratio"] = _of(np.std, error[good] / np.maximum(sigma, 1e-9))
    return found


def _of(function: Any, values: Array) -> float:
    return float(function(values)) if values.size else float("nan")


def true_transform(first: Truth, other: Truth) -> Float64Array:
    """Return T_model_view of another view, the model being in the first view's frame."""
    return np.asarray(first.T_camera_object @ np.linalg.inv(other.T_camera_object))


def transform_error(estimated: Array, true: Array, points_mm: Array) -> dict[str, float]:
    """Return the rotation error in degrees, and how far the points of the view are from where they belong, in mm."""
    rotation = true[:3, :3].T @ estimated[:3, :3]
    cosine = min(1.0, max(-1.0, (float(np.trace(rotation)) - 1) / 2))
    centre = points_mm.mean(axis=0, dtype=np.float64)
    return {
        "rotation_error_deg": degrees(acos(cosine)),
        "translation_error_mm": float(np.linalg.norm(displacement(estimated, true, centre[None])[0])),
        "displacement_rms_mm": float(np.sqrt(np.mean(np.sum(displacement(estimated, true, points_mm) ** 2, axis=1)))),
    }


def displacement(estimated: Array, true: Array, points_mm: Array) -> Array:
    """Return how far each point (n, 3) is put from where it belongs."""
    wrong = estimated - true
    return np.asarray(points_mm.astype(np.float64) @ wrong[:3, :3].T + wrong[:3, 3])


@dataclass(frozen=True)
class Surface:
    """The true surface of an object: points (n, 3) and normals (n, 3) in the model's frame."""

    points_mm: Array
    normals: Array

    def distance_mm(self, points_mm: Array) -> Array:
        """Return the distance of points (n, 3) to the tangent at their nearest true point; outside is positive."""
        _, nearest = cKDTree(self.points_mm).query(points_mm, workers=1)
        return np.asarray(np.einsum("ij,ij->i", points_mm - self.points_mm[nearest], self.normals[nearest]))


def true_surface(truths: list[Truth], step: int = 2) -> Surface:
    """Return what all views see of the object, every `step`-th pixel, in the first view's frame."""
    points, normals = [], []
    for truth in truths:
        seen = np.where((truth.is_object > 0)[..., None], truth.xyz_mm, np.nan)[::step, ::step]
        own, own_normals, _ = cloud_of(np.ascontiguousarray(seen))
        transform = true_transform(truths[0], truth)
        points.append(own @ transform[:3, :3].T + transform[:3, 3])
        normals.append(own_normals @ transform[:3, :3].T)
    return Surface(np.concatenate(points), np.concatenate(normals))


def sample(count: int, most: int) -> slice:
    """Return a slice that takes about `most` of `count`."""
    return slice(None, None, max(1, count // most))


def model_figures(model: Model, error_mm: Array) -> dict[str, float]:
    """Return the figures of a model's signed distances to the true surface."""
    return {
        "points": len(model.points_mm),
        "views": len(model.views),
        "bias_mm": float(np.mean(error_mm)),
        "median_abs_error_mm": float(np.median(np.abs(error_mm))),
        "rms_error_mm": float(np.sqrt(np.mean(error_mm**2))),
        "p99_abs_error_mm": float(np.percentile(np.abs(error_mm), 99)),
        "beyond_1_mm": float(np.mean(np.abs(error_mm) > FLYER_MM)),
    }
