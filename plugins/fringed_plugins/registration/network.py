"""Many views at once: every pair that overlaps is registered, and all poses share out what the loops do not close.

Owns the pairs to try, the graph of poses and its optimum. Knows nothing of how a pair is registered but its result.

References
----------
Lu & Milios: Globally consistent range scan alignment for environment mapping, Autonomous Robots 1997; Grisetti et al.:
A tutorial on graph-based SLAM, 2010.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.result import Alignment, Report, silent
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import (
    FloatArray,
    apply,
    cross_matrix,
    inverse,
    orthonormal,
    rigid,
    rotation,
    translation,
)
from fringed_plugins.registration.verify import in_frame

FEW_POINTS = 1500
NEAR = 2.0  # resolutions of that level within which a point has a partner
ITERATIONS = 30
STILL = 1e-10
HUBER = 3.0  # deviations, in units of what all edges have
CONTRADICTS = 10.0


@dataclass(frozen=True)
class Edge:
    """A registered pair: `T_i_j` takes view j to view i, `covariance` as in `Alignment`, about i's own origin here."""

    i: int
    j: int
    T_i_j: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class Network:
    """Poses by view in the frame of the first, edges used and refused, and what they are off before and after, RMS.

    `closed` is how far edges contradict the poses: RMS of (degrees, mm at the views' middles).
    """

    T_model_view: dict[int, FloatArray]
    edges: tuple[Edge, ...]
    refused: tuple[Edge, ...]
    before: tuple[float, float]
    closed: tuple[float, float]


def close_loops(
    surfaces: Sequence[Surface],
    T_model_view: Mapping[int, FloatArray],
    known: Mapping[tuple[int, int], Alignment],
    options: Options | None = None,
    report: Report = silent,
) -> Network:
    """Return poses in which all pairs that overlap have their say, from poses of a chain on.

    Parameters
    ----------
    surfaces
        all views.
    T_model_view
        poses by view, of those that are placed; the one that is the identity stays where it is.
    known
        registrations by (reference, model) that the poses come from.
    options
        how the other pairs are registered: from where the poses put them, without guesses.
    """
    options = options or Options()
    placed = sorted(T_model_view)
    edges = [_edge(surfaces, *pair, found) for pair, found in known.items() if set(pair) <= set(placed)]
    edges = [edge for edge in edges if edge is not None]
    linked = {frozenset(pair) for pair in known}
    wanted = [pair for pair in _overlapping(surfaces, T_model_view, options) if frozenset(pair) not in linked]
    for number, (i, j) in enumerate(wanted):
        report(number / max(len(wanted), 1), f"loops: view {j} to view {i}")
        start = inverse(T_model_view[i]) @ T_model_view[j]
        wish = replace(options, T_reference_model=start, search=False)
        edges.append(_edge(surfaces, i, j, register(surfaces[i], surfaces[j], wish)))
    report(1.0, "loops: poses")
    return optimised([edge for edge in edges if edge is not None], T_model_view, surfaces)


def _edge(surfaces: Sequence[Surface], i: int, j: int, found: Alignment) -> Edge | None:
    """Return a converged registration as an edge between the views' own origins."""
    if not found.converged or found.covariance is None:
        return None
    T = translation(-surfaces[i].origin) @ found.T_reference_model @ translation(surfaces[j].origin)
    return Edge(i, j, T, in_frame(found.covariance, -surfaces[i].origin))


def _overlapping(
    surfaces: Sequence[Surface], T_model_view: Mapping[int, FloatArray], options: Options
) -> list[tuple[int, int]]:
    """Return the pairs whose poses make them overlap by as much as a registration needs."""
    placed = sorted(T_model_view)
    levels = {view: surfaces[view].level(FEW_POINTS) for view in placed}
    pairs = []
    for number, i in enumerate(placed):
        for j in placed[number + 1 :]:
            T = inverse(T_model_view[i]) @ T_model_view[j]
            T = translation(-surfaces[i].origin) @ T @ translation(surfaces[j].origin)
            points, normals, _ = levels[j].inner()
            distance, index = levels[i].tree.query(apply(T, points))
            facing = np.einsum("ij,ij->i", levels[i].normals[index], normals @ T[:3, :3].T) > 0.5
            share = float(((distance < NEAR * levels[i].spacing_mm) & facing).mean())
            if share >= max(options.limits.min_overlap, 0.1):
                pairs.append((i, j))
    return pairs


def optimised(edges: Sequence[Edge], T_model_view: Mapping[int, FloatArray], surfaces: Sequence[Surface]) -> Network:
    """Return the poses of least contradiction, weighted by the edges' covariances, robust against single wrong ones.

    Edges that contradict the others by far are refused where the views hang together without them. Never worse than
    its start: where the optimum does not lower the contradiction, the start is returned.
    """
    placed = sorted(T_model_view)
    fixed = min(placed, key=lambda view: float(np.abs(T_model_view[view] - np.eye(4)).max()))
    base = translation(surfaces[fixed].origin)
    start = {
        view: inverse(base) @ T_model_view[view] @ translation(surfaces[view].origin) for view in placed
    }  # between the views' own origins
    kept, refused = list(edges), list[Edge]()
    poses = _solve(kept, start, fixed)
    while kept:
        off = np.array([_deviations(edge, poses) for edge in kept])
        worst = int(off.argmax())
        rest = kept[:worst] + kept[worst + 1 :]
        if off[worst] < CONTRADICTS * max(float(np.median(off)), 1.0) or not _connected(rest, placed):
            break
        refused.append(kept[worst])
        kept = rest
        poses = _solve(kept, start, fixed)
    typical = _typical(kept, poses)
    if _cost(kept, poses, typical) > _cost(kept, start, typical):
        poses = start
    out = {view: base @ poses[view] @ translation(-surfaces[view].origin) for view in placed}
    return Network(out, tuple(kept), tuple(refused), _contradiction(kept, start), _contradiction(kept, poses))


def _solve(edges: Sequence[Edge], start: Mapping[int, FloatArray], fixed: int) -> dict[int, FloatArray]:
    """Return the poses by Gauss and Newton, edges beyond Huber's limit weighted down."""
    poses = dict(start)
    column = {view: 6 * number for number, view in enumerate(v for v in sorted(poses) if v != fixed)}
    if not column or not edges:
        return poses
    for _ in range(ITERATIONS):
        H, g = np.zeros((6 * len(column), 6 * len(column))), np.zeros(6 * len(column))
        typical = _typical(edges, poses)
        for edge in edges:
            predicted = inverse(poses[edge.i]) @ poses[edge.j]
            delta = _small(predicted @ inverse(edge.T_i_j))
            weight = min(1.0, HUBER * typical / max(_deviations(edge, poses), 1e-12))
            W = weight * np.linalg.inv(edge.covariance)
            for view, J in ((edge.i, -np.eye(6)), (edge.j, _adjoint(predicted))):
                if view == fixed:
                    continue
                a = column[view]
                g[a : a + 6] += J.T @ W @ delta
                for other, K in ((edge.i, -np.eye(6)), (edge.j, _adjoint(predicted))):
                    if other != fixed:
                        b = column[other]
                        H[a : a + 6, b : b + 6] += J.T @ W @ K
        scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
        small = -np.linalg.lstsq(H / scale[:, None] / scale, g / scale, rcond=1e-12)[0] / scale
        for view, a in column.items():
            poses[view] = orthonormal(poses[view] @ rigid(rotation(small[a : a + 3]), small[a + 3 : a + 6]))
        if float(np.abs(small[:3]).max()) < STILL and float(small @ H @ small) < STILL:
            break
    return poses


def _small(T: FloatArray) -> FloatArray:
    """Return (rotation vector, translation) of a small motion."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def _adjoint(T: FloatArray) -> FloatArray:
    """Return what takes a small motion before T to the one after it."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = T[:3, :3]
    out[3:, :3] = cross_matrix(T[:3, 3]) @ T[:3, :3]
    return out


def _deviations(edge: Edge, poses: Mapping[int, FloatArray]) -> float:
    """Return by how many of its own deviations an edge contradicts poses."""
    delta = _small(inverse(poses[edge.i]) @ poses[edge.j] @ inverse(edge.T_i_j))
    return float(np.sqrt(max(float(delta @ np.linalg.solve(edge.covariance, delta)), 0.0) / 6))


def _typical(edges: Sequence[Edge], poses: Mapping[int, FloatArray]) -> float:
    """Return the deviations that edges usually have: their own, or more where covariances say too little."""
    return max(float(np.median([_deviations(edge, poses) for edge in edges])), 1.0) if edges else 1.0


def _cost(edges: Sequence[Edge], poses: Mapping[int, FloatArray], typical: float) -> float:
    """Return the sum of Huber's loss: what the poses minimise."""
    off = np.array([_deviations(edge, poses) for edge in edges])
    limit = HUBER * typical
    return float(np.where(off < limit, off**2, 2 * limit * off - limit**2).sum())


def _contradiction(edges: Sequence[Edge], poses: Mapping[int, FloatArray]) -> tuple[float, float]:
    """Return how far edges are off, RMS, in degrees and in units of length at the views' middles."""
    if not edges:
        return 0.0, 0.0
    off = [_small(inverse(poses[e.i]) @ poses[e.j] @ inverse(e.T_i_j)) for e in edges]
    square = np.array([[(d[:3] ** 2).sum(), (d[3:] ** 2).sum()] for d in off]).mean(0)
    return float(np.degrees(np.sqrt(square[0]))), float(np.sqrt(square[1]))


def _connected(edges: Sequence[Edge], placed: Sequence[int]) -> bool:
    reached, frontier = {placed[0]}, [placed[0]]
    while frontier:
        view = frontier.pop()
        for edge in edges:
            for a, b in ((edge.i, edge.j), (edge.j, edge.i)):
                if a == view and b not in reached:
                    reached.add(b)
                    frontier.append(b)
    return len(reached) == len(placed)
