"""What the points of both frames are described by: as they come, or by invariants of their neighbourhoods.

Owns the policies of description: one radius and one unit for both frames, where neighbourhoods are complete, and how
few of them are computed. The invariants are `features.invariants`; how they are compared is `matching`'s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from fringed_plugins.registration.family.frames import FEATURE_FLOOR, Frame, Index
from fringed_plugins.registration.features.invariants import (
    Around,
    Invariants,
    harmonic_invariants,
    moment_invariants,
)
from fringed_plugins.registration.normals import BoolArray
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.transforms import FloatArray

# in resolutions: smaller ones lock into the grid, and of moments only the third tells much
RADII = {"moments": (8.0, 11.0, 15.0), "harmonics": (6.0, 8.0, 11.0)}
ENOUGH = 6 * 2**0.5  # spread of all invariants in units of noise: as much as two curvatures of `frames.CERTAIN` have
TRIED = 400  # centres that a radius is judged by
LEAST_WHOLE = 200
DEGREE = 4


class Describing(Protocol):
    """Describe points."""

    def __call__(
        self, reference: Frame, model: Frame, threads: int = 1, report: Report = silent
    ) -> tuple[Frame, Frame]:
        """Return both frames with features that may be compared, in units of their noise."""
        ...


@dataclass(frozen=True)
class AsGiven:
    """The features that the frames have: principal curvatures, or what the caller gave."""

    def __call__(
        self, reference: Frame, model: Frame, threads: int = 1, report: Report = silent
    ) -> tuple[Frame, Frame]:
        """Return the frames."""
        return reference, model


@dataclass(frozen=True)
class Neighbourhoods:
    """Moment invariants, or energies of spherical harmonics, of what lies within a radius; valid where no rim does.

    The radius is the smallest of `radii`, in resolutions, in which the invariants' spread is `ENOUGH` times their noise
    in both frames. Points count by their area, so that the direction of view does not matter. At most about `support`
    points make the neighbourhoods, and about `centres` have theirs computed; the grid's pixels in between are
    interpolated.

    References
    ----------
    Sharp, Lee, Wehe: ICP registration using invariant features, PAMI 2002: features divided by the standard deviation
    of their noise.
    """

    kind: Literal["moments", "harmonics"] = "moments"
    radii: tuple[float, ...] | None = None
    support: int = 20_000
    centres: int = 4_000

    def __call__(
        self, reference: Frame, model: Frame, threads: int = 1, report: Report = silent
    ) -> tuple[Frame, Frame]:
        """Return both frames with these invariants.

        Raises
        ------
        ValueError
            a frame has hardly any complete neighbourhood, even of the smallest radius.
        """
        clouds = [_Cloud.of(frame, self.support, self.centres, threads) for frame in (reference, model)]
        within = _Within(self.kind, lambda _, text: report(0.0, text))
        radius = self._radius(clouds, within)
        for cloud in clouds:
            if not len(cloud.clear(radius)):
                raise ValueError(
                    f"no point of the {cloud.frame.name} has a complete neighbourhood of radius {radius:.4g}"
                )
        found = [within(cloud, radius, cloud.clear(radius)) for cloud in clouds]
        unit = _unit([one.values[one.valid] for one in found], [within.noise(cloud, radius) for cloud in clouds])
        first, second = (
            cloud.frame.with_features(*cloud.spread(one.values / unit))
            for cloud, one in zip(clouds, found, strict=True)
        )
        return first, second

    def _radius(self, clouds: list[_Cloud], within: _Within) -> float:
        """Return the smallest radius that tells points apart, the last that leaves enough of them, or the first."""
        resolution = max(cloud.resolution for cloud in clouds)
        radii = [resolution * radius for radius in self.radii or RADII[self.kind]]
        kept = radii[0]
        for radius in radii:
            if min(len(cloud.clear(radius)) for cloud in clouds) < LEAST_WHOLE:
                break
            kept = radius
            if radius == radii[-1] or min(within.told(cloud, radius) for cloud in clouds) > ENOUGH:
                break
        return kept


@dataclass(frozen=True)
class _Within:
    """Invariants of one kind."""

    kind: str
    report: Report

    def __call__(self, cloud: _Cloud, radius: float, centres: Index, part: BoolArray | None = None) -> Invariants:
        chosen = np.zeros(len(cloud.points), np.bool_)
        chosen[centres] = True
        around = Around(chosen, cloud.weights if part is None else cloud.weights * part, threads=cloud.threads)
        if self.kind == "moments":
            return moment_invariants(cloud.points, radius, around, self.report)
        return harmonic_invariants(cloud.points, radius, DEGREE, around, self.report)

    def told(self, cloud: _Cloud, radius: float) -> float:
        """Return the spread of all invariants together in units of their noise."""
        found = self(cloud, radius, cloud.some(radius))
        spread = _spread(found.values[found.valid]) if found.valid.any() else np.zeros(found.values.shape[1])
        return float(np.linalg.norm(spread / np.maximum(self.noise(cloud, radius), 1e-300)))

    def noise(self, cloud: _Cloud, radius: float) -> FloatArray:
        """Return the standard deviation (m,) of invariants by noise and sampling, NaN where it is not known.

        Of the neighbours' by what halves of them differ, those of a chessboard on a grid, for it samples more evenly
        than chance does; of the centre's own by moving it.
        """
        at = cloud.some(radius)
        ours = self(cloud, radius, at)
        sigma = ours.sigma
        if cloud.dark is not None:
            one, other = (self(cloud, radius, at, half).values for half in (cloud.dark, ~cloud.dark))
            sigma = _deviation(one - other) / 2
        moved = self(cloud.with_shaken(at), radius, len(cloud.points) + np.arange(len(at)))
        return np.hypot(sigma, _deviation(moved.values[-len(at) :] - ours.values[at]))


@dataclass(frozen=True)
class _Cloud:
    """The points (n, 3) of a frame that make neighbourhoods, `at` theirs in the frame, and their areas.

    `centres` (k,) index those to describe, as far as `reach` (k,) from the frame's rim. `every` is the step between
    them on the frame's grid, `dark` (n,) its chessboard's dark fields.
    """

    frame: Frame
    points: FloatArray
    at: Index
    weights: FloatArray
    centres: Index
    reach: FloatArray
    resolution: float
    every: int
    dark: BoolArray | None
    threads: int

    @classmethod
    def of(cls, frame: Frame, support: int, most: int, threads: int) -> _Cloud:
        """Return every s-th row and column of a frame, or all points where no grid is, and some of them as centres."""
        thin, every, dark, weights = 1, int(np.ceil(len(frame) / most)), None, np.ones(len(frame))
        at = np.arange(len(frame))
        centres = at[::every]
        if frame.pixel is not None:
            thin = int(np.ceil(np.sqrt(len(frame) / support)))
            every = thin * int(np.ceil(np.sqrt(len(frame) / thin**2 / most)))
            at, row_column = _each(frame.pixel, thin)
            dark, weights = row_column.sum(axis=0) % 2 == 0, _areas(frame, frame.pixel)[at]
            centres = np.flatnonzero((row_column % (every // thin) == 0).all(axis=0))
        points = frame.points[at]
        rim = frame.points[frame.boundary]
        reach = cKDTree(rim).query(points[centres])[0] if len(rim) else np.full(len(centres), np.inf)
        return cls(frame, points, at, weights, centres, reach, thin * frame.resolution, every, dark, threads)

    def clear(self, radius: float) -> Index:
        """Return the centres whose neighbourhoods of a radius are complete."""
        return self.centres[self.reach > radius]

    def some(self, radius: float) -> Index:
        """Return a few of them, from everywhere."""
        centres = self.clear(radius)
        return centres[:: max(1, len(centres) // TRIED)]

    def with_shaken(self, at: Index) -> _Cloud:
        """Return the cloud and, behind its points and of no weight, those of `at` with the sensor's noise once more."""
        of = self.at[at]
        noise = np.random.default_rng(0).standard_normal(len(at)) * self.frame.sigma[of]
        points = np.vstack([self.points, self.points[at] + noise[:, None] * self.frame.rays[of]])
        return replace(self, points=points, weights=np.append(self.weights, np.zeros(len(at))))

    def spread(self, values: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return features of every point of the frame (m, f) from those (n, f) of the cloud, and where they hold."""
        out = np.full((len(self.frame), values.shape[1]), np.nan)
        out[self.at] = values
        pixel = self.frame.pixel
        if pixel is not None and self.every > 1:
            coarse = pixel[:: self.every, :: self.every]
            layers = np.where((coarse >= 0)[..., None], out[coarse], np.nan)
            place = np.array(np.nonzero(pixel >= 0), np.float64) / self.every
            filled = [map_coordinates(layer, place, order=1, cval=np.nan) for layer in np.moveaxis(layers, 2, 0)]
            out[pixel[pixel >= 0]] = np.stack(filled, axis=1)
        valid = np.isfinite(out).all(axis=1)
        return np.where(valid[:, None], out, 0.0), valid


def _each(pixel: Index, step: int) -> tuple[Index, Index]:
    """Return the points (n,) on every `step`-th row and column of a grid, and the number of theirs (2, n)."""
    part = pixel[::step, ::step]
    return part[part >= 0], np.array(np.nonzero(part >= 0))


def _areas(frame: Frame, pixel: Index) -> FloatArray:
    """Return the area (n,) that a point of the grid stands for, zero on the rim."""
    grid = np.pad(pixel, 1, constant_values=-1)
    xyz = np.where((grid >= 0)[..., None], frame.points[grid], np.nan)
    across = np.cross(xyz[1:-1, 2:] - xyz[1:-1, :-2], xyz[2:, 1:-1] - xyz[:-2, 1:-1]) / 4
    out = np.zeros(len(frame))
    out[pixel[pixel >= 0]] = np.linalg.norm(across, axis=2)[pixel >= 0]
    return np.where(frame.boundary | ~np.isfinite(out), 0.0, out)


def _deviation(values: FloatArray) -> FloatArray:
    """Return the standard deviation (m,) of what is finite and around zero, robustly; NaN where nothing is finite."""
    known = np.abs(values[np.isfinite(values).all(axis=1)])
    return 1.4826 * np.median(known, axis=0) if len(known) else np.full(values.shape[1], np.nan)


def _unit(values: list[FloatArray], noise: list[FloatArray]) -> FloatArray:
    """Return the noise (m,) by which the invariants of both frames are divided, for equals have to stay equal."""
    mean = np.sqrt((np.array(noise) ** 2).mean(axis=0))
    unit: FloatArray = np.fmax(mean, FEATURE_FLOOR * _spread(np.vstack(values)))
    return np.where(unit > 0, unit, 1.0)


def _spread(values: FloatArray) -> FloatArray:
    low, high = np.percentile(values, (10, 90), axis=0)
    spread: FloatArray = high - low
    return spread
