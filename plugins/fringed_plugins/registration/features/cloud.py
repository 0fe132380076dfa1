"""Normals, principal curvatures, boundaries and noise of points without a grid, and a level made of them.

Owns neighbourhoods and what a quadric through each says. Which side of the surface is out is in `orienting`. Knows
nothing of a second cloud.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.special import gammaincinv

from fringed_plugins.registration.features.cloud_kernel import fit
from fringed_plugins.registration.features.grid import in_units_of_noise
from fringed_plugins.registration.features.grouping import distinct
from fringed_plugins.registration.features.orienting import consistent, towards
from fringed_plugins.registration.normals import BoolArray
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import MIN_INTERIOR, MIN_POINTS, Level
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
Index = npt.NDArray[np.intp]
LEAST_NEIGHBOURS, MOST_NEIGHBOURS = 8, 200
GAP_DEG = 120.0  # without any neighbour: a boundary. Of 20 random neighbours 1 % leave as much, an edge leaves 180
COLLINEAR = 1e-4  # of the length: a narrower cloud is a line
_CHUNK = 8_000


@dataclass(frozen=True)
class CloudFeatures:
    """What the neighbourhood of each of n points says; rows are those of the points given.

    `k1` >= `k2` (n,) in 1 / unit of length, positive where the surface bulges to where its unit `normals` (n, 3)
    point; `sigma_k1`, `sigma_k2` (n,) their standard deviations from `noise`. Where not `valid` (boundaries, too few
    directions, not finite) curvatures are NaN; normals are zero where there is no tangent plane. `boundary` (n,).

    `resolution` is the median distance of nearest neighbours, `noise` the standard deviation of a point along its
    normal that quadrics leave, `slope_noise` that of a normal in radians.
    """

    k1: FloatArray
    k2: FloatArray
    normals: FloatArray
    valid: BoolArray
    boundary: BoolArray
    sigma_k1: FloatArray
    sigma_k2: FloatArray
    resolution: float
    noise: float
    slope_noise: float

    def normalised(self) -> FloatArray:
        """Return (n, 2) k1 and k2 in units of their typical noise: see `grid.in_units_of_noise`."""
        both, noise = np.stack([self.k1, self.k2], axis=1), np.stack([self.sigma_k1, self.sigma_k2], axis=1)
        return in_units_of_noise(both, noise, self.valid)


def cloud_features(
    points: Array,
    neighbours: int = 20,
    viewpoint: Array | None = None,
    threads: int = 1,
    *,
    sigma: float | None = None,
    report: Report = silent,
) -> CloudFeatures:
    """Return normals, curvatures and boundaries of unorganised points; coincident ones count once.

    A quadric by least squares (a jet of degree 2) in a tangent frame by principal components.

    Parameters
    ----------
    points
        (n, 3) in any unit; rows that are not finite are not valid.
    neighbours
        how many nearest points beside a point itself, 8 to 200.
    viewpoint
        (3,) or (n, 3), where normals point; None: they agree along a spanning tree, and point out.
    threads
        of the search for neighbours.
    sigma
        standard deviation of a point along the normal in the points' unit; estimated when left out.
    report
        called every 0.2 s with how much is done, a little later from a million points on; may raise.

    Raises
    ------
    ValueError
        wrong shapes or numbers, or no more distinct points than neighbours.

    References
    ----------
    Cazals & Pouget, CAGD 22, 2005; Hoppe et al., SIGGRAPH 1992.

    Examples
    --------
    >>> x, y = (a.ravel() * 0.1 for a in np.mgrid[-10:11.0, -10:11.0])
    >>> bowl = cloud_features(np.stack([x, y, 0.5 * (x**2 + y**2)], axis=1), viewpoint=np.array([0, 0, 9.0]))
    >>> bowl.k1[220].round(3), bowl.normals[220].round(3) + 0.0, int(bowl.boundary.sum())
    (np.float64(-1.0), array([0., 0., 1.]), 80)
    """
    given = _checked(points, neighbours, sigma)
    known = np.asarray(np.isfinite(given).all(axis=1), np.bool_)
    keep, group = distinct(given[known])
    rows = np.flatnonzero(known)[keep]
    if len(rows) <= neighbours:
        raise ValueError(f"{len(rows)} distinct finite points; {neighbours} neighbours need {neighbours + 1} at least")
    kept = np.ascontiguousarray(given[rows])
    seen = None if viewpoint is None else _viewpoints(viewpoint, len(given), rows)
    out, near, resolution = _fitted(kept, neighbours, threads, report)
    if seen is not None:
        sign = towards(kept, out[:, 2:5], seen)
    else:
        sign = consistent(kept, out[:, 2:5], near, lambda done, text: report(0.7 + 0.3 * done, text))
    found = _features(out, sign, neighbours + 1, (resolution, sigma, _rounding(points, kept)))
    report(1.0, "features of the cloud")
    return found if len(rows) == len(given) else _spread_out(found, known, group)


def cloud_level(points: Array, normals: Array | None = None, viewpoint: Array | None = None, threads: int = 1) -> Level:
    """Return unorganised points as a level for registration; interior are those that are no boundary.

    Parameters
    ----------
    points
        (n, 3) in any unit; rows that are not finite are dropped, coincident ones counted once.
    normals
        (n, 3) of any length; zero or not finite is unknown. Found from the points when left out.
    viewpoint
        (3,) or (n, 3) where points were seen from, as in `cloud_features`; turns given normals too.
    threads
        of the search for neighbours.

    Raises
    ------
    ValueError
        wrong shapes; fewer than 200 distinct finite points; all on one line; fewer than 60 inside.
    """
    given = _checked(points, LEAST_NEIGHBOURS, None)
    known = np.flatnonzero(np.isfinite(given).all(axis=1))
    rows = known[distinct(given[known])[0]]
    require_surface(given, known, rows)
    kept = given[rows]
    seen = None if viewpoint is None else _viewpoints(viewpoint, len(given), rows)
    found = cloud_features(kept.astype(np.asarray(points).dtype), viewpoint=seen, threads=threads)
    directions, interior = found.normals.copy(), ~found.boundary & found.valid
    if normals is not None:
        directions, certain = _unit(normals, len(given), rows)
        interior = ~found.boundary & certain
        if seen is not None:
            directions *= towards(kept, directions, seen)[:, None]
    directions[~interior] = 0
    if int(interior.sum()) < MIN_INTERIOR:
        raise ValueError(
            f"{int(interior.sum())} of {len(kept)} points lie inside a surface; registration needs {MIN_INTERIOR}: "
            "they are too scattered or on lines"
        )
    return Level(kept, directions, interior, np.full(len(kept), found.noise), found.resolution, found.slope_noise)


def _checked(points: Array, neighbours: int, sigma: float | None) -> FloatArray:
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        raise ValueError(f"points of shape {points.shape} and type {points.dtype}; expected (n, 3) of floats")
    if not LEAST_NEIGHBOURS <= neighbours <= MOST_NEIGHBOURS:
        raise ValueError(f"{neighbours} neighbours; expected {LEAST_NEIGHBOURS} to {MOST_NEIGHBOURS}")
    if sigma is not None and not (np.isfinite(sigma) and sigma >= 0):
        raise ValueError(f"sigma is {sigma}; expected a standard deviation, zero or more")
    return points.astype(np.float64)


def _viewpoints(viewpoint: Array, count: int, rows: Index) -> FloatArray:
    """Return where the points `rows` (m,) of `count` were seen from, (m, 3)."""
    given = np.asarray(viewpoint, np.float64)
    if given.shape not in ((3,), (count, 3)):
        raise ValueError(f"the viewpoint has shape {given.shape}; expected (3,) or ({count}, 3)")
    seen: FloatArray = np.broadcast_to(given, (count, 3))[rows]
    if not np.isfinite(seen).all():
        raise ValueError("the viewpoint is not finite where points are; expected finite numbers, or None")
    return seen


def _fitted(points: FloatArray, neighbours: int, threads: int, report: Report) -> tuple[FloatArray, Index, float]:
    """Return what `fit` says of each point (n, 10), the neighbours (n, k), and the resolution."""
    report(0.0, "a search tree of the cloud")
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    out, near = np.empty((len(points), 10)), np.empty((len(points), neighbours + 1), np.intp)
    nearest = np.empty(len(points))
    for first in range(0, len(points), _CHUNK):
        report(0.1 + 0.6 * first / len(points), "neighbourhoods of the cloud")
        part = tree.indices[first : first + _CHUNK]  # near each other: the cache holds their part of the tree
        distance, around = tree.query(points[part], neighbours + 1, workers=threads)
        made = np.empty((len(part), 10))
        fit(points, around, made)
        out[part], near[part], nearest[part] = made, around, distance[:, 1]
    return out, near, float(np.median(nearest))


def _rounding(points: Array, distinct: FloatArray) -> float:
    """Return the standard deviation of the rounding of the points' type."""
    return float(np.finfo(np.asarray(points).dtype).eps * np.abs(distinct).max() / np.sqrt(12.0))


def _features(out: FloatArray, sign: FloatArray, count: int, known: tuple[float, float | None, float]) -> CloudFeatures:
    """Return the features of fits to `count` points each; `known` are resolution, noise if given, and rounding."""
    resolution, sigma, rounding = known
    boundary = ~(out[:, 9] < np.radians(GAP_DEG))
    valid = np.isfinite(out[:, 0]) & ~boundary
    slope = float(np.median(out[valid, 8])) if valid.any() else np.nan
    if sigma is None:
        freedom = 0.5 * (count - 6)
        left = float(np.median(out[valid, 5])) if valid.any() else np.nan
        sigma = max(left / float(np.sqrt(gammaincinv(freedom, 0.5) / freedom)), rounding)  # the median of chi^2
    turned = sign < 0
    k1, k2 = np.where(turned, -out[:, 1], out[:, 0]), np.where(turned, -out[:, 0], out[:, 1])
    s1, s2 = np.where(turned, out[:, 7], out[:, 6]), np.where(turned, out[:, 6], out[:, 7])
    for array in (k1, k2, s1, s2):
        array[~valid] = np.nan
    normals = np.nan_to_num(out[:, 2:5]) * sign[:, None]
    return CloudFeatures(k1, k2, normals, valid, boundary, sigma * s1, sigma * s2, resolution, sigma, sigma * slope)


def _spread_out(found: CloudFeatures, known: BoolArray, group: Index) -> CloudFeatures:
    """Return the features of all points given, of those of the distinct ones."""

    def rows(array: Array, otherwise: float) -> Array:
        out = np.full((len(known), *array.shape[1:]), otherwise, array.dtype)
        out[known] = array[group]
        return out

    return CloudFeatures(
        rows(found.k1, np.nan), rows(found.k2, np.nan), rows(found.normals, 0), rows(found.valid, False),
        rows(found.boundary, False), rows(found.sigma_k1, np.nan), rows(found.sigma_k2, np.nan),
        found.resolution, found.noise, found.slope_noise,
    )  # fmt: skip


def require_surface(given: Array, known: Index, rows: Index, name: str = "cloud") -> None:
    """Raise ValueError where too few of the points are finite (`known`) and distinct (`rows`), or all on a line."""
    if len(rows) < MIN_POINTS:
        raise ValueError(
            f"the {name} has {len(given)} points, {len(known)} of them finite and {len(rows)} distinct; registration "
            f"needs {MIN_POINTS}"
        )
    off = given[rows].astype(np.float64)
    off -= off.mean(axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(off.T @ off), 0.0))
    if not spread[1] > COLLINEAR * spread[2]:
        raise ValueError(f"the points of the {name} lie on one line; a registration needs a surface")


def _unit(normals: Array, count: int, rows: Index) -> tuple[FloatArray, BoolArray]:
    """Return the given normals of `rows` with unit length, and where there are any."""
    given = np.asarray(normals, np.float64)
    if given.shape != (count, 3):
        raise ValueError(f"normals have shape {given.shape}; the points have ({count}, 3)")
    length = np.linalg.norm(given[rows], axis=1)
    certain = np.isfinite(length) & (length > 0)
    return np.where(certain[:, None], given[rows], 0.0) / np.where(certain, length, 1.0)[:, None], certain
