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

from fringed_plugins.registration.features.cloud import CloudFeatures, cloud_features, require_surface
from fringed_plugins.registration.features.grouping import Counts, distinct, means, voxels
from fringed_plugins.registration.invariant import Curved
from fringed_plugins.registration.surface import MIN_INTERIOR, Level, Surface
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
Tell = Callable[[], None]
CELLS = 64  # along the diagonal: for the area
WALLS = 1.5  # cells that a surface meets for each cell's face of its area
BASE_POINTS = 6000  # that find which side is out
DENSEST = 60_000  # points; means of more of them are as good
MOST_GIVEN = 100_000  # normals
NEIGHBOURS = 20
NEAR = 7  # points, itself included: those around one


def _silent() -> None:
    pass


@dataclass(frozen=True)
class CloudSurface:
    """One cleaned cloud: `points` (n, 3) relative to `origin`, each the mean of `counts` (n,) given ones.

    `outside` is (m, 3) and (m, 3), points and unit normals; `sided` says whether somebody knew that side, or it was
    found: then it may be the wrong one of an open surface. `spacing_mm` is the root of the area that a point has,
    `diagonal_mm` the extent; lengths are in the points' unit. `tell` hears of every step and may raise to stop it.
    """

    name: str
    points: FloatArray
    counts: Counts
    origin: FloatArray
    spacing_mm: float
    diagonal_mm: float
    outside: tuple[FloatArray, FloatArray]
    sided: bool
    threads: int = 1
    tell: Tell = field(default=_silent, compare=False, repr=False)
    _made: dict[tuple[int, int], tuple[FloatArray, CloudFeatures]] = field(
        default_factory=dict, compare=False, repr=False
    )
    _levels: dict[int, Level] = field(default_factory=dict, compare=False, repr=False)

    def level(self, most_points: int) -> Level:
        """Return at most about `most_points`, evenly spaced, with normals and boundaries; computed once.

        Raises
        ------
        ValueError
            too few of them lie inside a surface.
        """
        if most_points not in self._levels:
            self._levels[most_points] = self._level(most_points)
        return self._levels[most_points]

    def _level(self, most_points: int) -> Level:
        points, found = self.features(most_points)
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
        points, found = self.features(most_points)
        inner = found.valid & ~found.boundary
        near = cKDTree(points).query(points[inner], NEAR, workers=self.threads)[1]
        rim = (~inner[near]).any(axis=1)
        both = np.stack([found.k1, found.k2], axis=1)[inner]
        return Curved(points[inner], found.normals[inner], both, rim, self._spacing(len(points)))

    def flipped(self) -> CloudSurface:
        """Return the cloud with its other side outside."""
        at, normals = self.outside
        return replace(self, outside=(at, -normals), _made={}, _levels={})

    def features(self, most_points: int, neighbours: int = NEIGHBOURS) -> tuple[FloatArray, CloudFeatures]:
        """Return at most about `most_points` and what their neighbourhoods say; computed once."""
        most = min(most_points, len(self.points))
        if (most, neighbours) not in self._made:
            voxel = _voxel(self.points, self.spacing_mm, most, self.tell)
            points, _ = _thin(self.points, self.counts, voxel)
            at, normals = self.outside
            nearest = cKDTree(at).query(points, workers=self.threads)[1]
            seen = points + self.diagonal_mm * normals[nearest]
            found = cloud_features(points, neighbours, seen, self.threads, report=lambda *_: self.tell())
            self._made[most, neighbours] = points, found
        return self._made[most, neighbours]

    def _spacing(self, count: int) -> float:
        return self.spacing_mm * float(np.sqrt(len(self.points) / count))


def prepare_cloud(
    points: Array,
    normals: Array | None = None,
    viewpoint: Array | None = None,
    name: str = "cloud",
    threads: int = 1,
    tell: Tell = _silent,
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
        called between the steps, those of later work on the cloud too; may raise to stop it.

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
    tell()
    exact = exact[rows]
    origin = np.median(exact[:: max(1, len(exact) // 10_000)], axis=0)
    exact -= origin
    low, high = np.percentile(exact[:: max(1, len(exact) // 100_000)], (1, 99), axis=0)
    diagonal = float(np.linalg.norm(high - low))
    spacing = float(np.sqrt(_area(exact, diagonal, tell) / len(exact)))
    dense, counts = _thin(exact, np.ones(len(exact), np.int64), _voxel(exact, spacing, DENSEST, tell))
    tell()
    directions = None if normals is None else np.asarray(normals, np.float64)[known[rows]]
    seen = None if viewpoint is None else np.asarray(viewpoint, np.float64).reshape(3) - origin
    outside = _given(exact, directions)
    sided = outside is not None or viewpoint is not None
    if outside is None:
        base, _ = _thin(dense, counts, _voxel(dense, spacing * np.sqrt(len(exact) / len(dense)), BASE_POINTS, tell))
        tell()
        found = cloud_features(base, min(NEIGHBOURS, len(base) - 1), seen, threads, report=lambda *_: tell())
        kept = (found.normals**2).sum(1) > 0
        outside = base[kept], found.normals[kept]
    tell()
    spacing *= float(np.sqrt(len(exact) / len(dense)))
    return CloudSurface(name, dense, counts, origin, spacing, diagonal, outside, sided, threads, tell)


def without_grid(surface: Surface, threads: int = 1) -> CloudSurface:
    """Return a range image's points as a cloud, seen from its frame's origin."""
    points = surface.xyz[surface.valid].astype(np.float64) + surface.origin
    cloud = prepare_cloud(points, viewpoint=np.zeros(3), name=surface.name, threads=threads)
    off = cloud.origin - surface.origin
    at, normals = cloud.outside
    return replace(
        cloud, points=cloud.points + off, origin=surface.origin, outside=(at + off, normals), _made={}, _levels={}
    )


def _given(points: FloatArray, normals: FloatArray | None) -> tuple[FloatArray, FloatArray] | None:
    """Return some points and their unit normals, where any are known."""
    if normals is None:
        return None
    some = slice(None, None, max(1, len(points) // MOST_GIVEN))
    points, normals = points[some], normals[some]
    length = np.linalg.norm(normals, axis=1)
    certain = np.isfinite(length) & (length > 0)
    return (points[certain], normals[certain] / length[certain, None]) if certain.any() else None


def _area(points: FloatArray, diagonal: float, tell: Tell) -> float:
    """Return the area of the surface, roughly: of the cells that it meets."""
    cell = diagonal / CELLS
    while True:
        tell()
        met = voxels(points, cell)[1]
        if met * 4 < len(points) or cell > diagonal / 4:  # cells that hold a point at most say nothing of the area
            return met * cell**2 / WALLS
        cell *= 2


def _voxel(points: FloatArray, spacing: float, most: int, tell: Tell) -> float:
    """Return the side of voxels that leave about `most` points; 0 where there are no more."""
    if len(points) <= most:
        return 0.0
    voxel = spacing * float(np.sqrt(WALLS * len(points) / most))
    for _ in range(3):
        tell()
        count = voxels(points, voxel)[1]
        if 0.9 * most <= count <= 1.1 * most:
            break
        voxel *= float(np.sqrt(count / most))
    return voxel


def _thin(points: FloatArray, counts: Counts, voxel: float) -> tuple[FloatArray, Counts]:
    """Return the mean of each voxel's points, weighted by their counts, and the sums of these."""
    return means(points, counts, *voxels(points, voxel)) if voxel > 0 else (points, counts)
