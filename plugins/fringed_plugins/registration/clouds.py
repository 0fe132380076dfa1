"""Points without a grid prepared for registration: cleaned, centred, thinned to levels.

Owns what `surface` owns for range images: extent, resolution, a side that is outside, and levels of evenly spaced
points with normals and boundaries; curvatures too. What a neighbourhood says is in `features.cloud`. Knows nothing of
a second cloud.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fringed_plugins.registration.features.cloud import CloudFeatures, cloud_features, distinct, require_surface
from fringed_plugins.registration.invariant import Curved
from fringed_plugins.registration.surface import MIN_INTERIOR, Level
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
CELLS = 64  # along the diagonal: for the area
WALLS = 1.5  # cells that a surface meets for each cell's face of its area
BASE_POINTS = 6000  # that find which side is out
DENSEST = 60_000  # more points of a level would say no more of a motion, and take their time
NEIGHBOURS = 20


@dataclass(frozen=True)
class CloudSurface:
    """One cleaned cloud: `points` (n, 3) relative to `origin`; `outside` (m, 3) and (m, 3), points and normals.

    `spacing_mm` is the root of the area that a point has, `diagonal_mm` the extent; lengths are in the points' unit.
    `sided` says whether somebody knew the outside, or it was found: then it may be the wrong side of an open surface.
    """

    name: str
    points: FloatArray
    origin: FloatArray
    spacing_mm: float
    diagonal_mm: float
    outside: tuple[FloatArray, FloatArray]
    sided: bool
    threads: int = 1
    _made: dict[int, tuple[FloatArray, CloudFeatures]] = field(default_factory=dict, compare=False, repr=False)

    def level(self, most_points: int) -> Level:
        """Return at most about `most_points`, evenly spaced, with normals and boundaries; computed once.

        Raises
        ------
        ValueError
            too few of them lie inside a surface.
        """
        points, found = self._features(most_points)
        interior = found.valid & ~found.boundary
        if int(interior.sum()) < MIN_INTERIOR:
            raise ValueError(
                f"{int(interior.sum())} of {len(points)} points of the {self.name} lie inside a surface; registration "
                f"needs {MIN_INTERIOR}: they are too scattered or on lines"
            )
        normals = np.where(interior[:, None], found.normals, 0.0)
        sigma = np.full(len(points), found.noise)
        return Level(points, normals, interior, sigma, self._spacing(len(points)), found.slope_noise)

    def curved(self, most_points: int) -> Curved:
        """Return points with principal curvatures, positive where the surface bulges outwards."""
        points, found = self._features(most_points)
        inner = found.valid & ~found.boundary
        near = cKDTree(points).query(points[inner], 7, workers=self.threads)[1]
        rim = (~inner[near]).any(axis=1)
        both = np.stack([found.k1, found.k2], axis=1)[inner]
        return Curved(points[inner], found.normals[inner], both, rim, self._spacing(len(points)))

    def flipped(self) -> CloudSurface:
        """Return the cloud with its other side outside."""
        at, normals = self.outside
        return replace(self, outside=(at, -normals), _made={})

    def _features(self, most_points: int) -> tuple[FloatArray, CloudFeatures]:
        most = min(most_points, DENSEST)
        if most not in self._made:
            points = _thin(self.points, _voxel(self.points, self.spacing_mm, most))[0]
            at, normals = self.outside
            nearest = cKDTree(at).query(points, workers=self.threads)[1]
            seen = points + self.diagonal_mm * normals[nearest]
            self._made[most] = points, cloud_features(points, NEIGHBOURS, seen, self.threads)
        return self._made[most]

    def _spacing(self, count: int) -> float:
        return self.spacing_mm * float(np.sqrt(len(self.points) / count))


def prepare_cloud(
    points: Array,
    normals: Array | None = None,
    viewpoint: Array | None = None,
    name: str = "cloud",
    threads: int = 1,
    tell: Callable[[], None] = lambda: None,
) -> CloudSurface:
    """Return the surface of points without a grid, in any unit.

    Parameters
    ----------
    points
        (n, 3) of floats; rows that are not finite are dropped, coincident ones count once.
    normals
        (n, 3) towards the outside; rows of zeros or NaN are unknown. Only their side counts.
    viewpoint
        (3,) where all points were seen from, in their frame: that side is outside. Without it and without normals the
        side is found: out of the whole, which an open surface may not have.
    name
        what messages call it.
    threads
        of the searches for neighbours.
    tell
        called between the steps; may raise to stop the work.

    Raises
    ------
    ValueError
        wrong shapes; fewer than 200 distinct finite points; all on one line; coincident points.
    """
    given = np.asarray(points)
    if given.ndim != 2 or given.shape[1] != 3 or given.dtype.kind != "f":
        raise ValueError(f"the {name} has shape {given.shape} and type {given.dtype}; expected (n, 3) of floats")
    if normals is not None and np.shape(normals) != given.shape:
        raise ValueError(f"normals of the {name} have shape {np.shape(normals)}; its points have {given.shape}")
    known = np.flatnonzero(np.isfinite(given).all(axis=1))
    exact = given[known].astype(np.float64)
    rows = distinct(exact)[0]
    tell()
    require_surface(given, known, known[rows], name)
    exact = exact[rows]
    origin = np.median(exact[:: max(1, len(exact) // 10_000)], axis=0)
    exact -= origin
    low, high = np.percentile(exact[:: max(1, len(exact) // 100_000)], (1, 99), axis=0)
    diagonal = float(np.linalg.norm(high - low))
    spacing = float(np.sqrt(_area(exact, diagonal) / len(exact)))
    tell()
    directions = None if normals is None else np.asarray(normals, np.float64)[known[rows]]
    seen = None if viewpoint is None else np.asarray(viewpoint, np.float64).reshape(3) - origin
    outside = _outside(exact, directions, seen, spacing, threads)
    tell()
    sided = viewpoint is not None or (normals is not None and bool(np.any(np.nan_to_num(normals))))
    return CloudSurface(name, exact, origin, spacing, diagonal, outside, sided, threads)


def _outside(
    points: FloatArray, normals: FloatArray | None, seen: FloatArray | None, spacing: float, threads: int
) -> tuple[FloatArray, FloatArray]:
    """Return points and unit normals to the outside: given ones, or found."""
    if normals is not None:
        length = np.linalg.norm(normals, axis=1)
        certain = np.isfinite(length) & (length > 0)
        if certain.any():
            return points[certain], normals[certain] / length[certain, None]
    at = _thin(points, _voxel(points, spacing, BASE_POINTS))[0]
    found = cloud_features(at, min(NEIGHBOURS, len(at) - 1), seen, threads)
    kept = (found.normals**2).sum(1) > 0
    return at[kept], found.normals[kept]


def _area(points: FloatArray, diagonal: float) -> float:
    """Return the area of the surface, roughly: of the cells that it meets."""
    cell = diagonal / CELLS
    while True:
        met = _keys(points, cell)[1]
        if met * 4 < len(points) or cell > diagonal / 4:  # cells that hold a point at most say nothing of the area
            return met * cell**2 / WALLS
        cell *= 2


def _voxel(points: FloatArray, spacing: float, most: int) -> float:
    """Return the side of voxels that leave about `most` points; 0 where there are no more."""
    if len(points) <= most:
        return 0.0
    voxel = spacing * float(np.sqrt(WALLS * len(points) / most))
    for _ in range(3):
        count = _keys(points, voxel)[1]
        if 0.9 * most <= count <= 1.1 * most:
            break
        voxel *= float(np.sqrt(count / most))
    return voxel


def _keys(points: FloatArray, voxel: float) -> tuple[npt.NDArray[np.int64], int]:
    """Return each point's voxel as a number, and how many different ones there are."""
    cell = np.floor((points - points.min(axis=0)) / voxel).astype(np.int64)
    size = cell.max(axis=0) + 1
    keys: npt.NDArray[np.int64] = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    ordered = np.sort(keys)
    return keys, 1 + int((ordered[1:] != ordered[:-1]).sum())


def _thin(points: FloatArray, voxel: float) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return the mean of each voxel's points, and how many points it is."""
    if not voxel > 0:
        return points, np.ones(len(points), np.int64)
    keys, _ = _keys(points, voxel)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    count = np.diff(np.append(first, len(points)))
    mean: FloatArray = np.add.reduceat(points[order], first, axis=0) / count[:, None]
    return mean, count
