"""Invariants of what lies within a radius: second-order moments, and energies of spherical harmonics.

Owns neighbourhoods and both families of invariants, for bare points, without a grid or normals. Knows
nothing of a second cloud.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fringed_plugins.registration.features.grid import in_units_of_noise
from fringed_plugins.registration.normals import BoolArray
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
Index = npt.NDArray[np.intp]
LEAST_NEIGHBOURS = 10
MOST_DEGREE = 12
_BLOCK, _PAIRS = 4000, 100_000  # centres whose neighbours are counted, and neighbours summed, at once


@dataclass(frozen=True)
class Invariants:
    """`values` (n, m) without a unit, NaN where not `valid` (n,); `neighbours` (n,) counts points within the radius.

    Counts are zero where nothing was asked for. `sigma` (m,) is the typical standard deviation from which points were
    sampled and from the neighbours' noise, by what the invariants of random halves of neighbourhoods differ.
    """

    values: FloatArray
    valid: BoolArray
    neighbours: Index
    sigma: FloatArray

    def normalised(self) -> FloatArray:
        """Return the values (n, m) in units of their typical noise: see `grid.in_units_of_noise`."""
        return in_units_of_noise(self.values, np.broadcast_to(self.sigma, self.values.shape), self.valid)


@dataclass(frozen=True)
class Around:
    """What is known of the points, and which of them to describe.

    `chosen` (n,) says which get invariants, all where left out. `weights` (n,) are areas, say, where density depends
    on the view; `boundary` (n,) points make all within a radius of them not valid, since their neighbourhoods are cut.
    `seed` halves the points, `threads` look for neighbours.
    """

    chosen: Array | None = None
    weights: Array | None = None
    boundary: Array | None = None
    seed: int = 0
    threads: int = 1


def moment_invariants(
    points: Array, radius: float, around: Around | None = None, report: Report = silent
) -> Invariants:
    """Return J1, J2 and J3 of the central second moments of each point's neighbourhood.

    With mu the covariance of the points within `radius`: J1 is its trace, J2 the sum of its principal minors of order
    two, J3 its determinant, divided by radius^2, radius^4 and radius^6. An even disc has 1/2, 1/16 and 0.

    Parameters
    ----------
    points
        (n, 3) in any unit; rows that are not finite are not valid.
    radius
        of the neighbourhoods, in the points' unit.
    around
        which points to describe, weights, boundary.
    report
        called at least every 0.2 s with how much is done; may raise.

    Raises
    ------
    ValueError
        wrong shapes, or a radius that is not positive.

    References
    ----------
    Sadjadi & Hall, Three-dimensional moment invariants, PAMI 1980; Sharp, Lee, Wehe, PAMI 2002.

    Examples
    --------
    >>> y, x = np.mgrid[-60:61.0, -60:61.0]
    >>> flat = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> middle = Around(chosen=(flat == 0).all(axis=1))
    >>> moment_invariants(flat, 40.0, middle).values[7320].round(3)
    array([0.5  , 0.062, 0.   ])
    """
    return _invariants(points, radius, around or Around(), report, (_second, _moments))


def harmonic_invariants(
    points: Array, radius: float, degree: int = 4, around: Around | None = None, report: Report = silent
) -> Invariants:
    """Return the energies of spherical harmonics of degrees 1 to `degree` of each point's neighbourhood.

    c_lm is the mean of Y_lm over the directions from the point to those within `radius`, each weighted with its
    distance, since noise turns near ones most. The invariant is 4 pi / (2 l + 1) sum_m |c_lm|^2, the mean of
    P_l(cos) of the angle between any two directions: 1 where all point the same way. An even disc has P_l(0)^2.

    Parameters
    ----------
    points
        (n, 3) in any unit; rows that are not finite are not valid.
    radius
        of the neighbourhoods, in the points' unit.
    degree
        the highest, 1 to 12.
    around
        which points to describe, weights, boundary.
    report
        called at least every 0.2 s with how much is done; may raise.

    Raises
    ------
    ValueError
        wrong shapes, a radius that is not positive, another degree.

    References
    ----------
    Burel & Henocq, Three-dimensional invariants and their application to object recognition, Signal Processing 1995;
    Sharp, Lee, Wehe, PAMI 2002.

    Examples
    --------
    >>> y, x = np.mgrid[-60:61.0, -60:61.0]
    >>> flat = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    >>> middle = Around(chosen=(flat == 0).all(axis=1))
    >>> harmonic_invariants(flat, 40.0, around=middle).values[7320].round(3)
    array([0.   , 0.25 , 0.   , 0.141])
    """
    if not 1 <= degree <= MOST_DEGREE:
        raise ValueError(f"a degree of {degree}; expected 1 to {MOST_DEGREE}")
    how = (lambda offset: _harmonics(offset, degree)), (lambda sums: _energies(sums, degree))
    return _invariants(points, radius, around or Around(), report, how)


_How = tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]


def _invariants(points: Array, radius: float, around: Around, report: Report, how: _How) -> Invariants:
    given, known, weights, half = _checked(points, radius, around)
    terms, finish = how
    wanted = np.arange(int(known.sum())) if around.chosen is None else np.flatnonzero(np.asarray(around.chosen)[known])
    report(0.0, "a search tree of the cloud")
    inside = given[known]
    tree = cKDTree(inside, balanced_tree=False, compact_nodes=False)
    count = np.zeros(len(inside), np.intp)
    values = np.full((3, len(inside), finish(terms(np.zeros((1, 3)))).shape[1]), np.nan)
    for centres, index, lengths in _neighbourhoods(tree, wanted, radius, around.threads):
        owner = np.repeat(centres, lengths)
        sums = _sums(terms((inside[index] - inside[owner]) / radius), weights[index], half[index], lengths)
        values[:, centres], count[centres] = np.stack([finish(part) for part in sums]), lengths
        report((centres[-1] + 1) / len(inside), "invariants of the cloud")
    whole = (count >= LEAST_NEIGHBOURS) & np.isfinite(values[0]).all(axis=1) & _uncut(inside, radius, around, known)
    halved = whole & np.isfinite(values).all(axis=(0, 2))
    differ = np.abs(values[1] - values[2])[halved]
    sigma = 1.4826 * np.median(differ, axis=0) / 2 if halved.any() else np.full(values.shape[2], np.nan)
    out, valid, neighbours = np.full((len(given), values.shape[2]), np.nan), known.copy(), np.zeros(len(given), np.intp)
    valid[known], neighbours[known] = whole, count
    out[valid] = values[0, whole]
    return Invariants(out, valid, neighbours, sigma)


def _checked(points: Array, radius: float, around: Around) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray]:
    """Return the points, which are finite, and of those the weights and which half they belong to, 0 or 1."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        raise ValueError(f"points of shape {points.shape} and type {points.dtype}; expected (n, 3) of floats")
    if not (np.isfinite(radius) and radius > 0):
        raise ValueError(f"a radius of {radius}; expected a positive length in the points' unit")
    for name, array in (("chosen", around.chosen), ("weights", around.weights), ("boundary", around.boundary)):
        if array is not None and np.shape(array) != (len(points),):
            raise ValueError(f"{name} have shape {np.shape(array)}; expected ({len(points)},)")
    known = np.asarray(np.isfinite(points).all(axis=1), np.bool_)
    if not known.any():
        raise ValueError(f"none of {len(points)} points is finite; expected some")
    weights = np.ones(len(points)) if around.weights is None else np.asarray(around.weights, np.float64)
    if not (np.isfinite(weights[known]) & (weights[known] >= 0)).all():
        raise ValueError("weights are negative or not finite; expected areas")
    half = np.random.default_rng(around.seed).integers(0, 2, len(points)).astype(np.float64)
    return points.astype(np.float64), known, weights[known], half[known]


def _neighbourhoods(tree: cKDTree, wanted: Index, radius: float, threads: int) -> Iterator[tuple[Index, Index, Index]]:
    """Yield some of the centres `wanted`, their neighbours one after the other, and how many each centre has."""
    for first in range(0, len(wanted), _BLOCK):
        part = wanted[first : first + _BLOCK]
        lengths = tree.query_ball_point(tree.data[part], radius, workers=threads, return_length=True)
        pieces = np.cumsum(lengths) // _PAIRS
        for centres in np.split(part, np.flatnonzero(np.diff(pieces)) + 1):
            lists = tree.query_ball_point(tree.data[centres], radius, workers=threads, return_sorted=True)
            counts = np.fromiter(map(len, lists), np.intp, len(lists))
            yield centres, np.concatenate([np.asarray(one, np.intp) for one in lists]), counts


def _sums(terms: FloatArray, weights: FloatArray, half: FloatArray, lengths: Index) -> list[FloatArray]:
    """Return weighted sums (m, t) of terms over each neighbourhood: of all, of one half, and of the other."""
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    weighted = terms * weights[:, None]
    total = np.add.reduceat(weighted, starts, axis=0)
    one = np.add.reduceat(weighted * half[:, None], starts, axis=0)
    return [total, one, total - one]


def _uncut(points: FloatArray, radius: float, around: Around, known: BoolArray) -> BoolArray:
    """Return which points have no boundary point within the radius."""
    if around.boundary is None:
        return np.ones(len(points), np.bool_)
    rim = points[np.asarray(around.boundary)[known] != 0]
    if not len(rim):
        return np.ones(len(points), np.bool_)
    reach = float(np.nextafter(radius, np.inf))  # a bound is not itself within
    distance, _ = cKDTree(rim).query(points, distance_upper_bound=reach, workers=around.threads)
    return np.asarray(~np.isfinite(distance), np.bool_)


def _second(offset: FloatArray) -> FloatArray:
    """Return 1, x, y, z, x^2, y^2, z^2, x y, x z, y z of (m, 3)."""
    x, y, z = offset.T
    return np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=1)


def _moments(sums: FloatArray) -> FloatArray:
    """Return J1, J2, J3 (m, 3) of sums of `_second`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = sums[:, 1:] / sums[:, :1]
    x, y, z, xx, yy, zz, xy, xz, yz = mean.T
    a, b, c = xx - x * x, yy - y * y, zz - z * z
    d, e, f = xy - x * y, xz - x * z, yz - y * z
    minors = a * b + a * c + b * c - d * d - e * e - f * f
    return np.stack([a + b + c, minors, a * b * c + 2 * d * e * f - c * d * d - b * e * e - a * f * f], axis=1)


def _harmonics(offset: FloatArray, degree: int) -> FloatArray:
    """Return the distance, then its product with real and imaginary parts of Y_lm, m = 0 .. l, of (m, 3).

    By recurrence in x, y, z, normalised to 4 pi / (2 l + 1): fifteen times as fast as scipy.special.sph_harm_y, and
    exact at the poles.
    """
    distance = np.sqrt(np.einsum("ij,ij->i", offset, offset))
    unit = offset / np.where(distance > 0, distance, 1.0)[:, None]
    z, turn = unit[:, 2], unit[:, 0] + 1j * unit[:, 1]
    legendre: dict[tuple[int, int], Array] = {}
    power, start = np.ones(len(offset), np.complex128), 1.0
    columns: dict[tuple[int, int], Array] = {}
    for m in range(degree + 1):
        for order in range(m, degree + 1):
            if order == m:
                value: Array = np.full(len(offset), start)
            else:
                before = legendre.get((order - 2, m), np.zeros(1))
                value = ((2 * order - 1) * z * legendre[order - 1, m] - (order + m - 1) * before) / (order - m)
            legendre[order, m] = value
            columns[order, m] = np.sqrt(factorial(order - m) / factorial(order + m)) * value * distance * power
        power, start = power * turn, -start * (2 * m + 1)
    parts = [columns[order, m] for order in range(1, degree + 1) for m in range(order + 1)]
    return np.stack([distance, *(side for part in parts for side in (part.real, part.imag))], axis=1)


def _energies(sums: FloatArray, degree: int) -> FloatArray:
    """Return energies (m, degree) of sums of `_harmonics`: Y_l,-m is the conjugate of Y_lm but for its sign."""
    with np.errstate(divide="ignore", invalid="ignore"):
        square = (sums[:, 1:] / sums[:, :1]) ** 2
    out, at = np.empty((len(sums), degree)), 0
    for order in range(1, degree + 1):
        width = 2 * (order + 1)
        out[:, order - 1] = square[:, at : at + 2].sum(axis=1) + 2 * square[:, at + 2 : at + width].sum(axis=1)
        at += width
    return out
