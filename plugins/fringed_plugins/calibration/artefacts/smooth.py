"""Pieces of surface that continue smoothly: neighbours without a step or an edge between them.

Owns what "continues" means. A piece is bounded by edges of the artefact, never by how well a plane or sphere fits: what
a bad calibration has bent stays in, and is measured.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_fill_holes, label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fringed_plugins.calibration.artefacts.cells import Cells

Array = npt.NDArray[Any]
_NOISES = 6.0
_FLAT = 0.03  # step over spacing that is none
_HOLE_CELLS = 9


def pieces(cells: Cells, most_turn_rad: float, among: Array | None = None) -> list[Array]:
    """Return the smooth pieces (h, w), largest first, of cells whose normals turn by `most_turn_rad` at most.

    `among` (h, w) leaves other cells out. Holes of some cells, such as a speck leaves, belong to the piece.
    """
    chosen = cells.valid if among is None else cells.valid & among
    number = np.full(chosen.shape, -1)
    number[chosen] = np.arange(np.count_nonzero(chosen))
    edges = np.concatenate([_edges(cells, number, axis, most_turn_rad) for axis in (0, 1)])
    count = int(number.max()) + 1
    if not count:
        return []
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (count, count))
    piece = connected_components(graph, directed=False)[1]
    order = np.argsort(-np.bincount(piece), kind="stable")
    which = np.full(chosen.shape, -1)
    which[chosen] = piece
    return [_without_specks(which == one) for one in order[:64]]


def _edges(cells: Cells, number: Array, axis: int, most_turn_rad: float) -> Array:
    """Return pairs of neighbours along an axis between which the surface continues."""
    first, second = [np.take(a, range(*span), axis=axis) for a, span in (
        (number, (0, number.shape[axis] - 1)), (number, (1, number.shape[axis])))]  # fmt: skip
    both = (first >= 0) & (second >= 0)
    if not both.any():
        return np.zeros((0, 2), int)
    low, high = slice(0, -1), slice(1, None)
    at = [(low, slice(None)), (high, slice(None))] if axis == 0 else [(slice(None), low), (slice(None), high)]
    (p, q), (n, m) = [[a[one][both] for one in at] for a in (cells.points_mm, cells.normals)]
    limit = max(_NOISES * np.sqrt(2) * cells.noise_mm, _FLAT * cells.spacing_mm)
    turned = np.arccos(np.clip(np.einsum("ij,ij->i", n, m), -1, 1))
    between = n + m
    between /= np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-300)
    step = np.abs(np.einsum("ij,ij->i", between, q - p))
    kept = (turned <= max(most_turn_rad, _NOISES * cells.normal_noise)) & (step <= limit)
    return np.column_stack([first[both][kept], second[both][kept]])


def _without_specks(piece: Array) -> Array:
    """Return the piece with its small holes filled; large ones are holes of the artefact."""
    holes, count = label(binary_fill_holes(piece) & ~piece)
    if not count:
        return piece
    small = np.bincount(holes.ravel())[1:] <= _HOLE_CELLS
    found: Array = piece | np.isin(holes, np.flatnonzero(small) + 1)
    return found
