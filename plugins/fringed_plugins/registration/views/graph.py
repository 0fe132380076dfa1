"""Views and registered pairs as a graph: which hang together, by which tree, and which loops contradict.

Owns edges, spanning trees, cycles and their closure. Poses that agree best with all edges: see `poses`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.result import Alignment
from fringed_plugins.registration.transforms import FloatArray, apply, checked, inverse, rotation_angle
from fringed_plugins.registration.views.motions import adjoint, logarithm, pivot

Neighbours = dict[int, list[tuple[int, int]]]  # of each view: (other view, number of the edge)


@dataclass(frozen=True)
class Edge:
    """A registered pair: `T_i_j` (4, 4) takes points of view `j` to the frame of view `i`.

    `covariance` (6, 6) is that of the small motion (rotation vector in rad, translation in units of length) in
    frame `i` about its origin, made after `T_i_j`, as `Alignment` has it; `overlap` is 0 to 1.
    """

    i: int
    j: int
    T_i_j: FloatArray
    covariance: FloatArray | None
    overlap: float = 1.0
    converged: bool = True

    @property
    def name(self) -> str:
        """The pair as people count views, from 1: `3-6` joins views 2 and 5."""
        return f"{self.i + 1}-{self.j + 1}"


@dataclass(frozen=True)
class Loop:
    """A cycle: its views and edges in order, and by how much it fails to close.

    `angle_deg`, and `gap` in units of length at the object, of the product of its motions; `mahalanobis2` is
    that motion's square in units of the edges' summed covariance: chi-squared of 6 degrees of freedom.
    """

    views: tuple[int, ...]
    edges: tuple[int, ...]
    angle_deg: float
    gap: float
    mahalanobis2: float


def edges_of(alignments: Mapping[tuple[int, int], Alignment]) -> list[Edge]:
    """Return the edges of registered pairs, by (reference, model)."""
    return [
        Edge(i, j, found.T_reference_model, found.covariance, found.overlap, found.converged)
        for (i, j), found in sorted(alignments.items())
    ]


def require(count: int, edges: Sequence[Edge], reference: int) -> None:
    """Refuse what is no graph of `count` views.

    Raises
    ------
    ValueError
        an edge from a view to itself or to one that does not exist, one that is no rigid motion, a covariance
        that is none, or a reference that is no view.
    """
    if not 0 <= reference < count:
        raise ValueError(f"reference view {reference}; there are {count} views, counted from 0")
    for edge in edges:
        if edge.i == edge.j or not (0 <= edge.i < count and 0 <= edge.j < count):
            raise ValueError(f"edge {edge.name}: expected two different views of {count}, counted from 0")
        checked(edge.T_i_j, f"T of edge {edge.name}")
        if edge.covariance is None:
            continue
        C = np.asarray(edge.covariance)
        if C.shape != (6, 6) or not np.isfinite(C).all() or np.linalg.eigvalsh(_scaled(C))[0] <= 0:
            raise ValueError(
                f"the covariance of edge {edge.name} has shape {C.shape}; expected (6, 6), finite and positive definite"
            )


def usable(edges: Sequence[Edge]) -> list[int]:
    """Return the numbers of the edges that have converged and know their covariance."""
    return [k for k, edge in enumerate(edges) if edge.converged and edge.covariance is not None]


def neighbours(edges: Sequence[Edge], among: Iterable[int]) -> Neighbours:
    """Return which views each view has an edge to, among the edges of these numbers."""
    found: Neighbours = {}
    for k in among:
        edge = edges[k]
        found.setdefault(edge.i, []).append((edge.j, k))
        found.setdefault(edge.j, []).append((edge.i, k))
    return found


def reached(start: int, around: Neighbours) -> dict[int, int]:
    """Return the views that hang together with `start`, nearest first, each with the edge that leads to it (-1)."""
    by = {start: -1}
    waiting = deque([start])
    while waiting:
        view = waiting.popleft()
        for other, k in around.get(view, []):
            if other not in by:
                by[other] = k
                waiting.append(other)
    return by


def strength(edge: Edge) -> float:
    """Return the logarithm of what an edge is worth: overlap over the geometric mean of its standard deviations.

    A common unit of length adds the same to all, so that their order does not depend on it.
    """
    _, logdet = np.linalg.slogdet(_scaled(edge.covariance))
    spread = np.log(np.diagonal(np.asarray(edge.covariance))).sum()
    return float(np.log(max(edge.overlap, 1e-6)) - (logdet + spread) / 12)


def spanning_tree(edges: Sequence[Edge], order: Sequence[int]) -> list[int]:
    """Return the edges of the spanning forest that takes edges in this `order` (Kruskal 1956)."""
    root: dict[int, int] = {}

    def of(view: int) -> int:
        while root.setdefault(view, view) != view:
            view = root[view]
        return view

    tree = []
    for k in order:
        a, b = of(edges[k].i), of(edges[k].j)
        if a != b:
            root[b] = a
            tree.append(k)
    return tree


def placed(edges: Sequence[Edge], tree: Sequence[int], reference: int) -> dict[int, FloatArray]:
    """Return the poses T_model_view that a tree gives, the reference's the identity."""
    poses: dict[int, FloatArray] = {}
    for view, k in reached(reference, neighbours(edges, tree)).items():
        if k < 0:
            poses[view] = np.eye(4)
            continue
        edge = edges[k]
        poses[view] = poses[edge.i] @ edge.T_i_j if view == edge.j else poses[edge.j] @ inverse(edge.T_i_j)
    return poses


def path(edges: Sequence[Edge], among: Iterable[int], start: int, end: int) -> list[int]:
    """Return the edges of a shortest way between two views, empty where there is none."""
    by = reached(start, neighbours(edges, among))
    if end not in by:
        return []
    way = []
    while end != start:
        k = by[end]
        way.append(k)
        end = edges[k].i if edges[k].j == end else edges[k].j
    return way[::-1]


def loops(edges: Sequence[Edge], among: Sequence[int]) -> list[Loop]:
    """Return a shortest loop through every edge that has one, each loop once.

    They hold the fundamental cycles that tell most: long ways round add up many errors.
    """
    found: dict[frozenset[int], Loop] = {}
    for k in among:
        rest = path(edges, [other for other in among if other != k], edges[k].j, edges[k].i)
        if rest and frozenset([k, *rest]) not in found:
            found[frozenset([k, *rest])] = closure(edges, (k, *rest))
    return list(found.values())


def fundamental(edges: Sequence[Edge], tree: Sequence[int], among: Iterable[int]) -> list[Loop]:
    """Return the cycle that each edge outside the tree closes."""
    inside = set(tree)
    ways = ((k, path(edges, tree, edges[k].j, edges[k].i)) for k in among if k not in inside)
    return [closure(edges, (k, *way)) for k, way in ways if way]


def closure(edges: Sequence[Edge], cycle: Sequence[int]) -> Loop:
    """Return the loop of these edges, which start at the first one's view `i`, and its closure."""
    start = here = edges[cycle[0]].i
    total, covariance, views = np.eye(4), np.zeros((6, 6)), [start]
    for k in cycle:
        edge = edges[k]
        forth = edge.i == here
        # of the inverse motion: the same small motion, made before it with the other sign
        Ad = adjoint(total if forth else total @ inverse(edge.T_i_j))
        covariance += Ad @ np.asarray(edge.covariance) @ Ad.T
        total = total @ (edge.T_i_j if forth else inverse(edge.T_i_j))
        here = edge.j if forth else edge.i
        views.append(here)
    error = logarithm(total)
    point = pivot(np.asarray(edges[cycle[0]].covariance))
    gap = float(np.linalg.norm(apply(total, point) - point))
    return Loop(
        tuple(views[:-1]), tuple(cycle), float(np.degrees(rotation_angle(total))), gap, squared(error, covariance)
    )


def squared(error: FloatArray, covariance: FloatArray) -> float:
    """Return the squared Mahalanobis distance of a motion (6,); units of rotation and length are balanced first."""
    scale = np.sqrt(np.diagonal(covariance))
    return float(error / scale @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale))


def _scaled(covariance: FloatArray | None) -> FloatArray:
    """Return the correlations of a covariance; what is no variance gives zeros, which are not positive definite."""
    C = np.asarray(covariance, np.float64)
    variances = np.diagonal(C)
    if (variances <= 0).any():
        return np.zeros((6, 6))
    correlations: FloatArray = C / np.sqrt(np.outer(variances, variances))
    return correlations
