"""From a chain of views to poses in which every overlap has its say: pairs registered, loops closed, surfaces asked.

Owns which pairs are tried, and the order pairs -> graph -> joint refinement. How a pair is registered, a graph solved
and surfaces brought together is in `register`, `poses` and `joint`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.result import Alignment, Report, silent
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, apply, inverse, rotation_angle, translation
from fringed_plugins.registration.views.graph import Edge, edges_of
from fringed_plugins.registration.views.joint import Joint, Wish, refine_all
from fringed_plugins.registration.views.poses import PoseGraph, agree

FEW_POINTS = 1500
NEAR = 2.0  # resolutions of that level within which a point has a partner
LEAST_SHARE = 0.1
FACING_COS = 0.5

Poses = Mapping[int, FloatArray]
Known = Mapping[tuple[int, int], Alignment]


@dataclass(frozen=True)
class Closed:
    """Poses by view in the frame of the reference view, and how they came about.

    `edges` are the registered pairs, `graph` what they agree on, `joint` what the surfaces made of it: None where it
    was not asked for. `before` and `after` are how far the pairs contradict the poses of the chain and those returned:
    RMS of (degrees, units of length at the views' middles).
    """

    T_model_view: dict[int, FloatArray]
    edges: tuple[Edge, ...]
    graph: PoseGraph
    joint: Joint | None
    before: tuple[float, float]
    after: tuple[float, float]


def close_loops(
    surfaces: Sequence[Surface],
    T_model_view: Poses,
    known: Known,
    options: Options | None = None,
    report: Report = silent,
    *,
    refine: bool = False,
) -> Closed:
    """Return poses in which all pairs that overlap have their say, from poses of a chain on.

    Parameters
    ----------
    surfaces
        all views.
    T_model_view
        poses by view, of those that are placed; the one nearest to the identity is the reference and stays.
    known
        registrations by (reference, model); those without a covariance are made again from where they ended.
    options
        how the other pairs are registered: from where the poses put them, without guesses.
    report
        hears (fraction, text) several times a second and may raise to stop the work.
    refine
        whether all surfaces are brought together at last.
    """
    options = options or Options()
    reference = min(T_model_view, key=lambda view: float(np.abs(T_model_view[view] - np.eye(4)).max()))
    edges = edges_of(_registered(surfaces, T_model_view, known, options, lambda part, text: report(0.6 * part, text)))
    graph = agree(len(surfaces), edges, reference, report=lambda _, text: report(0.6, text))
    base = T_model_view[reference]
    poses = dict(T_model_view) | {view: base @ T for view, T in graph.T_model_view.items()}
    joint = None
    if refine and len(poses) > 1:
        wish = Wish(threads=options.threads)
        joint = refine_all(surfaces, poses, reference, None, wish, lambda part, text: report(0.6 + 0.4 * part, text))
        poses = joint.T_model_view
    report(1.0, f"{len(edges)} pairs of {len(poses)} views")
    dropped = {out.edge for out in graph.dropped}
    used = [edge for k, edge in enumerate(edges) if k not in dropped]
    off = (_contradiction(used, each, surfaces) for each in (T_model_view, poses))
    return Closed(poses, tuple(edges), graph, joint, *off)


def _registered(
    surfaces: Sequence[Surface], T_model_view: Poses, known: Known, options: Options, report: Report
) -> dict[tuple[int, int], Alignment]:
    """Return the registrations of all pairs that overlap: those that are known, and the rest made."""
    made = {pair: found for pair, found in known.items() if found.converged and set(pair) <= set(T_model_view)}
    wanted = {pair: found.T_reference_model for pair, found in made.items() if found.covariance is None}
    linked = {frozenset(pair) for pair in made}
    for i, j in _overlapping(surfaces, T_model_view, options):
        if frozenset((i, j)) not in linked:
            wanted[i, j] = inverse(T_model_view[i]) @ T_model_view[j]
    for number, ((i, j), start) in enumerate(wanted.items()):
        report(number / len(wanted), f"loops: view {j + 1} to view {i + 1}")
        found = register(surfaces[i], surfaces[j], replace(options, T_reference_model=start, search=""))
        if found.converged or (i, j) not in made:
            made[i, j] = found
    return made


def _overlapping(surfaces: Sequence[Surface], T_model_view: Poses, options: Options) -> list[tuple[int, int]]:
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
            facing = np.einsum("ij,ij->i", levels[i].normals[index], normals @ T[:3, :3].T) > FACING_COS
            share = float(((distance < NEAR * levels[i].spacing_mm) & facing).mean())
            if share >= max(options.limits.min_overlap, LEAST_SHARE):
                pairs.append((i, j))
    return pairs


def _contradiction(edges: Sequence[Edge], poses: Poses, surfaces: Sequence[Surface]) -> tuple[float, float]:
    """Return how far edges are off, RMS, in degrees and in units of length at the views' middles."""
    squares = []
    for edge in edges:
        off = inverse(edge.T_i_j) @ inverse(poses[edge.i]) @ poses[edge.j]
        middle = surfaces[edge.j].origin
        squares.append([np.degrees(rotation_angle(off)) ** 2, float(((apply(off, middle) - middle) ** 2).sum())])
    mean = np.mean(squares, axis=0) if squares else np.zeros(2)
    return float(np.sqrt(mean[0])), float(np.sqrt(mean[1]))
