"""A range image prepared for registration: cleaned, centred, decimated to levels.

Owns validity, depth jumps, resolution and noise of one view, and its levels: block means of the grid
with normals, boundaries and the standard deviation along the normal. Knows nothing of a second view.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fringed_plugins.registration.normals import BoolArray, complete, healed, normals
from fringed_plugins.registration.surface_kernels import centre, finite
from fringed_plugins.registration.transforms import FloatArray

if TYPE_CHECKING:
    from fringed_plugins.registration.patches import Patches

Array = npt.NDArray[Any]
MOST_PATCHES = 600_000
LEAST_COSINE = 0.2  # between ray and normal: points without a camera have rays of no meaning
MIN_POINTS = 200
MIN_INTERIOR = 60
JUMP = 8.0  # neighbours farther apart than this many resolutions are not one surface (82 degrees of slope)
FILLED = 0.6  # part of a block that has to be valid
SPREAD = 1.2  # greatest standard deviation of a block in units of its side: more is two surfaces
LEVEL_WINDOW_PX = 5
NO_RESOLUTION = "the points have no extent between neighbours: all of them coincide"


@dataclass(frozen=True)
class Level:
    """Points of one decimation, relative to the surface's `origin`.

    `points` (n, 3), `normals` (n, 3) zero where not `interior`, `sigma_mm` (n,) along the normal.
    """

    points: FloatArray
    normals: FloatArray
    interior: BoolArray
    sigma_mm: FloatArray
    spacing_mm: float
    slope_noise: float

    @cached_property
    def tree(self) -> cKDTree:
        """The search tree over all points, boundary included."""
        return cKDTree(self.points, balanced_tree=False, compact_nodes=False)

    def inner(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return points, normals and sigma of the interior."""
        return self.points[self.interior], self.normals[self.interior], self.sigma_mm[self.interior]


@dataclass(frozen=True)
class Surface:
    """One cleaned view: `xyz` (height, width, 3) float32 relative to `origin`, zero where not `valid`.

    Rows and columns are cropped to what is valid, from `corner` (row, column) of the range image on.
    `sigma` (height, width) or None is the given standard deviation along the ray.
    """

    name: str
    xyz: Array
    valid: BoolArray
    sigma: Array | None
    origin: FloatArray
    corner: tuple[int, int]
    spacing_mm: float
    noise_mm: float
    diagonal_mm: float
    _levels: dict[int, Level] = field(default_factory=dict, compare=False, repr=False)

    def level(self, most_points: int) -> Level:
        """Return the level of at most about `most_points`; computed once."""
        step = self.step_of(most_points)
        if step not in self._levels:
            self._levels[step] = _build_level(self, step)
        return self._levels[step]

    def step_of(self, most_points: int) -> int:
        """Return the side in pixels of the blocks that leave at most about `most_points`."""
        step = max(1, int(np.ceil(np.sqrt(self.valid.sum() / most_points))))
        while step > 1 and min(self.valid.shape) // step < 2 * LEVEL_WINDOW_PX:
            step -= 1
        return step

    @cached_property
    def patches(self) -> Patches:
        """A smooth patch for every pixel, of means of 2 x 2 and more pixels where there are very many."""
        from fringed_plugins.registration.patches import patches

        return patches(self.thinned(MOST_PATCHES))

    @cached_property
    def sharp(self) -> Patches:
        """The same of the smallest windows that serve: what a motion is found with."""
        from fringed_plugins.registration.patches import sharp

        return sharp(self.thinned(MOST_PATCHES))

    def thinned(self, most_points: int) -> Surface:
        """Return the surface of block means that has at most about `most_points`, itself if it has no more."""
        step = int(np.ceil(np.sqrt(self.valid.sum() / most_points)))
        if step <= 1:
            return self
        xyz, valid, count = block_means(self, step)
        sigma = None if self.sigma is None else _sigma(self, step, count).astype(np.float32)
        noise = self.noise_mm / step
        return replace(
            self, xyz=xyz.astype(np.float32), valid=valid, sigma=sigma, spacing_mm=self.spacing_mm * step,
            noise_mm=noise, _levels={},
        )  # fmt: skip


def prepare(xyz_mm: Array, rejected: Array | None = None, sigma_mm: Array | None = None, name: str = "view") -> Surface:
    """Return the surface of a range image.

    Parameters
    ----------
    xyz_mm
        (height, width, 3) points in mm in the camera's frame; what is not finite does not count.
    rejected
        (height, width), zero where a point counts.
    sigma_mm
        (height, width) standard deviation along the ray; estimated as one number when left out.
    name
        what messages call it.

    Raises
    ------
    ValueError
        wrong shapes, too few points, or points on one line.
    """
    xyz_mm = np.asarray(xyz_mm)
    if xyz_mm.ndim != 3 or xyz_mm.shape[2] != 3 or xyz_mm.dtype.kind != "f":
        raise ValueError(
            f"the {name} has shape {xyz_mm.shape} and type {xyz_mm.dtype}; expected (height, width, 3) of floats: "
            "registration needs the organised grid"
        )
    for what, array in (("rejected", rejected), ("sigma_mm", sigma_mm)):
        if array is not None and array.shape != xyz_mm.shape[:2]:
            raise ValueError(f"{what} of the {name} has shape {array.shape}; its points have {xyz_mm.shape[:2]}")
    valid = np.empty(xyz_mm.shape[:2], np.bool_)
    finite(xyz_mm, valid)
    if rejected is not None:
        valid &= rejected == 0
    if sigma_mm is not None:
        valid &= np.isfinite(sigma_mm) & (sigma_mm > 0)
    _require_points(name, int(valid.sum()), valid.size)
    return _cleaned(xyz_mm, valid, sigma_mm, name)


def _require_points(name: str, count: int, total: int) -> None:
    if count < MIN_POINTS:
        raise ValueError(
            f"the {name} has {count} valid points of {total}; registration needs at least {MIN_POINTS}: "
            "check its mask, exposure and range"
        )


def _cleaned(xyz_mm: Array, valid: BoolArray, sigma_mm: Array | None, name: str) -> Surface:
    rows, columns = np.flatnonzero(valid.any(1)), np.flatnonzero(valid.any(0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    valid, given = np.ascontiguousarray(valid[box]), xyz_mm[box]
    at = _some(valid, 10_000)
    origin = np.median(given[at // valid.shape[1], at % valid.shape[1]].astype(np.float64), axis=0)
    origin = origin.astype(xyz_mm.dtype).astype(np.float64)
    spacing = _resolution(given, valid)
    if not spacing > 0:
        raise ValueError(f"the {name}: {NO_RESOLUTION}")
    xyz = np.empty(given.shape, np.float32)
    count = centre(given, valid, origin, JUMP * spacing, xyz)
    _require_points(f"{name}, depth jumps removed,", count, valid.size)
    inside = xyz.reshape(-1, 3)[_some(valid, 10_000)].astype(np.float64)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(inside.T))[::-1], 0.0) * len(inside))
    if spread[1] < 1e-4 * spread[0] or spread[1] < spacing:
        raise ValueError(f"the points of the {name} lie on one line; a registration needs a surface")
    low, high = np.percentile(inside, (1, 99), axis=0)
    sigma = None if sigma_mm is None else sigma_mm[box].astype(np.float32)
    noise = _noise(xyz, valid) if sigma is None else float(np.median(sigma.reshape(-1)[_some(valid, 50_000)]))
    corner = (int(rows[0]), int(columns[0]))
    return Surface(name, xyz, valid, sigma, origin, corner, spacing, noise, float(np.linalg.norm(high - low)))


def _some(valid: BoolArray, most: int) -> npt.NDArray[np.intp]:
    """Return the flat indices of at most about `most` valid pixels, spread evenly."""
    at = np.flatnonzero(valid)
    return at[:: max(1, at.size // most)]


def _resolution(xyz: Array, valid: BoolArray) -> float:
    """Return the median distance of neighbours along rows, on a sample of rows."""
    step = max(1, xyz.shape[0] // 200)
    both = valid[::step, 1:] & valid[::step, :-1]
    if not both.any():
        return 0.0
    rows, columns = np.nonzero(both)
    few = max(1, rows.size // 20_000)
    rows, columns = rows[::few] * step, columns[::few]
    apart = xyz[rows, columns + 1].astype(np.float64) - xyz[rows, columns]
    return float(np.median(np.sqrt(np.einsum("ij,ij->i", apart, apart))))


def _noise(xyz: Array, valid: BoolArray) -> float:
    """Return the noise in depth from third differences along columns, which no smooth surface has."""
    step = max(1, xyz.shape[1] // 400)
    z, ok = xyz[:, ::step, 2], valid[:, ::step]
    four = ok[:-3] & ok[1:-2] & ok[2:-1] & ok[3:]
    third = (z[3:] - 3 * z[2:-1] + 3 * z[1:-2] - z[:-3]).reshape(-1)[_some(four, 30_000)]
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)) if third.size else 0.0


def _build_level(surface: Surface, step: int) -> Level:
    xyz, valid, count = block_means(surface, step)
    whole, filled = healed(xyz, valid)
    n, inner = normals(whole, filled, LEVEL_WINDOW_PX)
    inner &= valid & complete(_connected(whole, filled, JUMP * step * surface.spacing_mm), LEVEL_WINDOW_PX)
    points, directions, interior = xyz[valid], n[valid], inner[valid]
    directions[~interior] = 0
    if int(interior.sum()) < MIN_INTERIOR:
        raise ValueError(
            f"the {surface.name} has {int(interior.sum())} points with a complete neighbourhood of "
            f"{LEVEL_WINDOW_PX * step} pixels; registration needs {MIN_INTERIOR}: its valid region is too torn"
        )
    sigma = _sigma(surface, step, count)[valid]
    ray = points + surface.origin
    cosine = np.abs(np.einsum("ij,ij->i", ray, directions)) / np.maximum(np.linalg.norm(ray, axis=1), 1e-12)
    sigma *= np.maximum(cosine, LEAST_COSINE)
    sigma = np.where(interior, sigma, np.median(sigma[interior]))
    spacing = _resolution(xyz, valid)
    half = LEVEL_WINDOW_PX // 2
    ramp_squares = LEVEL_WINDOW_PX * 2 * sum(k * k for k in range(1, half + 1))
    slope_noise = float(np.median(sigma[interior])) / (spacing * np.sqrt(ramp_squares))
    return Level(points, directions, interior, sigma, spacing, slope_noise)


def block_means(surface: Surface, step: int) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Return the mean of each block's valid points, where it counts, and of how many points it is."""
    h, w = (n // step for n in surface.valid.shape)
    xyz, valid = surface.xyz[: h * step, : w * step], surface.valid[: h * step, : w * step]
    if step == 1:
        return xyz.astype(np.float64), valid.copy(), np.ones(valid.shape)
    filled = cv2.resize(valid.astype(np.float32), (w, h), interpolation=cv2.INTER_AREA).astype(np.float64)
    ok = filled >= FILLED
    share = np.maximum(filled, 1.0 / step**2)[..., None]
    mean = cv2.resize(xyz, (w, h), interpolation=cv2.INTER_AREA).astype(np.float64) / share
    square = np.einsum("ijk,ijk->ij", xyz, xyz)
    spread = cv2.resize(square, (w, h), interpolation=cv2.INTER_AREA) / share[..., 0] - (mean**2).sum(2)
    ok &= spread < (SPREAD * step * surface.spacing_mm) ** 2
    mean[~ok] = 0
    return mean, ok, filled * step**2


def _sigma(surface: Surface, step: int, count: FloatArray) -> FloatArray:
    """Return the standard deviation of each block's mean along the ray."""
    h, w = count.shape
    if surface.sigma is None:
        return np.full((h, w), surface.noise_mm) / np.sqrt(np.maximum(count, 1.0))
    known = np.where(surface.valid, surface.sigma, 0)[: h * step, : w * step] ** 2
    share = np.maximum(count, 1.0) / step**2
    mean_square = cv2.resize(known, (w, h), interpolation=cv2.INTER_AREA).astype(np.float64) / share
    return np.sqrt(mean_square / np.maximum(count, 1.0))


def _connected(xyz: FloatArray, valid: BoolArray, limit_mm: float) -> BoolArray:
    """Return which points have no jump to a valid neighbour."""
    ok = valid.copy()
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        far = (((xyz[a] - xyz[b]) ** 2).sum(2) > limit_mm**2) & valid[a] & valid[b]
        ok[a] &= ~far
        ok[b] &= ~far
    return ok
