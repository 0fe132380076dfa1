"""Graphs of poses: loops closed, errors shared out by covariance, single lies refused, never worse than the start."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_relief import errors, head, pose, see
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.chaining import chain
from fringed_plugins.registration.network import Edge, close_loops, optimised
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import inverse, rigid, rotation_angle


class Middle:
    """A view whose own origin is the frame's."""

    origin = np.zeros(3)


def ring(count=10):
    """True poses of views around an object."""
    out = {}
    for k in range(count):
        R = Rotation.from_euler("xyz", (3 * np.sin(k), 360 * k / count, 2 * k), degrees=True).as_matrix()
        out[k] = rigid(R, [5 * np.cos(k), 2 * k, -k])
    return {k: inverse(out[0]) @ T for k, T in out.items()}


def measured(truth, pairs, sigma, rng):
    edges = []
    for i, j in pairs:
        deviation = np.array([sigma] * 3 + [100 * sigma] * 3)
        off = rng.normal(0, deviation)
        T = rigid(Rotation.from_rotvec(off[:3]).as_matrix(), off[3:]) @ inverse(truth[i]) @ truth[j]
        edges.append(Edge(i, j, T, np.diag(deviation**2)))
    return edges


def chained(edges, count):
    poses = {0: np.eye(4)}
    for edge in edges[: count - 1]:
        poses[edge.j] = poses[edge.i] @ edge.T_i_j
    return poses


def off(poses, truth):
    return np.array([rotation_angle(inverse(truth[k]) @ poses[k]) for k in truth])


LOOP = [(k, k + 1) for k in range(9)] + [(0, 9)]
MORE = [*LOOP, *((k, (k + 2) % 10) for k in range(10))]


def test_exact_edges_give_exact_poses_from_poor_ones():
    truth = ring()
    edges = measured(truth, MORE, 1e-12, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    start = {k: T @ rigid(Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix(), rng.normal(0, 5, 3)) if k else T
             for k, T in truth.items()}  # fmt: skip
    found = optimised(edges, start, [Middle] * 10)
    assert off(found.T_model_view, truth).max() < 1e-8
    assert found.closed[0] < 1e-6 < found.before[0]


def test_loop_shares_out_the_error_of_a_chain():
    """Of 60 draws: a chain's error grows to its end, closed it is a bridge; ten edges more halve it again."""
    truth, rng = ring(), np.random.default_rng(3)
    ends = {"chain": [], "loop": [], "more": []}
    for _ in range(60):
        edges = measured(truth, MORE, 1e-3, rng)
        start = chained(edges, 10)
        ends["chain"].append(off(start, truth)[-1] ** 2)
        ends["loop"].append(off(optimised(edges[:10], start, [Middle] * 10).T_model_view, truth)[-1] ** 2)
        ends["more"].append(off(optimised(edges, start, [Middle] * 10).T_model_view, truth)[-1] ** 2)
    rms = {name: np.sqrt(np.mean(values)) for name, values in ends.items()}
    assert rms["chain"] == pytest.approx(np.sqrt(9 * 3) * 1e-3, rel=0.25)
    assert rms["loop"] == pytest.approx(np.sqrt(0.9 * 3) * 1e-3, rel=0.25)  # 9 edges beside 1
    assert rms["more"] < 0.8 * rms["loop"]


def test_edge_that_lies_is_refused_and_the_rest_is_right():
    truth, rng = ring(), np.random.default_rng(4)
    edges = measured(truth, MORE, 1e-4, rng)
    lie = edges[12]
    edges[12] = Edge(lie.i, lie.j, rigid(Rotation.from_rotvec([0.3, 0, 0]).as_matrix(), [4, 0, 0]) @ lie.T_i_j,
                     lie.covariance)  # fmt: skip
    found = optimised(edges, chained(edges, 10), [Middle] * 10)
    assert [(edge.i, edge.j) for edge in found.refused] == [(lie.i, lie.j)]
    assert off(found.T_model_view, truth).max() < 1e-3


def test_edge_that_alone_holds_a_view_is_kept_whatever_it_says():
    truth, rng = ring(3), np.random.default_rng(5)
    edges = measured(truth, [(0, 1), (1, 2)], 1e-4, rng)
    found = optimised(edges, chained(edges, 3), [Middle] * 3)
    assert not found.refused and found.closed[0] < 1e-9


def test_surer_edges_bend_less():
    truth = {0: np.eye(4), 1: np.eye(4), 2: np.eye(4)}
    tight, loose = np.diag([1e-8] * 6), np.diag([1e-4] * 6)
    shift = rigid(np.eye(3), [1e-2, 0, 0])
    edges = [Edge(0, 1, np.eye(4), tight), Edge(1, 2, np.eye(4), loose), Edge(0, 2, shift, tight)]
    found = optimised(edges, truth, [Middle] * 3).T_model_view
    assert abs(found[1][0, 3]) < 1e-5 and abs(found[2][0, 3] - 1e-2) < 1e-5


def test_views_of_a_head_close_their_loop():
    seen = [see(head, pose((0, angle, 0)), noise_mm=0.1, seed=k) for k, angle in enumerate((-20, 0, 20, 35))]
    surfaces = [prepare(view.xyz_mm) for view in seen]
    linked = chain(surfaces)
    known = {(link.partner, link.view): link.alignment for link in linked.links}
    heard = []
    network = close_loops(surfaces, linked.T_model_view, known, report=lambda part, text: heard.append(part))
    assert len(network.edges) == 6 and not network.refused and heard[-1] == 1.0
    assert np.array_equal(network.T_model_view[0], np.eye(4)) or np.allclose(network.T_model_view[0], np.eye(4))
    for k in (1, 2, 3):
        assert errors(network.T_model_view[k], seen[0], seen[k])[1] < 0.03
    assert network.closed[1] <= network.before[1]
