"""Poses from registered pairs: known poses, noise of known covariance, and wrong pairs among right ones."""

from __future__ import annotations

import numpy as np
import pytest

from fringed_plugins.registration.plane import motion
from fringed_plugins.registration.transforms import inverse, rigid, rotation, rotation_angle
from fringed_plugins.registration.verify import in_frame
from fringed_plugins.registration.views.graph import Edge
from fringed_plugins.registration.views.motions import adjoint, after, logarithm, pivot
from fringed_plugins.registration.views.poses import Rules, agree

VIEWS = 12
DISTANCE = 900.0
OBJECT = np.array([0.0, 0.0, DISTANCE])
# of a pair about the object: 20 to 50 microradians, 3 to 8 micrometres, as a face of 100 thousand points gives
PAIR = np.diag([3e-5, 5e-5, 2e-5, 8e-3, 5e-3, 3e-3]) ** 2


def ring():
    """Return the poses T_model_view of views round an object, the first one's the identity."""
    turns = [rigid(rotation([0.0, 2 * np.pi * k / VIEWS, 0.0]), [0.0, 0.0, 0.0]) for k in range(VIEWS)]
    about = rigid(np.eye(3), OBJECT)
    return [about @ T @ inverse(about) for T in turns]


def measured(i, j, poses, rng, scale=1.0, wrong=None, overlap=0.6):
    """Return the edge of a pair with noise of covariance PAIR x scale^2, stated as PAIR; `wrong` (6,) on top."""
    covariance = in_frame(PAIR, OBJECT)
    noise = scale * rng.multivariate_normal(np.zeros(6), PAIR)
    T = in_motion(noise if wrong is None else noise + wrong) @ inverse(poses[i]) @ poses[j]
    return Edge(i, j, T, covariance, overlap)


def in_motion(small):
    """Return a small motion about the object as a transform of the frame."""
    about = rigid(np.eye(3), OBJECT)
    return about @ motion(np.asarray(small, np.float64)) @ inverse(about)


def near_and_next(poses, rng, **how):
    pairs = [(k, (k + n) % VIEWS) for n in (1, 2) for k in range(VIEWS)]
    return [measured(i, j, poses, rng, **how) for i, j in pairs]


def off(found, poses):
    """Return the RMS error of the object's place in mm over all views."""
    gaps = [found[k] @ np.append(OBJECT, 1) - poses[k] @ np.append(OBJECT, 1) for k in range(VIEWS)]
    return float(np.sqrt(np.mean(np.sum(np.square(gaps), axis=1))))


def test_calculus_agrees_with_differences():
    rng = np.random.default_rng(0)
    for length in (1e-9, 1e-3, 1.0, 3.0):
        small, d = rng.normal(size=6), 1e-6 * rng.normal(size=6)
        small[:3] *= length / np.linalg.norm(small[:3])
        T = motion(small)
        assert np.allclose(logarithm(T), small, atol=1e-12)
        assert np.allclose(logarithm(motion(d) @ T) - small, after(small) @ d, atol=2e-11)  # d^2 and rounding
        assert np.allclose(logarithm(T @ motion(d) @ inverse(T)), adjoint(T) @ d, atol=2e-11)


def test_pivot_is_where_rotation_and_translation_part():
    assert np.allclose(pivot(in_frame(PAIR, OBJECT)), OBJECT, atol=1e-6)


def test_exact_pairs_give_exact_poses():
    poses = ring()
    found = agree(VIEWS, near_and_next(poses, np.random.default_rng(0), scale=0.0))
    assert found.converged and not found.dropped and not found.unreachable
    assert all(np.allclose(found.T_model_view[k], poses[k], atol=1e-9) for k in range(VIEWS))
    assert all(loop.angle_deg < 1e-6 and loop.gap < 1e-6 for loop in found.loops)
    assert len(found.loops) == 2 * VIEWS - (VIEWS - 1)


def test_loop_error_is_shared_out():
    poses, rng = ring(), np.random.default_rng(1)
    better, cycle = [], []
    for _ in range(10):
        edges = [measured(k, (k + 1) % VIEWS, poses, rng) for k in range(VIEWS)]
        found = agree(VIEWS, edges)
        chained = [np.eye(4)]
        for edge in edges[:-1]:
            chained.append(chained[-1] @ edge.T_i_j)
        better.append(off(found.T_model_view, poses) / off(chained, poses))
        cycle.append(found.loops[0].mahalanobis2)
        assert max(r.mahalanobis2 for r in found.residuals) < found.loops[0].mahalanobis2 / 6  # of 12 equal parts
    # variance k (n - k) / n in place of k: 0.6 of the chain's in the mean over k
    assert np.mean(better) < 0.85
    assert 2 < np.mean(cycle) < 12  # chi-squared of 6 degrees of freedom: 6 +- 1.1


def test_covariance_agrees_with_monte_carlo():
    poses, rng = ring(), np.random.default_rng(2)
    distances = []
    for _ in range(25):
        found = agree(VIEWS, near_and_next(poses, rng), rules=Rules(most_inflation=1.0))
        for k in (1, 3, 6):
            error = logarithm(found.T_model_view[k] @ inverse(poses[k]))
            distances.append(error @ np.linalg.solve(found.covariance[k], error))
    assert 4.5 < np.mean(distances) < 7.5  # 6 +- 0.6 with correlated views


def test_understated_covariances_are_inflated_not_dropped():
    found = agree(VIEWS, near_and_next(ring(), np.random.default_rng(3), scale=8.0))
    assert not found.dropped and 5 < found.inflation < 12


@pytest.mark.parametrize("wrong", [[0, 0, 0, 1.5, 0, 0], [0, 0.5, 0, 0, 0, 0], [0, 3.0, 0, 40.0, 0, 0]])
def test_wrong_pairs_are_named_and_dropped(wrong):
    poses, rng = ring(), np.random.default_rng(4)
    edges = near_and_next(poses, rng)
    for at in (3, 20):  # strong ones, that a tree of the strongest would take
        edges[at] = measured(edges[at].i, edges[at].j, poses, rng, wrong=np.array(wrong, float), overlap=0.95)
    found = agree(VIEWS, edges)
    assert sorted(item.edge for item in found.dropped) == [3, 20]
    assert "pair 4-5 contradicts the others" in next(item.reason for item in found.dropped if item.edge == 3)
    assert off(found.T_model_view, poses) < 0.05  # some pairs' noise, 0.01 mm each


def test_lone_loop_that_does_not_close_names_all_its_pairs():
    poses, rng = ring(), np.random.default_rng(5)
    edges = [measured(k, (k + 1) % VIEWS, poses, rng, overlap=0.3 if k == 7 else 0.6) for k in range(VIEWS)]
    edges[4] = measured(4, 5, poses, rng, wrong=np.array([0, 0.1, 0, 0, 0, 0]))
    found = agree(VIEWS, edges)
    assert [item.edge for item in found.dropped] == [7]  # the weakest
    reason = found.dropped[0].reason
    assert "5-6" in reason and "no second loop" in reason and "misses by 5.7" in reason


def test_never_worse_than_its_start():
    poses, rng = ring(), np.random.default_rng(6)
    for wrong in (None, np.array([0, 2.0, 0, 10.0, 0, 0])):
        edges = near_and_next(poses, rng, scale=3.0)
        edges[0] = measured(0, 1, poses, rng, wrong=wrong)
        found = agree(VIEWS, edges)
        assert found.history[-1] <= found.history[0]


def test_views_out_of_reach_and_failed_pairs_are_named():
    poses, rng = ring(), np.random.default_rng(7)
    edges = [measured(0, 1, poses, rng), measured(1, 2, poses, rng), measured(4, 5, poses, rng)]
    failed = Edge(2, 3, np.eye(4), None, 0.0, False)
    found = agree(6, [*edges, failed])
    assert found.unreachable == (3, 4, 5) and sorted(found.T_model_view) == [0, 1, 2]
    assert found.dropped[0].reason == "pair 3-4 did not converge"
    assert not found.covariance[0].any() and found.covariance[2].any()


def test_unit_of_length_does_not_matter():
    poses = ring()
    millimetres = near_and_next(poses, np.random.default_rng(8))
    D = np.diag([1, 1, 1, 1e-3, 1e-3, 1e-3])
    metres = [Edge(e.i, e.j, shrunk(e.T_i_j), D @ e.covariance @ D, e.overlap) for e in millimetres]
    a, b = agree(VIEWS, millimetres, 3), agree(VIEWS, metres, 3)
    for k in range(VIEWS):
        delta = inverse(shrunk(a.T_model_view[k])) @ b.T_model_view[k]
        assert rotation_angle(delta) < 1e-8 and np.linalg.norm(delta[:3, 3]) < 1e-8


def shrunk(T):
    return rigid(T[:3, :3], 1e-3 * T[:3, 3])


def test_impossible_graphs_are_refused():
    edge = Edge(0, 1, np.eye(4), np.eye(6))
    with pytest.raises(ValueError, match="counted from 0"):
        agree(2, [edge], 2)
    with pytest.raises(ValueError, match="two different views of 2"):
        agree(2, [Edge(0, 2, np.eye(4), np.eye(6))])
    with pytest.raises(ValueError, match="positive definite"):
        agree(2, [Edge(0, 1, np.eye(4), np.zeros((6, 6)))])
    with pytest.raises(ValueError, match="not rigid"):
        agree(2, [Edge(0, 1, 2 * np.eye(4), np.eye(6))])


def test_report_may_stop_the_work():
    def stop(fraction, text):
        raise RuntimeError(text)

    with pytest.raises(RuntimeError, match="poses of 12 views"):
        agree(VIEWS, near_and_next(ring(), np.random.default_rng(9)), report=stop)
