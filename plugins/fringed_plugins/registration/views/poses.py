"""The poses of all views that agree best with their registered pairs, robustly.

Owns the optimisation on SE(3), what is dropped and why, and the poses' covariances. Knows no surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.transforms import FloatArray
from fringed_plugins.registration.views.graph import (
    Edge,
    Loop,
    closure,
    fundamental,
    loops,
    neighbours,
    path,
    placed,
    reached,
    require,
    spanning_tree,
    strength,
    usable,
)
from fringed_plugins.registration.views.motions import displacement, pivot
from fringed_plugins.registration.views.robust import Minimum, System, minimise

CHI2_MEDIAN = 5.348  # of 6 degrees of freedom
CHI2_FAR = 22.46  # 1 of 1000 is beyond


@dataclass(frozen=True)
class Rules:
    """What counts as a contradiction, and when to stop.

    `limit` is the squared Mahalanobis distance beyond which an edge contradicts. Standard deviations from noise know
    nothing of smoothing and calibration, which err alike in all points: they may turn out `most_inflation` times larger
    than stated, and nothing contradicts by less than `least_inflation` of them would allow.
    """

    limit: float = CHI2_FAR
    least_inflation: float = 5.0
    most_inflation: float = 30.0
    iterations: int = 50


@dataclass(frozen=True)
class Residual:
    """What is left at an edge: degrees, units of length at the object, chi-squared, and the weight that it had."""

    edge: int
    angle_deg: float
    gap: float
    mahalanobis2: float
    weight: float


@dataclass(frozen=True)
class Dropped:
    """An edge that does not count, and why."""

    edge: int
    reason: str


@dataclass(frozen=True)
class PoseGraph:
    """The poses by view of all that hang together with the reference, whose frame is the model's.

    `T_model_view` (4, 4) and `covariance` (6, 6) of a small motion in the model's frame about its origin, made after
    the pose, zero for the reference; `start` the poses of the spanning tree; `loops` the tree's fundamental cycles
    over all usable edges; `inflation` by how much the standard deviations were too small; `history` the robust cost
    at the start and after every step, which never rises.
    """

    T_model_view: dict[int, FloatArray]
    covariance: dict[int, FloatArray]
    start: dict[int, FloatArray]
    residuals: tuple[Residual, ...]
    loops: tuple[Loop, ...]
    dropped: tuple[Dropped, ...]
    unreachable: tuple[int, ...]
    inflation: float
    history: tuple[float, ...]
    converged: bool
    reason: str


def agree(
    count: int, edges: Sequence[Edge], reference: int = 0, rules: Rules | None = None, report: Report = silent
) -> PoseGraph:
    """Return the poses of `count` views that agree best with the pairs, in the frame of view `reference`.

    A spanning tree of the strongest edges, those that close a loop first, gives the start. The squared Mahalanobis
    distances of all edges are then minimised under a robust kernel; an edge that still contradicts is dropped, the
    worst first, as long as no view loses its last one.

    Parameters
    ----------
    edges
        registered pairs; those that have not converged or have no covariance are named and left out.
    reference, rules
        the view that stays; when an edge contradicts, and when to stop.
    report
        hears (fraction, text) and may raise to stop the work.

    Raises
    ------
    ValueError
        edges of views that do not exist, motions that are not rigid, covariances that are none.

    References
    ----------
    Lu & Milios 1997; Grisetti, Kuemmerle, Stachniss & Burgard 2010; the kernel: Agarwal, Tipaldi, Spinello,
    Stachniss & Burgard 2013 (dynamic covariance scaling), approached from a wider one (Yang et al. 2020).
    """
    require(count, edges, reference)
    rules = rules or Rules()
    known = usable(edges)
    dropped = [Dropped(k, _unusable(edge)) for k, edge in enumerate(edges) if k not in set(known)]
    together = reached(reference, neighbours(edges, known))
    kept = [k for k in known if edges[k].i in together]
    unreachable = tuple(view for view in range(count) if view not in together)
    cycles = loops(edges, kept)
    inflation = _inflation(cycles, rules)
    limit = rules.limit * max(inflation, rules.least_inflation) ** 2
    tree = spanning_tree(edges, _order(edges, kept, cycles, limit))
    start = placed(edges, tree, reference)
    closed = fundamental(edges, tree, kept)
    while True:
        report(0.5, f"poses of {len(start)} views from {len(kept)} pairs")
        system = System(edges, kept, reference)
        best = minimise(system, start, limit, rules.iterations, report)
        out = _worst(edges, kept, best, limit)
        if out is None:
            break
        dropped.append(Dropped(out, _contradiction(edges, kept, out, best.mahalanobis2[kept.index(out)], inflation)))
        kept = [k for k in kept if k != out]
        inflation = _inflation(loops(edges, kept), rules)
        limit = rules.limit * max(inflation, rules.least_inflation) ** 2
    inflation = min(max(inflation, _left_over(best, len(kept), len(start))), rules.most_inflation)
    reason = "no step lowers the error any more" if best.settled else f"{rules.iterations} steps without standing still"
    report(1.0, f"poses of {len(start)} views, {len(dropped)} pairs left out")
    return PoseGraph(
        best.poses, _covariances(system, best, reference, inflation), start, _residuals(edges, kept, best),
        tuple(closed), tuple(dropped), unreachable, inflation, best.history, best.settled, reason,
    )  # fmt: skip


def _covariances(system: System, found: Minimum, reference: int, inflation: float) -> dict[int, FloatArray]:
    views = [view for view in found.poses if view != reference]
    made = {reference: np.zeros((6, 6))}
    made.update((view, inflation**2 * C) for view, C in zip(views, system.covariances(found), strict=True))
    return made


def _unusable(edge: Edge) -> str:
    return f"pair {edge.name} {'has no covariance' if edge.converged else 'did not converge'}"


def _inflation(cycles: Sequence[Loop], rules: Rules) -> float:
    """Return by how much the standard deviations are too small: the median loop is an ordinary one."""
    if not cycles:
        return 1.0
    middle = float(np.median([loop.mahalanobis2 for loop in cycles]))
    return float(np.clip(np.sqrt(middle / CHI2_MEDIAN), 1.0, rules.most_inflation))


def _left_over(found: Minimum, edges: int, views: int) -> float:
    """Return the residuals' scale: the weighted chi-squared for each degree of freedom that the poses leave."""
    freedom = 6 * (edges - views + 1)
    return float(np.sqrt((found.weights * found.mahalanobis2).sum() / freedom)) if freedom > 0 else 1.0


def _order(edges: Sequence[Edge], kept: Sequence[int], cycles: Sequence[Loop], limit: float) -> list[int]:
    """Return the edges that lie in a loop that closes first, by strength; then the others."""
    confirmed = {k for loop in cycles if loop.mahalanobis2 < limit for k in loop.edges}
    return sorted(kept, key=lambda k: (k not in confirmed, -strength(edges[k]), k))


def _worst(edges: Sequence[Edge], kept: Sequence[int], found: Minimum, limit: float) -> int | None:
    """Return the edge that contradicts most and lies in a loop, None where none does.

    Of edges in a row that only one loop holds nobody can tell which one is wrong: the weakest of them goes.
    """
    for at in np.argsort(-found.mahalanobis2):
        if found.mahalanobis2[at] <= limit:
            return None
        k = int(kept[int(at)])
        if _way_back(edges, kept, k):
            return min([k, *_alike(edges, kept, k)], key=lambda other: strength(edges[other]))
    return None


def _way_back(edges: Sequence[Edge], kept: Sequence[int], k: int) -> list[int]:
    """Return the other edges of the shortest loop through edge `k`, empty where there is none."""
    return path(edges, [other for other in kept if other != k], edges[k].j, edges[k].i)


def _alike(edges: Sequence[Edge], kept: Sequence[int], k: int) -> list[int]:
    """Return the edges that lie in no loop without edge `k`: one of them may be wrong in its place."""
    others = [other for other in kept if other != k]
    return [other for other in _way_back(edges, kept, k) if not _way_back(edges, others, other)]


def _contradiction(edges: Sequence[Edge], kept: Sequence[int], out: int, distance2: float, inflation: float) -> str:
    """Return why an edge was dropped, and which others may be wrong in its place."""
    text = f"pair {edges[out].name} contradicts the others by {np.sqrt(distance2) / inflation:.3g} standard deviations"
    alike = _alike(edges, kept, out)
    if not alike:
        return text
    names = ", ".join(edges[k].name for k in alike)
    loop = _open_loop(edges, out, _way_back(edges, kept, out))
    return f"{text}; {loop}, and no second loop tells whether one of {names} is wrong instead: check these pairs"


def _open_loop(edges: Sequence[Edge], out: int, way: Sequence[int]) -> str:
    """Return in words by how much the loop of an edge and a way back fails to close."""
    loop = closure(edges, (out, *way))
    ring = "-".join(map(str, (*loop.views, loop.views[0])))
    return f"the loop {ring} misses by {loop.angle_deg:.3g} degrees and {loop.gap:.3g}"


def _residuals(edges: Sequence[Edge], kept: Sequence[int], found: Minimum) -> tuple[Residual, ...]:
    made = []
    for k, small, far, weight in zip(kept, found.errors, found.mahalanobis2, found.weights, strict=True):
        point = pivot(np.asarray(edges[k].covariance))
        angle = float(np.degrees(np.linalg.norm(small[:3])))
        made.append(Residual(k, angle, displacement(small, point), float(far), float(weight)))
    return tuple(made)
