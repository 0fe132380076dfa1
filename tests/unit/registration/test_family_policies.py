"""Policies of selection, matching, rejection, weighting and minimisation, each against what can be worked out."""

from __future__ import annotations

import numpy as np
import pytest
from thesis_surface import height, moved, pose, surface

from fringed_plugins.registration.family import rejection as drop
from fringed_plugins.registration.family.frames import frame_of
from fringed_plugins.registration.family.matching import (
    Closest,
    InvariantFeatures,
    NormalShooting,
    Projective,
    Query,
)
from fringed_plugins.registration.family.minimising import PlaneToPlane, PointToPlane, PointToPoint, Scaled, Symmetric
from fringed_plugins.registration.family.selection import Curvature, Everything, NormalSpace, Random, Uniform
from fringed_plugins.registration.family.weighting import Alike, ByDistance, ByNoise, ByNormals, Tukey
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import apply

RNG = np.random.default_rng


@pytest.fixture(scope="module")
def frame():
    return frame_of(prepare(surface()))


def pairs_of(distance, **more):
    n = len(distance)
    zero, up = np.zeros((n, 3)), np.tile([0.0, 0.0, 1.0], (n, 1))
    model = zero + np.asarray(distance)[:, None] * [1.0, 0.0, 0.0]
    given = {
        "model": model, "reference": zero, "model_normals": up, "reference_normals": up,
        "index": np.arange(n), "chosen": np.arange(n), "boundary": np.zeros(n, bool),
        "variance": np.ones(n), "resolution": 0.1,
    }  # fmt: skip
    return drop.Pairs(**{**given, **more})


@pytest.mark.parametrize("policy", [Uniform(500), Random(500), NormalSpace(500), Curvature(500), Everything()])
def test_selection_gives_rising_indices_of_about_the_count(policy, frame):
    chosen = policy(frame, RNG(1))
    assert (np.diff(chosen) > 0).all() and chosen[0] >= 0 and chosen[-1] < len(frame)
    assert len(chosen) == len(frame) if isinstance(policy, Everything) else 350 <= len(chosen) <= 700


def test_selection_by_normals_takes_more_of_the_slopes_than_uniform(frame):
    slope = 1 - np.abs(frame.normals[:, 2])
    even, plain = NormalSpace(500)(frame, RNG(1)), Uniform(500, whole=True)(frame, RNG(1))
    assert slope[even].mean() > 1.3 * slope[plain].mean()
    assert frame.whole[even].all()


def test_selection_of_whole_windows_leaves_the_border(frame):
    chosen = Uniform(2000, whole=True)(frame, RNG(1))
    assert frame.whole[chosen].all() and np.abs(frame.points[chosen] + frame.origin)[:, :2].max() < 5.75


def test_features_are_the_same_after_a_motion(frame):
    other = frame_of(prepare(moved(surface(), pose((20, -10, 30), (3, 2, 1)))))
    assert np.array_equal(frame.whole, other.whole)
    off = np.abs(frame.features - other.features)[frame.whole]
    assert off.max() < 1e-3 * np.abs(frame.features).max()  # float32 points


def test_closest_and_projective_meet_near_points(frame):
    rng = RNG(3)
    some = np.flatnonzero(frame.whole)[::37]
    wanted = frame.points[some] + rng.normal(0, 0.01, (len(some), 3))
    query = Query(wanted, frame.normals[some], frame.features[some], 0.0)
    assert np.array_equal(Closest().prepare(frame, 1)(query), some)
    found = Projective().prepare(frame, 1)(query)
    assert (found == some).mean() > 0.95
    far = Query(wanted + np.array([100.0, 0, 0]), frame.normals[some], frame.features[some], 0.0)
    assert (Projective().prepare(frame, 1)(far) == -1).all()


def test_projective_needs_a_grid(frame):
    from dataclasses import replace

    with pytest.raises(ValueError, match="no grid"):
        Projective().prepare(replace(frame, pixel=None), 1)


def test_invariants_find_the_point_that_moved_away(frame):
    """A point 1.5 away from where it was, ten resolutions and more, is found by its curvatures."""
    some = np.flatnonzero(frame.whole)[::37]
    away = frame.points[some] + [1.5, 0.5, 0.2]
    query = Query(away, frame.normals[some], frame.features[some], 30.0)
    found = InvariantFeatures().prepare(frame, 1)(query)
    assert (found == some).mean() > 0.9
    without = InvariantFeatures().prepare(frame, 1)(Query(away, frame.normals[some], frame.features[some], 1e-9))
    assert (without == some).mean() < 0.05


def test_normal_shooting_hits_along_the_normal(frame):
    some = np.flatnonzero(frame.whole)[::37]
    along = frame.points[some] + 0.3 * frame.normals[some]
    query = Query(along, frame.normals[some], frame.features[some], 0.0)
    found = NormalShooting().prepare(frame, 1)(query)
    assert np.linalg.norm(frame.points[found] - frame.points[some], axis=1).max() < 0.2


@pytest.mark.parametrize(("policy", "distance", "kept"), [
    (drop.Adaptive(), [0.01] * 50 + [0.2], 50), (drop.Sigmas(2.0), [0.1] * 50 + [5.0], 50),
    (drop.Distance(2.0), [0.1, 0.19, 0.21], 2), (drop.Trimmed(0.6), [1, 2, 3, 4, 5], 3),
    (drop.Trimmed(), [0.01] * 60 + [3.0] * 40, 60),
])  # fmt: skip
def test_rejection_by_distance(policy, distance, kept):
    keep, limit = policy(pairs_of(distance), RNG(0))
    assert int(keep.sum()) == kept and np.isfinite(limit)
    assert keep[:kept].all()


def test_rejection_by_boundary_normals_and_one_to_one():
    pairs = pairs_of(
        [0.3, 0.1, 0.2], boundary=np.array([True, False, False]), index=np.array([4, 4, 5]),
        model_normals=np.array([[0, 0, 1.0], [0, 1.0, 0], [0, 0.1, 0.99]]),
    )  # fmt: skip
    assert drop.Boundary()(pairs, RNG(0))[0].tolist() == [False, True, True]
    assert drop.Normals(45)(pairs, RNG(0))[0].tolist() == [True, False, True]
    assert drop.OneToOne()(pairs, RNG(0))[0].tolist() == [False, True, True]


@pytest.mark.parametrize("policy", [drop.LeastMedian(), drop.Consensus(1.0)])
def test_rejection_by_samples_finds_the_third_that_lies(policy):
    rng = RNG(5)
    x = rng.uniform(-5, 5, (90, 3))
    y = moved(x, pose()) + rng.normal(0, 0.005, x.shape)
    y[60:] += rng.uniform(0.5, 3, (30, 3))
    pairs = pairs_of(np.zeros(90), model=x, reference=y)
    keep, _ = policy(pairs, rng)
    assert keep[:60].mean() > 0.9 and not keep[60:].any()


def test_samples_of_a_line_reject_nobody():
    x = np.linspace(0, 1, 20)[:, None] * [1.0, 2.0, 3.0]
    for policy in (drop.LeastMedian(), drop.Consensus()):
        assert policy(pairs_of(np.zeros(20), model=x, reference=x), RNG(0))[0].all()


def test_weights_fall_with_distance_noise_and_doubt():
    pairs = pairs_of([0.0, 1.0, 2.0], variance=np.array([1.0, 4.0, 0.25]))
    assert Alike()(pairs).tolist() == [1, 1, 1]
    assert ByDistance()(pairs) == pytest.approx([1.0, 0.505, 0.01])
    assert ByNoise()(pairs) == pytest.approx([1.0, 0.25, 4.0])
    assert ByNormals()(pairs).tolist() == [1, 1, 1]
    up = pairs_of(np.zeros(50), model=np.r_[np.full(49, 0.01), 9.0][:, None] * [0, 0, 1.0])
    weights = Tukey()(up)
    assert weights[-1] == 0 and weights[:-1].min() > 0.8


@pytest.mark.parametrize("policy", [
    PointToPoint("svd"), PointToPoint("unit-quaternion"), PointToPoint("dual-quaternion"), Scaled(), PointToPlane(),
    Symmetric(), PlaneToPlane(),
])  # fmt: skip
def test_minimisers_find_a_small_motion_far_from_the_origin(policy, frame):
    """Partners are exact: closed forms end in one step, linearised ones to second order of 0.2 degrees."""
    T = pose((0.2, -0.1, 0.15), (0.02, 0.01, -0.03))
    some = np.flatnonzero(frame.whole)[::11]
    far = np.array([300.0, -200.0, 900.0])
    x, n = frame.points[some] + far, frame.normals[some]
    start = x @ T[:3, :3].T + T[:3, 3] - (T[:3, :3] @ far - far)
    pairs = pairs_of(
        np.zeros(len(x)), model=x, reference=start, model_normals=n, reference_normals=n @ T[:3, :3].T,
        variance=np.full(len(x), 1e-8),
    )  # fmt: skip
    found = policy(pairs, np.ones(len(x)))
    exact = isinstance(policy, PointToPoint | Scaled)
    assert np.abs(apply(found, x) - start).max() < (1e-9 if exact else 2e-4)


def test_scale_is_kept_within_its_bounds(frame):
    some = np.flatnonzero(frame.whole)[::11]
    x = frame.points[some]
    for scale, wanted in ((1.2, 1.2), (3.0, 2.0), (0.1, 0.5)):
        T = Scaled()(pairs_of(np.zeros(len(x)), model=x, reference=scale * x), np.ones(len(x)))
        assert np.cbrt(np.linalg.det(T[:3, :3])) == pytest.approx(wanted)


def test_surface_of_the_thesis_has_bumps():
    assert np.ptp(height(*np.meshgrid(np.linspace(-6, 6, 50), np.linspace(-6, 6, 50)))) > 2
