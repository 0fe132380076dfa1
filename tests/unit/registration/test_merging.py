"""Chaining and merging of views: the merged cloud against the formula it was seen from."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_relief import errors, head, pose, see
from scipy.spatial import cKDTree

from fringed_plugins.registration.chaining import ChainBrokenError, chain
from fringed_plugins.registration.merging import merge
from fringed_plugins.registration.register import Options
from fringed_plugins.registration.surface import prepare

NOISE = 0.05


@pytest.fixture(scope="module")
def views():
    return [see(T=pose((0, angle, 0)), noise_mm=NOISE, seed=i) for i, angle in enumerate((-25, 0, 25))]


@pytest.fixture(scope="module")
def surfaces(views):
    return [prepare(view.xyz_mm, name=f"view {i}") for i, view in enumerate(views)]


@pytest.fixture(scope="module")
def linked(surfaces):
    return chain(surfaces)


def test_views_are_chained_to_the_first(views, linked):
    assert [(link.view, link.partner) for link in linked.links] == [(1, 0), (2, 1)]
    for i in (1, 2):
        rotation_deg, surface_mm = errors(linked.T_model_view[i], views[0], views[i])
        assert rotation_deg < 0.03 and surface_mm < 0.04


def test_another_view_may_be_the_frame(views, surfaces):
    found = chain(surfaces, first=1)
    assert sorted((link.view, link.partner) for link in found.links) == [(0, 1), (2, 1)]
    assert errors(found.T_model_view[0], views[1], views[0])[1] < 0.04


def test_known_registration_is_used(surfaces, linked):
    known = {(link.partner, link.view): link.alignment for link in linked.links}
    again = chain(surfaces, known=known, report=lambda fraction, text: pytest.fail(f"registered anew: {text}"))
    assert np.array_equal(again.T_model_view[2], linked.T_model_view[2])


def test_merged_cloud_is_the_surface_once(views, surfaces, linked):
    poses = np.array([linked.T_model_view[i] for i in range(3)])
    grey = [np.full(view.xyz_mm.shape[:2], 60 * (i + 1), np.uint8) for i, view in enumerate(views)]
    cloud = merge(surfaces, grey, poses)
    back = np.linalg.inv(views[0].T_camera_object)
    x, n = cloud.points @ back[:3, :3].T + back[:3, 3], cloud.normals @ back[:3, :3].T
    e = 1e-3
    gx = (head(x[:, 0] + e, x[:, 1]) - head(x[:, 0] - e, x[:, 1])) / (2 * e)
    gy = (head(x[:, 0], x[:, 1] + e) - head(x[:, 0], x[:, 1] - e)) / (2 * e)
    tilt = 1 / np.sqrt(1 + gx**2 + gy**2)
    off = (x[:, 2] - head(x[:, 0], x[:, 1])) * tilt
    # fused overlaps have less noise than one view; a bias would be a double layer or a wrong mean
    assert off.std() < NOISE and abs(off.mean()) < 0.005 and np.abs(off).max() < 0.3
    truth = np.c_[gx, gy, -np.ones_like(gx)] * tilt[:, None]
    angle = np.degrees(np.arccos(np.clip((truth * n).sum(1), -1, 1)))
    assert np.median(angle) < 1 and np.allclose(np.linalg.norm(n, axis=1), 1, atol=1e-5)
    assert set(np.unique(cloud.view_index)) == {0, 1, 2}
    assert (cloud.intensity == 60 * (cloud.view_index.astype(int) + 1)).all()
    assert len(x) < 0.55 * sum(s.valid.sum() for s in surfaces)  # three views of nearly the same surface
    crowded = cKDTree(x).query(x, k=2)[0][:, 1] < 0.4  # a third of the pitch: a point twice
    assert crowded.mean() < 0.01
    covered = cKDTree(x).query((views[1].clean_mm @ np.linalg.inv(views[1].T_camera_object)[:3, :3].T)[
        surfaces_inside(views[1])] + np.linalg.inv(views[1].T_camera_object)[:3, 3])[0]  # fmt: skip
    assert np.percentile(covered, 99) < 2.5  # no hole wider than two pitches


def surfaces_inside(view):
    """Return the pixels of a view that are not within its border of four pixels."""
    from scipy.ndimage import binary_erosion

    return binary_erosion(np.isfinite(view.clean_mm[..., 0]), iterations=4)


def test_view_that_registers_nowhere_is_named_or_left_out(surfaces):
    stranger = prepare(see(T=pose((0, 0, 0)), noise_mm=NOISE, seed=9, columns=(0.0, 0.12)).xyz_mm, name="stranger")
    strict = Options(limits=type(Options().limits)(min_overlap=1.01))
    with pytest.raises(ChainBrokenError, match="view 1 does not register to view 0"):
        chain([surfaces[0], stranger], strict)
    loose = chain([surfaces[0], stranger], strict, require=False)
    assert sorted(loose.T_model_view) == [0] and not loose.links[0].alignment.converged


def test_impossible_requests_are_refused(surfaces):
    with pytest.raises(ValueError, match="counted from 0"):
        chain(surfaces, first=3)
    with pytest.raises(ValueError, match="same number"):
        merge(surfaces, [], np.eye(4)[None])
