"""The three closed forms against known motions, each other, noise, weights and sets that determine nothing."""

from __future__ import annotations

import numpy as np
import pytest

from fringed_plugins.registration.minimisers import MINIMISERS, by_svd
from fringed_plugins.registration.transforms import apply, checked, inverse, rigid, rotation, rotation_angle


def cloud(n=60, seed=0):
    return np.random.default_rng(seed).normal(0, (80, 100, 30), (n, 3)) + np.array([5, -8, 1000])


MOTIONS = [
    rigid(rotation(v), t)
    for v, t in (
        ((0, 0, 0), (0, 0, 0)),
        ((0.3, -0.2, 0.5), (10, -20, 30)),
        ((3.0, 0.4, -0.2), (0, 500, -1e3)),
        ((0, np.pi, 0), (1, 2, 3)),
    )
]


@pytest.mark.parametrize("name", MINIMISERS)
@pytest.mark.parametrize("T", MOTIONS)
def test_exact_pairs_give_the_exact_motion(name, T):
    x = cloud()
    found = MINIMISERS[name](x, apply(T, x))
    assert np.abs(apply(found, x) - apply(T, x)).max() < 1e-9  # mm, of points 2 m away


@pytest.mark.parametrize("seed", range(5))
def test_all_forms_agree_to_rounding_with_noise_and_weights(seed):
    rng = np.random.default_rng(seed)
    x = cloud(seed=seed)
    y = apply(MOTIONS[1], x) + rng.normal(0, 3, x.shape)
    w = rng.uniform(0, 1, len(x))
    found = [minimise(x, y, w) for minimise in MINIMISERS.values()]
    for other in found[1:]:
        assert np.abs(other[:3, :3] - found[0][:3, :3]).max() < 1e-12
        assert np.abs(other[:3, 3] - found[0][:3, 3]).max() < 1e-12 * 1000 * 3  # the same rotation at 1 m, 3 terms


@pytest.mark.parametrize("name", MINIMISERS)
def test_nothing_near_is_better(name):
    rng = np.random.default_rng(3)
    x = cloud()
    y = apply(MOTIONS[1], x) + rng.normal(0, 2, x.shape)
    best = MINIMISERS[name](x, y)

    def cost(T):
        return ((apply(T, x) - y) ** 2).sum()

    middle = y.mean(0)
    for small in np.vstack([np.eye(6), -np.eye(6)]) * 1e-4:
        nudged = rigid(np.eye(3), middle) @ rigid(rotation(small[:3]), small[3:]) @ rigid(np.eye(3), -middle) @ best
        assert cost(nudged) > cost(best)


@pytest.mark.parametrize("name", MINIMISERS)
def test_points_in_a_plane_turn_and_never_mirror(name):
    x = cloud()
    x[:, 2] = 1000
    found = MINIMISERS[name](x, apply(MOTIONS[2], x))
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1, abs=1e-12)
    assert rotation_angle(inverse(found) @ MOTIONS[2]) < 1e-9


@pytest.mark.parametrize("name", MINIMISERS)
@pytest.mark.parametrize(
    ("x", "says"),
    [
        (np.zeros((0, 3)), "at least 3"),
        (np.eye(3)[:2], "at least 3"),
        (np.arange(30.0)[:, None] * [1, 2, 3], "one line"),
        (np.ones((9, 3)), "one line or in one point"),
        (np.full((9, 3), np.nan), "NaN"),
        (np.zeros((9, 2)), "shapes"),
    ],
)
def test_sets_that_determine_nothing_are_refused(name, x, says):
    with pytest.raises(ValueError, match=says):
        MINIMISERS[name](x, x)


def test_weights_choose_and_bad_ones_are_refused():
    x = cloud()
    y = apply(MOTIONS[1], x)
    y[:20] += 100
    w = np.ones(len(x))
    w[:20] = 0
    assert np.abs(by_svd(x, y, w) - MOTIONS[1]).max() < 1e-9
    with pytest.raises(ValueError, match="negative"):
        by_svd(x, y, -w - 1)


@pytest.mark.parametrize("bad", [np.eye(3), np.diag([1, 1, -1, 1.0]), np.eye(4) * 2, np.full((4, 4), np.nan), "four"])
def test_what_is_not_rigid_is_no_start(bad):
    with pytest.raises(ValueError, match="T_reference_model"):
        checked(bad)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, np.pi - 1e-6])
def test_rotation_vectors_keep_small_and_large_angles(angle):
    T = rigid(rotation(np.array([0.6, -0.8, 0]) * angle), np.zeros(3))
    assert np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() < 1e-15
    assert rotation_angle(T) == pytest.approx(angle, rel=1e-9, abs=1e-15)
