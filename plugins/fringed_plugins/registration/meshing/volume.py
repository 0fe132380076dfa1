"""Signed distances of all views, fused in sparse blocks: the mean of what the views say, by their weights.

Owns the voxel's size, truncation, weights and memory. Knows nothing of triangles.

References
----------
Curless & Levoy 1996; distances to smooth patches along their normals in place of those along the ray.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fringed_plugins.parallel import run_rows
from fringed_plugins.registration.meshing.blocks import blocks_of, touched
from fringed_plugins.registration.meshing.distances import SIDE, fuse
from fringed_plugins.registration.patches import Patches, patches
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.surface import MOST_PATCHES, Surface
from fringed_plugins.registration.transforms import FloatArray, apply, inverse, translation

Array = npt.NDArray[Any]
FEATHER_PX = 12.0
MOST_BLOCKS = 200_000  # 10 kB each where they are made, 2 GB in all
CHUNK = 300  # blocks between two reports
TRUNCATION = 3.0  # voxels
NOISES = 4.0
LEAST_VOXEL = 0.25  # of the resolution: finer ones lie between the points
LEAST_COSINE = 0.1


@dataclass(frozen=True)
class Seen:
    """One view ready for fusion: patches, `weights` (h, w) in 1 / length^2, and T (4, 4) from its origin to the model.

    `corner` is the range image's pixel (row, column) of the first patch, `step` how many of its pixels one is wide.
    """

    patches: Patches
    weights: Array
    T_model_centred: FloatArray
    corner: tuple[int, int]
    step: int

    def into(self, origin: FloatArray) -> FloatArray:
        """Return motion and projection (7, 4) for places relative to `origin` (3,) in the model's frame."""
        return np.vstack([inverse(self.T_model_centred) @ translation(origin), self.patches.projection])


@dataclass(frozen=True)
class Volume:
    """Fused blocks: sorted `keys` (b,), `values` (b, 512) float32, NaN where unknown, within +-`truncation`.

    Voxel (i, j, k) of a block is at `origin` + `voxel` x (SIDE x block + (i, j, k)). `free` (b, 512) is not zero
    where a view looks through.
    """

    keys: Array
    values: Array
    free: Array
    origin: FloatArray
    voxel: float
    truncation: float


def see(surface: Surface, T_model_view: FloatArray, window_px: int | None = None) -> Seen:
    """Return a view with its weights: low where noise is high, the surface turns away, or the border is near.

    `window_px` is the side of the patches' windows; None takes the largest that the surface is smooth over.

    Raises
    ------
    ValueError
        no window is complete anywhere.
    """
    chosen = surface.patches if window_px is None else patches(surface.thinned(MOST_PATCHES), window_px)
    thin, at = chosen.surface, np.nonzero(chosen.usable)
    table = chosen.table[at]
    ray = table[:, :3] + thin.origin
    length = np.sqrt(np.einsum("ij,ij->i", ray, ray))
    cosine = np.abs(np.einsum("ij,ij->i", ray, table[:, 9:12])) / np.maximum(length, 1e-30)
    inside = np.pad(chosen.usable, 1).astype(np.uint8)
    border = np.minimum(1.0, cv2.distanceTransform(inside, cv2.DIST_L2, 3)[1:-1, 1:-1][at] / FEATHER_PX)
    # noise is along the ray: sigma x cosine along the normal; but what turns away is seen badly all the same
    sigma: Any = thin.noise_mm if thin.sigma is None else thin.sigma[at].astype(np.float64)
    sigma = np.maximum(sigma, 1e-4 * thin.spacing_mm)
    weights = np.zeros(chosen.usable.shape, np.float32)
    weights[at] = (np.maximum(cosine, LEAST_COSINE) * border / sigma) ** 2 / chosen.gain
    step = round(thin.spacing_mm / surface.spacing_mm)
    return Seen(chosen, weights, T_model_view @ translation(surface.origin), surface.corner, step)


def points_of(seen: Seen) -> Array:
    """Return the view's smoothed points (n, 3) in the model's frame."""
    return apply(seen.T_model_centred, seen.patches.table[seen.weights > 0][:, :3].astype(np.float64))


def voxel_of(views: Sequence[Seen], voxel: float | None) -> float:
    """Return the voxel's size: the views' median resolution where none is asked for.

    Raises
    ------
    ValueError
        a size that is no length, or finer than the points are.
    """
    resolution = float(np.median([seen.patches.surface.spacing_mm for seen in views]))
    if voxel is None:
        return resolution
    if not (np.isfinite(voxel) and voxel >= LEAST_VOXEL * resolution):
        raise ValueError(
            f"a voxel of {voxel:g}; the points are {resolution:.3g} apart: expected at least a quarter of that, "
            f"{LEAST_VOXEL * resolution:.3g}, in the same unit"
        )
    return float(voxel)


def truncation_of(views: Sequence[Seen], voxel: float) -> float:
    """Return the half width of the band of distances: voxels, noise and gaps between points fit in."""
    noise = max(seen.patches.surface.noise_mm for seen in views)
    resolution = max(seen.patches.surface.spacing_mm for seen in views)
    return float(min(max(TRUNCATION * voxel, NOISES * noise, 1.5 * resolution), 0.9 * SIDE * voxel))


def surround(views: Sequence[Seen], origin: FloatArray, voxel: float, truncation: float, report: Report) -> Array:
    """Return the sorted keys of the blocks that any view's surface passes.

    Raises
    ------
    ValueError
        more than MOST_BLOCKS of them, with the voxel that fits.
    """
    keys = np.zeros(0, np.int64)
    for number, seen in enumerate(views):
        report(0.1, f"blocks of the {seen.patches.surface.name}")
        points = points_of(seen) - origin
        extent = float(np.abs(points).max())
        if extent > SIDE * voxel * (1 << 17):
            raise ValueError(f"a voxel of {voxel:g} for an extent of {extent:.3g}: too fine by far; make it larger")
        keys = np.union1d(keys, touched(points, voxel, truncation))
        if len(keys) > MOST_BLOCKS:
            share = (number + 1) / len(views)
            fits = voxel * float(np.sqrt(len(keys) / share / MOST_BLOCKS))
            raise ValueError(
                f"a voxel of {voxel:.3g} needs more than {MOST_BLOCKS:,} blocks of {SIDE} x {SIDE} x {SIDE} voxels "
                f"(2 GB); one of {fits:.2g} fits"
            )
    return keys


def fused(
    views: Sequence[Seen],
    keys: Array,
    place: tuple[FloatArray, float, float],
    report: Report,
    threads: int = 1,
) -> Volume:
    """Return the volume of all views in the blocks of `keys`; `place` is origin, voxel and truncation."""
    origin, voxel, truncation = place
    corners = blocks_of(keys) * (SIDE * voxel)
    n = SIDE**3
    sums, totals = np.zeros((len(keys), n), np.float32), np.zeros((len(keys), n), np.float32)
    free = np.zeros((len(keys), n), np.uint8)
    for number, seen in enumerate(views):
        surface = seen.patches.surface
        margin = 2 * SIDE * voxel / surface.spacing_mm + 2
        view = seen.into(origin), seen.patches.table, seen.weights
        for start in range(0, len(keys), CHUNK):
            report((number + start / len(keys)) / len(views), f"distances to the {surface.name}")
            part = slice(start, start + CHUNK)
            parts, sizes = (sums[part], totals[part], free[part]), (voxel, truncation, margin)
            run_rows(fuse, len(parts[0]), corners[part], sizes, view, parts, threads=threads)
    values = np.full(sums.shape, np.nan, np.float32)
    np.divide(sums, totals, out=values, where=totals > 0)
    return Volume(keys, values, free, origin, voxel, truncation)
