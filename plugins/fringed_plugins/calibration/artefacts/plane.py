"""A plane in a range image: which points are its, where it is, and how flat it seems.

Owns the plane's fit: orthogonal distances, weights by what each point's noise is along the normal.

References
----------
VDI/VDE 2634 part 2 (2012), flatness measurement error; Shakarji 1998 for the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.artefacts.cells import Cells, cells_of
from fringed_plugins.calibration.artefacts.scatter import STRAY, Form, blocks_of, covariance, form_of, spread
from fringed_plugins.calibration.artefacts.smooth import pieces

Array = npt.NDArray[Any]
FEWEST = 500
TURN_RAD = np.deg2rad(3.0)
_NO_PLANE = 0.02  # RMS over extent: such a surface is bent, not badly measured
_SECOND = 0.5


@dataclass(frozen=True)
class Plane:
    """n . X = d: `normal` (3,) towards the camera, `offset_mm` d, and `offset_u_mm`, its uncertainty at `centre_mm`.

    `inside` (height, width) are the pixels that it was measured on.
    """

    normal: Array
    offset_mm: float
    offset_u_mm: float
    centre_mm: Array
    inside: Array
    form: Form


@dataclass(frozen=True)
class Piece:
    """A fitted piece of surface: `normal` and `centre_mm` (3,); signed `deviation_mm` and `weights` (n,) inside."""

    normal: Array
    centre_mm: Array
    inside: Array
    deviation_mm: Array
    weights: Array


def plane_of(xyz_mm: Array, valid: Array, sigma_mm: Array | None = None, smooth_px: int = 7) -> Plane:
    """Return the plane of the largest smooth piece of a range image (height, width, 3).

    `sigma_mm` (height, width) is the deviation along the rays; unset, all count alike. The flatness error is
    `form.range_mm`.

    Raises
    ------
    ValueError
        too few points, no plane, or two of like size.

    Examples
    --------
    >>> y, x = np.mgrid[-40:40, -60:60] * 1.0
    >>> noise = np.random.default_rng(1).normal(0, 0.05, x.shape)
    >>> found = plane_of(np.stack([x, y, 800 + 0.1 * x + noise], axis=-1), np.ones(x.shape, bool))
    >>> [round(abs(float(v)), 2) for v in found.normal], found.form.range_mm < 0.08
    ([0.1, 0.0, 1.0], True)
    """
    cells = cells_of(xyz_mm, valid)
    found = pieces(cells, TURN_RAD)
    if not found:
        raise ValueError("no smooth piece of surface is in view; clean the plane, or expose longer")
    inside = inside_of(cells, found[0], valid)
    plane = fit_plane(xyz_mm, inside, sigma_mm, smooth_px)
    _check_flat(plane, xyz_mm)
    if len(found) > 1:
        _check_alone(found, cells)
    return plane


def inside_of(cells: Cells, piece: Array, valid: Array) -> Array:
    """Return the valid pixels of a piece.

    Raises
    ------
    ValueError
        too few for a measurement.
    """
    inside: Array = cells.pixels(piece, valid.shape) & valid
    count = int(np.count_nonzero(inside))
    if count < FEWEST:
        raise ValueError(
            f"the largest smooth piece of surface has {count} points; a measurement needs {FEWEST}: bring the artefact "
            "nearer, or into the light of the projector"
        )
    return inside


def fit_piece(xyz_mm: Array, inside: Array, sigma_mm: Array | None) -> Piece:
    """Return the least-squares plane of the pixels inside; points beyond six deviations do not pull it."""
    points = xyz_mm[inside].astype(np.float64)
    aim = points / np.linalg.norm(points, axis=1, keepdims=True)
    kept, normal = np.ones(len(points), bool), np.array([0.0, 0.0, -1.0])
    weights = np.ones(len(points))
    centre = points.mean(axis=0)
    for _ in range(4):
        weights = weights_of(sigma_mm, inside, aim @ normal) * kept
        centre, normal = _orthogonal(points, weights)
        deviation = (points - centre) @ normal
        kept = np.abs(deviation - np.median(deviation)) <= STRAY * max(spread(deviation), 1e-9)
    return Piece(normal, centre, inside, deviation, weights)


def fit_plane(xyz_mm: Array, inside: Array, sigma_mm: Array | None, smooth_px: int) -> Plane:
    """Return the plane of the pixels inside, with its uncertainty and form."""
    piece = fit_piece(xyz_mm, inside, sigma_mm)
    across = np.linalg.svd(piece.normal[None])[2][1:]
    points = xyz_mm[inside].astype(np.float64)
    rows = np.column_stack([np.ones(len(points)), (points - piece.centre_mm) @ across.T])
    C = covariance(rows, piece.weights, piece.deviation_mm, blocks_of(inside))
    whole = np.zeros(inside.shape)
    whole[inside] = piece.deviation_mm
    form = form_of(whole, inside, smooth_px)
    offset = float(piece.normal @ piece.centre_mm)
    return Plane(piece.normal, offset, float(np.sqrt(C[0, 0])), piece.centre_mm, inside, form)


def weights_of(sigma_mm: Array | None, inside: Array, cosine: Array) -> Array:
    """Return 1 / variance along the normal, (n,); 1 where no deviations are known."""
    if sigma_mm is None:
        return np.ones(len(cosine))
    sigma = sigma_mm[inside].astype(np.float64)
    usual = float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else 1.0
    sigma = np.where(np.isfinite(sigma) & (sigma > 0), sigma, usual)
    return np.asarray(1.0 / np.maximum(sigma * np.abs(cosine), 0.1 * usual) ** 2)


def _orthogonal(points: Array, weights: Array) -> tuple[Array, Array]:
    """Return the weighted centre and the direction of least spread, towards the camera."""
    total = weights.sum()
    centre = np.einsum("n,ni->i", weights, points) / total
    away = points - centre
    _, vectors = np.linalg.eigh(np.einsum("ni,nj->ij", away * weights[:, None], away) / total)
    normal = vectors[:, 0]
    return centre, np.asarray(-normal if normal @ centre > 0 else normal)


def _check_flat(plane: Plane, xyz_mm: Array) -> None:
    """Refuse a surface that is bent by itself, and no plane that is badly measured."""
    extent = float(np.ptp(xyz_mm[plane.inside][:, :2], axis=0).max())
    if plane.form.rms_mm > _NO_PLANE * extent:
        raise ValueError(
            f"the largest smooth surface in view is no plane: it is {extent:.0f} mm wide and bends by "
            f"{plane.form.rms_mm:.2f} mm RMS; put the plane before the rig, and nothing else"
        )


def _check_alone(found: list[Array], cells: Cells) -> None:
    first, second = (int(np.count_nonzero(piece)) for piece in found[:2])
    if second < _SECOND * first:
        return
    raise ValueError(
        f"two surfaces of like size are in view, of {first * cells.side**2:,} and {second * cells.side**2:,} pixels; "
        "which one is the plane cannot be told: cover one, limit the depth (min_depth_mm, max_depth_mm), or measure "
        "a step"
    )
