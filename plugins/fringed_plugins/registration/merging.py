"""Registered views to one cloud: overlaps keep the better seen point, moved to the weighted mean.

Owns weights and redundancy. A view sees a point well where the noise is low, the surface faces the
camera and the border is far; weights fall smoothly to zero at a view's border, so that no seam shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.footpoints import Grid, build_grid, feet
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, apply, inverse, translation, turned

Array = npt.NDArray[Any]
FEATHER_PX = 20.0
SMOOTH_PX = 15
CHUNK = 60_000  # points between two reports
SAME_SIDE_COS = 0.5
NOISES = 6.0
RESOLUTIONS = 2.0


@dataclass(frozen=True)
class Cloud:
    """Merged points (n, 3) mm and unit normals, float32; intensity and the view each came from, uint8.

    `confidence` (n,) float32 is the sum of the weights of all views that saw a point, in 1 / mm^2.
    """

    points: Array
    normals: Array
    intensity: Array
    view_index: Array
    confidence: Array


@dataclass(frozen=True)
class _Seen:
    grid: Grid
    weight: Array
    T_model_centred: FloatArray


def merge(
    surfaces: Sequence[Surface],
    intensities: Sequence[Array],
    T_model_view: FloatArray,
    window_px: int = 7,
    report: Report = silent,
) -> Cloud:
    """Return one cloud of all views in the model's frame.

    Parameters
    ----------
    surfaces
        prepared views.
    intensities
        uint8 (height, width) of each whole range image.
    T_model_view
        (n, 4, 4), takes points of each view to the model's frame.
    window_px
        side of the windows for normals; pixels without a complete one are dropped.
    report
        hears (fraction, text) and may raise to stop the work.

    Raises
    ------
    ValueError
        lists of different lengths, more than 255 views, or none.
    """
    if not 0 < len(surfaces) < 256 or not len(surfaces) == len(intensities) == len(T_model_view):
        raise ValueError(
            f"{len(surfaces)} views, {len(intensities)} intensities, {len(T_model_view)} poses; expected the same "
            "number of each, 1 to 255"
        )
    seen: list[_Seen] = []
    for surface, T in zip(surfaces, T_model_view, strict=True):
        report(0.3 * len(seen) / len(surfaces), f"normals of the {surface.name}")
        grid = build_grid(surface, window_px)
        seen.append(_Seen(grid, _weights(grid), T @ translation(surface.origin)))
    parts = []
    for number, intensity in enumerate(intensities):
        report(0.3 + 0.7 * number / len(seen), f"redundancy of the {surfaces[number].name}")
        parts.append(_own_points(seen, number, intensity, lambda text: report(0.3, text)))
    return Cloud(*(np.concatenate([part[k] for part in parts]) for k in range(5)))


def _weights(grid: Grid) -> Array:
    """Return smooth weights (height, width) in 1 / mm^2, flattened; zero where not usable."""
    surface = grid.surface
    ray = surface.xyz + surface.origin.astype(np.float32)
    cosine = np.abs(np.einsum("ijk,ijk->ij", ray, grid.normals)) / np.sqrt(np.einsum("ijk,ijk->ij", ray, ray))
    from_border = cv2.distanceTransform(np.pad(surface.valid, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    variance = surface.noise_mm**2 if surface.sigma is None else np.where(surface.valid, surface.sigma, 1.0) ** 2
    raw = cosine**2 * np.minimum(1.0, from_border / FEATHER_PX) ** 2 / np.maximum(variance, 1e-12)
    raw = np.where(grid.usable, raw, 0).astype(np.float32)
    share = cv2.blur(grid.usable.astype(np.float32), (SMOOTH_PX, SMOOTH_PX))
    smooth = cv2.blur(raw, (SMOOTH_PX, SMOOTH_PX)) / np.maximum(share, 1e-6)
    weights: Array = np.where(grid.usable, smooth, 0).reshape(-1)
    return weights


def _own_points(seen: Sequence[_Seen], number: int, intensity: Array, tell: Any) -> tuple[Array, ...]:
    """Return points, normals, intensity, view index and confidence of what one view adds to the model."""
    own = seen[number]
    surface = own.grid.surface
    pixels = np.flatnonzero(own.grid.usable)
    kept, points, normals, sums = [], [], [], []
    for start in range(0, len(pixels), CHUNK):
        tell(f"redundancy of the {surface.name}: {start:,} of {len(pixels):,}")
        chunk = pixels[start : start + CHUNK]
        keep, x, n, total = _fuse(seen, number, chunk)
        kept.append(chunk[keep])
        points.append(x)
        normals.append(n)
        sums.append(total)
    index = np.concatenate(kept)
    (h, w), (top, left) = surface.valid.shape, surface.corner
    grey = intensity[top : top + h, left : left + w].reshape(-1)[index]
    x, n = np.concatenate(points).astype(np.float32), np.concatenate(normals).astype(np.float32)
    confidence = np.concatenate(sums).astype(np.float32)
    return x, n, grey.astype(np.uint8), np.full(len(index), number, np.uint8), confidence


def _fuse(seen: Sequence[_Seen], number: int, pixels: npt.NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
    """Return which pixels are nobody else's to show, and their fused points, normals (model's frame) and weights."""
    own = seen[number]
    x = own.grid.surface.xyz.reshape(-1, 3)[pixels].astype(np.float64)
    n = own.grid.normals.reshape(-1, 3)[pixels].astype(np.float64)
    x, n = apply(own.T_model_centred, x), turned(own.T_model_centred[:3, :3], n)
    w = own.weight[pixels].astype(np.float64)
    keep, total = np.ones(len(pixels), bool), w.copy()
    shift, direction = np.zeros_like(x), w[:, None] * n
    for other_number, other in enumerate(seen):
        if other_number == number:
            continue
        T = inverse(other.T_model_centred)
        foot = feet(other.grid, apply(T, x))
        facing = turned(T[:3, :3].T, other.grid.normals.reshape(-1, 3)[foot.index])
        same = foot.found & (np.abs(foot.residual_mm) < _tolerance(own, other))
        same &= np.einsum("ij,ij->i", facing, n) > SAME_SIDE_COS
        weight = np.where(same, other.weight[foot.index], 0.0)
        keep &= ~(same & ((weight > w) | ((weight == w) & (other_number < number))))
        total += weight
        shift -= (weight * foot.residual_mm)[:, None] * facing
        direction += weight[:, None] * facing
    x, direction = x[keep] + shift[keep] / np.maximum(total[keep], 1e-300)[:, None], direction[keep]
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    return keep, x, np.where(length > 0, direction / np.maximum(length, 1e-300), n[keep]), total[keep]


def _tolerance(a: _Seen, b: _Seen) -> float:
    p, q = a.grid.surface, b.grid.surface
    return max(NOISES * float(np.hypot(p.noise_mm, q.noise_mm)), RESOLUTIONS * max(p.spacing_mm, q.spacing_mm))
