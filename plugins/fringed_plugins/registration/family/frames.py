"""A frame as the classical methods take it: points with what is known of each, and its resolution.

Owns what a policy may ask for. A frame of a range image has normals, principal curvatures and boundaries where the
whole window is valid; a frame of bare points has what the caller gives. Knows nothing of a second frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fringed_plugins.registration.clouds import CloudSurface
from fringed_plugins.registration.footpoints import fit_projection
from fringed_plugins.registration.invariant import principal
from fringed_plugins.registration.normals import BoolArray, complete, healed
from fringed_plugins.registration.patches import Array, curvature_noise, table_of
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray

Index = npt.NDArray[np.intp]
WINDOWS_PX = (7, 11, 15, 21)
NEIGHBOURS = (20, 50, 110, 200)
NEAR = 7  # points, itself included: those around one
LEAST_WHOLE = 200
BESIDE = 7  # points around one and itself, where there is no grid
CERTAIN = 1 / 6  # noise of a curvature in units of its spread: more would say nothing of who belongs to whom
FEATURE_FLOOR = 0.02  # of the features' spread: no curvature repeats better between two samplings


@dataclass(frozen=True)
class Frame:
    """Points (n, 3) relative to `origin`, normals (n, 3) zero where unknown, `whole` (n,) where features hold.

    `features` (n, m) are invariants in units of their noise; `boundary` (n,) is the rim of what is valid,
    `rim` that of what is whole. `sigma` (n,) is the standard deviation along the sensor's ray, `rays` (n, 3).
    `pixel` (height, width) has each pixel's point or -1 and `projection` (3, 4) takes points to (column, row, 1),
    where the frame is a grid.
    """

    points: FloatArray
    normals: FloatArray
    features: FloatArray
    whole: BoolArray
    boundary: BoolArray
    rim: BoolArray
    sigma: FloatArray
    rays: FloatArray
    resolution: float
    origin: FloatArray
    pixel: Index | None = None
    projection: FloatArray | None = None
    name: str = "frame"

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def tree(self) -> cKDTree:
        """The search tree over all points."""
        return cKDTree(self.points, balanced_tree=False, compact_nodes=False)

    @cached_property
    def extent(self) -> float:
        """The root mean square distance of the points from their mean."""
        return float(np.sqrt(((self.points - self.points.mean(0)) ** 2).sum(1).mean()))

    def with_features(self, features: FloatArray, whole: BoolArray | None = None) -> Frame:
        """Return the frame with other invariants, such as `features.invariants` gives; `rim` follows `whole`.

        Raises
        ------
        ValueError
            not one row for each point, or NaN where they are said to hold.
        """
        whole = self.whole if whole is None else whole
        if features.ndim != 2 or len(features) != len(self) or not np.isfinite(features[whole]).all():
            raise ValueError(f"features of shape {features.shape} for {len(self)} points; expected (n, m), finite")
        rim = self.rim if whole is self.whole else self._rim_of(whole)
        return replace(self, features=np.where(whole[:, None], features, 0.0), whole=whole, rim=rim)

    def _rim_of(self, whole: BoolArray) -> BoolArray:
        """Return which points (n,) are not whole, or have one beside them that is not or is missing."""
        if self.pixel is None:
            beside: Index = self.tree.query(self.points, range(1, min(BESIDE, len(self)) + 1))[1]
            apart: BoolArray = self.boundary | ~whole[beside].all(axis=1)
            return apart
        grid = self.pixel >= 0
        inner = np.empty(len(self), np.bool_)
        inner[self.pixel[grid]] = complete(grid & whole[self.pixel], 3)[grid]
        return ~inner


def frame_of(surface: Surface, most_points: int | None = None, window_px: int | None = None) -> Frame:
    """Return the frame of a range image, of block means where it has more than `most_points`.

    Features are the principal curvatures (k1, k2), valid on whole windows only, divided by their noise (Sharp, Lee,
    Wehe 2002), which is that of the points or a small part of the curvatures' spread, whichever is more. Without a
    `window_px` the smallest of 7, 11, 15 and 21 is taken in which noise is less than a sixth of the spread.

    Raises
    ------
    ValueError
        no window is complete anywhere.
    """
    thin = surface if most_points is None else surface.thinned(most_points)
    xyz, filled = healed(thin.xyz, thin.valid)
    valid = thin.valid
    sigma = np.full(int(valid.sum()), thin.noise_mm) if thin.sigma is None else thin.sigma[valid].astype(np.float64)
    usable, patch, features = _curvatures(xyz, filled, valid, float(np.median(sigma)), window_px)
    whole = usable[valid]
    if not whole.any():
        raise ValueError(f"the {surface.name} has no complete window of {window_px or WINDOWS_PX[0]} pixels: too torn")
    points = thin.xyz[valid].astype(np.float64)
    pixel = np.full(valid.shape, -1, np.intp)
    pixel[valid] = np.arange(len(points))
    rays = points + surface.origin
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    boundary, rim = ~complete(valid, 3)[valid], ~complete(usable, 3)[valid]
    return Frame(
        points, patch[:, 9:12], features, whole, boundary, rim, sigma, rays, thin.spacing_mm, surface.origin, pixel,
        fit_projection(thin), surface.name,
    )  # fmt: skip


def frame_of_cloud(cloud: CloudSurface, most_points: int | None = None) -> Frame:
    """Return the frame of points without a grid: features as `frame_of` has them, boundaries by gaps, rays unknown.

    Curvatures are of the least neighbourhood in which their noise is less than a sixth of their spread.
    Where nobody knows where a point was seen from, its ray is its normal: `sigma` is that along the normal.
    """
    for count in NEIGHBOURS:
        points, found = cloud.features(most_points or len(cloud.points), count)
        whole = found.valid & ~found.boundary
        both = np.stack([found.k1, found.k2], axis=1)[whole]
        noise = np.median(np.stack([found.sigma_k1, found.sigma_k2], axis=1)[whole], axis=0)
        if (noise < CERTAIN * _spread(both)).all():
            break
    features = np.zeros((len(points), 2))
    features[whole] = both / np.maximum(noise, FEATURE_FLOOR * _spread(both))
    near = cKDTree(points).query(points, NEAR, workers=cloud.threads)[1]
    rim = (~whole[near]).any(axis=1)
    spacing = cloud.level(len(points)).spacing_mm
    return Frame(
        points, found.normals, features, whole, found.boundary, rim, np.full(len(points), found.noise), found.normals,
        spacing, cloud.origin, name=cloud.name,
    )  # fmt: skip


def _curvatures(
    xyz: Array, filled: BoolArray, valid: BoolArray, noise: float, window_px: int | None
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Return where windows are whole (height, width), patches (n, 15) and features (n, 2) of valid points."""
    kept: tuple[BoolArray, FloatArray, FloatArray] | None = None
    for window in (window_px,) if window_px else WINDOWS_PX:
        usable = complete(filled, window) & valid
        if int(usable.sum()) < LEAST_WHOLE and kept is not None:
            break
        table = table_of(xyz, usable, window)
        whole = usable[valid]
        patch = np.where(whole[:, None], table[valid], 0.0).astype(np.float64)
        features = np.zeros((len(whole), 2))
        if whole.any():
            features[whole] = principal(patch[whole])
            of_noise, spread = curvature_noise(patch[whole], noise, window), _spread(features[whole])
            features[whole] /= np.maximum(of_noise, FEATURE_FLOOR * spread)
            kept = usable, patch, features
            if float(np.median(of_noise / spread)) < CERTAIN:
                break
        kept = kept or (usable, patch, features)
    assert kept is not None  # there is a window at least
    return kept


def _spread(features: FloatArray) -> FloatArray:
    low, high = np.percentile(features, (10, 90), axis=0)
    spread: FloatArray = np.maximum(high - low, 1e-12)
    return spread
