"""Steps between parallel planes: which planes there are, one direction for all, and the heights between them.

Owns the joint fit: the planes of a step are parallel by make, so that each height is a difference of offsets.

References
----------
JCGM 100:2008 (GUM), section 5, for the heights' uncertainty: offsets and direction share a covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_opening

from fringed_plugins.calibration.artefacts.cells import cells_of
from fringed_plugins.calibration.artefacts.plane import (
    FEWEST,
    TURN_RAD,
    Piece,
    Plane,
    fit_piece,
    fit_plane,
    weights_of,
)
from fringed_plugins.calibration.artefacts.scatter import STRAY, blocks_of, covariance, spread
from fringed_plugins.calibration.artefacts.smooth import pieces

Array = npt.NDArray[Any]
_PARALLEL_RAD = np.deg2rad(2.0)
_SAME = 0.05  # of the nominal heights' least gap: so near, two pieces are one plane
_WIDE = np.ones((3, 3), bool)  # cells; narrower ones are slivers along an edge
_WRONG = 0.35  # of that gap: so far from a nominal height, a plane is another one


@dataclass(frozen=True)
class Steps:
    """Heights above the lowest plane that was used, n . X = `lowest_mm`: `heights_mm` (n,), `covariance` (n, n), mm^2.

    `nominal_mm` (n,) belongs to them. `planes` (n + 1) go from the lowest to the highest, `inside` (height, width) has
    1, 2 ... where their pixels are; `residual_mm` (height, width) is the distance from them, NaN elsewhere.
    """

    heights_mm: Array
    covariance: Array
    nominal_mm: Array
    normal: Array
    lowest_mm: float
    planes: tuple[Plane, ...]
    inside: Array
    residual_mm: Array


def steps_of(
    xyz_mm: Array, valid: Array, nominal_mm: Sequence[float], sigma_mm: Array | None = None, smooth_px: int = 7
) -> Steps:
    """Return the heights of parallel planes in a range image (height, width, 3), matched to the nominal ones.

    `nominal_mm` are heights above the lowest plane. Where that one is out of view, they are taken as heights above
    something else, and the lowest of them is what the others are measured from.

    Raises
    ------
    ValueError
        nominal heights that make no step, too few parallel planes, or none at the nominal heights.

    Examples
    --------
    >>> y, x = np.mgrid[-50:50, -60:60] * 1.0
    >>> xyz = np.stack([x, y, 800 - 5.0 * (x > 0)], axis=-1)
    >>> [round(float(h), 3) for h in steps_of(xyz, np.abs(x) > 2, [5.0]).heights_mm]
    [5.0]
    """
    wanted = np.unique(np.asarray(nominal_mm, np.float64))
    if not len(wanted) or wanted[0] <= 0 or len(wanted) != len(nominal_mm) or not np.isfinite(wanted).all():
        raise ValueError(f"nominal heights are {list(nominal_mm)}; expected different ones above 0, lowest plane apart")
    gap = float(np.diff(np.concatenate([[0.0], wanted])).min())
    cells = cells_of(xyz_mm, valid)
    least = max(FEWEST // cells.side**2, 10)
    found = [piece for piece in pieces(cells, TURN_RAD) if np.count_nonzero(binary_opening(piece, _WIDE)) >= least]
    planes = [fit_piece(xyz_mm, cells.pixels(piece, valid.shape) & valid, sigma_mm) for piece in found]
    parallel = _parallel(planes, cells.field_mm)
    levels = _levels(parallel, gap)
    chosen, nominal = _matched(levels, wanted, gap)
    return _joint(xyz_mm, [levels[i][1] for i in chosen], sigma_mm, (nominal, smooth_px))


def _parallel(planes: list[Piece], field_mm: float) -> list[Piece]:
    """Return the flat planes that are parallel to the one with most company.

    Raises
    ------
    ValueError
        fewer than two.
    """
    flat = [plane for plane in planes if spread(plane.deviation_mm) < 0.01 * field_mm]
    normals = np.array([plane.normal for plane in flat]).reshape(-1, 3)
    sizes = np.array([np.count_nonzero(plane.inside) for plane in flat])
    alike = normals @ normals.T > np.cos(_PARALLEL_RAD)
    if len(flat) < 2 or alike.sum(axis=1).max() < 2:
        raise ValueError(
            f"{len(flat)} flat surfaces are in view and no two of them are parallel; a step needs two parallel planes "
            f"of {FEWEST} points or more: turn the step so that both are lit and seen"
        )
    best = int(np.argmax(np.where(alike.sum(axis=1) >= 2, alike @ sizes, 0)))
    return [plane for plane, same in zip(flat, alike[best], strict=True) if same]


def _levels(planes: list[Piece], gap_mm: float) -> list[tuple[float, list[Piece]]]:
    """Return heights and planes from the lowest (farthest) up; pieces of one plane go together."""
    sizes = [float(np.count_nonzero(plane.inside)) for plane in planes]
    normal = np.average([plane.normal for plane in planes], axis=0, weights=sizes)
    normal /= np.linalg.norm(normal)
    levels: list[tuple[float, list[Piece]]] = []
    for height, plane in sorted(((float(normal @ p.centre_mm), p) for p in planes), key=lambda pair: pair[0]):
        if levels and height - levels[-1][0] < _SAME * gap_mm:
            levels[-1][1].append(plane)
        else:
            levels.append((height, [plane]))
    return levels


def _matched(levels: list[tuple[float, list[Piece]]], wanted: Array, gap_mm: float) -> tuple[list[int], Array]:
    """Return the levels (lowest first) that have the nominal heights, and these heights above the first.

    Raises
    ------
    ValueError
        no choice of a lowest plane brings all heights together with planes.
    """
    heights = np.array([height for height, _ in levels])
    for places in (np.concatenate([[0.0], wanted]), wanted):
        best, error = None, _WRONG * gap_mm
        for base in heights if len(places) > 1 else []:
            apart = np.abs(heights[None] - base - (places - places[0])[:, None])
            nearest = apart.argmin(axis=1)
            worst = float(apart.min(axis=1).max())
            if worst < error and len(set(nearest)) == len(places):
                best, error = nearest, worst
        if best is not None:
            return [int(i) for i in best], places[1:] - places[0]
    seen = ", ".join(f"{height:.2f}" for height in (heights - heights[0])[1:]) or "none"
    raise ValueError(
        f"no planes at the nominal heights {', '.join(f'{w:g}' for w in wanted)} mm; measured above the lowest plane: "
        f"{seen} mm. Check the heights (in mm) and that all planes are in view"
    )


def _joint(xyz_mm: Array, levels: list[list[Piece]], sigma_mm: Array | None, given: tuple[Array, int]) -> Steps:
    """Fit one direction and an offset for each level; returns the heights with their covariance."""
    nominal, smooth_px = given
    inside = np.zeros(xyz_mm.shape[:2], np.uint8)
    for number, planes in enumerate(levels, 1):
        for plane in planes:
            inside[plane.inside] = number
    which = inside[inside > 0].astype(np.int64) - 1
    points = xyz_mm[inside > 0].astype(np.float64)
    aim = points / np.linalg.norm(points, axis=1, keepdims=True)
    blocks = blocks_of(inside > 0) * len(levels) + which
    blocks = np.unique(blocks, return_inverse=True)[1]
    normal, kept = levels[0][0].normal, np.ones(len(points), bool)
    member = which[:, None] == np.arange(len(levels))
    middles = np.stack([points[which == level].mean(axis=0) for level in range(len(levels))])
    away = points - middles[which]
    for _ in range(6):
        across = np.linalg.svd(normal[None])[2][1:]
        weights = weights_of(sigma_mm, inside > 0, aim @ normal) * kept
        rows = np.column_stack([away @ across.T, member])
        H = np.einsum("ni,nj->ij", rows * weights[:, None], rows)
        found = np.linalg.solve(H, rows.T @ (weights * (away @ normal)))
        normal = normal - found[:2] @ across
        normal /= np.linalg.norm(normal)
        residual = away @ normal - found[2:][which]
        kept = np.abs(residual - np.median(residual)) <= STRAY * max(spread(residual), 1e-9)
    offsets = middles @ normal + found[2:]
    # A height is n . (middle - middle of the lowest) plus their offsets: turning the normal moves it sideways.
    C = covariance(rows, weights, residual, blocks)
    sideways = (middles[1:] - middles[0]) @ across.T
    J = np.column_stack([-sideways, -np.ones(len(sideways)), np.eye(len(sideways))])
    whole = np.full(inside.shape, np.nan)
    whole[inside > 0] = residual
    fitted = tuple(fit_plane(xyz_mm, inside == number, sigma_mm, smooth_px) for number in range(1, len(levels) + 1))
    return Steps(offsets[1:] - offsets[0], J @ C @ J.T, nominal, normal, float(offsets[0]), fitted, inside, whole)
