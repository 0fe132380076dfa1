"""All poses at once, on views round a closed head of known shape and poses."""

from __future__ import annotations

import numpy as np
import pytest
from closed_head import distance, pose, see

from fringed_plugins.registration.merging import merge
from fringed_plugins.registration.plane import motion
from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import inverse, rigid
from fringed_plugins.registration.views.graph import edges_of
from fringed_plugins.registration.views.joint import Wish, refine_all
from fringed_plugins.registration.views.motions import logarithm
from fringed_plugins.registration.views.poses import agree

COUNT = 8
NOISE = 0.05


@pytest.fixture(scope="module")
def views():
    return [see(pose(360 / COUNT * k, 12 * (-1) ** k), noise_mm=NOISE, seed=k) for k in range(COUNT)]


@pytest.fixture(scope="module")
def truth(views):
    return [views[0].T_camera_object @ inverse(view.T_camera_object) for view in views]


@pytest.fixture(scope="module")
def surfaces(views):
    return [prepare(view.xyz_mm, name=f"view {k}") for k, view in enumerate(views)]


@pytest.fixture(scope="module")
def pairs(surfaces, truth):
    found = {}
    for k in range(COUNT):
        i, j = k, (k + 1) % COUNT
        found[i, j] = register(surfaces[i], surfaces[j], Options(inverse(truth[i]) @ truth[j], search=""))
    return found


@pytest.fixture(scope="module")
def joint(surfaces, pairs):
    return refine_all(surfaces, agree(COUNT, edges_of(pairs)).T_model_view)


def off(poses, truth, views):
    """Return the RMS error of all views' points in mm."""
    squares = []
    for k, view in enumerate(views):
        x = view.clean_mm[np.isfinite(view.clean_mm[..., 0])][::11]
        D = poses[k] - truth[k]
        squares.append(((x @ D[:3, :3].T + D[:3, 3]) ** 2).sum(1).mean())
    return float(np.sqrt(np.mean(squares)))


def test_loop_is_shared_out_by_the_surfaces(views, surfaces, truth, pairs, joint):
    chained = {0: np.eye(4)}
    for k in range(COUNT - 1):
        chained[k + 1] = chained[k] @ pairs[k, k + 1].T_reference_model
    assert joint.converged and sorted(joint.T_model_view) == list(range(COUNT))
    assert off(joint.T_model_view, truth, views) < 0.5 * off(chained, truth, views)
    # 10 thousand points of 0.05 mm a view, a lever of 100 mm: some micrometres of noise; the rest is curvature
    assert off(joint.T_model_view, truth, views) < 0.04
    assert all(fit.rms_mm < 1.5 * fit.expected_mm for fit in joint.pairs)


def test_covariance_tells_the_size_of_the_error(truth, joint):
    far = []
    for k in range(1, COUNT):
        error = logarithm(joint.T_model_view[k] @ inverse(truth[k]))
        far.append(error @ np.linalg.solve(joint.covariance_of(k), error) / 6)
    assert 0.2 < np.sqrt(np.mean(far)) < 4  # 1 from noise alone; curvature between points of 1.8 mm is the rest
    assert not joint.covariance_of(0).any() and np.linalg.eigvalsh(joint.covariance)[0] > 0


def test_disturbed_poses_come_back(views, surfaces, truth):
    rng, four = np.random.default_rng(3), range(4)
    about = rigid(np.eye(3), surfaces[0].origin)
    start = {0: truth[0]}
    for k in four[1:]:
        small = np.r_[rng.normal(0, 0.01, 3), rng.normal(0, 1.0, 3)]  # 0.6 degrees, 1 mm
        start[k] = about @ motion(small) @ inverse(about) @ truth[k]
    again, exact = refine_all(surfaces, start), refine_all(surfaces, {k: truth[k] for k in four})
    assert again.converged and again.rms_mm < again.rms_before_mm / 3
    for k in four:
        assert np.allclose(again.T_model_view[k], exact.T_model_view[k], atol=0.01)
    assert off(start, truth[:4], views[:4]) > 20 * off(again.T_model_view, truth[:4], views[:4])


def test_merged_model_is_the_head(views, surfaces, joint):
    grey = [np.full(view.xyz_mm.shape[:2], 90, np.uint8) for view in views]
    cloud = merge(surfaces, grey, np.array([joint.T_model_view[k] for k in range(COUNT)]))
    back = inverse(views[0].T_camera_object)
    off_mm, _ = distance(cloud.points @ back[:3, :3].T + back[:3, 3])
    assert np.sqrt(np.mean(off_mm**2)) < NOISE


def test_two_units_of_length_give_the_same(surfaces, views, truth):
    three = [0, 1, 2]
    shrunk = [prepare(views[k].xyz_mm * np.float32(1e-3), name=f"view {k}") for k in three]
    small = {k: rigid(truth[k][:3, :3], 1e-3 * truth[k][:3, 3]) for k in three}
    a, b = refine_all(surfaces[:3], {k: truth[k] for k in three}), refine_all(shrunk, small)
    for k in three:
        assert np.allclose(a.T_model_view[k][:3, 3], 1e3 * b.T_model_view[k][:3, 3], atol=2e-3)


def test_what_the_surface_does_not_hold_is_said():
    y, x = np.mgrid[-30.0:31.0, -30.0:31.0]
    ball = np.dstack([x, y, 300 - np.sqrt(60.0**2 - x**2 - y**2)])
    noise = np.random.default_rng(0).normal(0, 0.02, (2, *x.shape))
    both = [prepare(ball + np.dstack([0 * x, 0 * x, one]), name=f"ball {k}") for k, one in enumerate(noise)]
    found = refine_all(both, {0: np.eye(4), 1: np.eye(4)})
    assert not found.converged and "ball 1 is not held in every direction" in found.reason
    assert found.covariance is None and found.covariance_of(1) is None


def test_report_is_heard_and_may_stop(surfaces, truth):
    heard = []
    refine_all(surfaces[:2], {0: truth[0], 1: truth[1]}, report=lambda f, text: heard.append(f))
    assert len(heard) > 20 and heard[-1] == 1.0 and min(heard) >= 0

    def stop(fraction, text):
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        refine_all(surfaces[:2], {0: truth[0], 1: truth[1]}, report=stop)


def test_impossible_requests_are_refused(surfaces, truth):
    with pytest.raises(ValueError, match="two or more of 8 views"):
        refine_all(surfaces, {0: np.eye(4)})
    with pytest.raises(ValueError, match="the reference among them"):
        refine_all(surfaces, {1: np.eye(4), 2: np.eye(4)})
    with pytest.raises(ValueError, match="pair 0-3"):
        refine_all(surfaces, {0: truth[0], 1: truth[1]}, pairs=[(0, 3)])
    with pytest.raises(ValueError, match="not rigid"):
        refine_all(surfaces, {0: truth[0], 1: 2 * truth[1]})
    with pytest.raises(ValueError, match="no two views overlap"):
        refine_all(surfaces, {0: truth[0], 4: truth[4]}, wish=Wish(least_share=0.9))
