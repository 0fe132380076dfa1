"""One mesh of registered views, against the closed surface that they saw."""

from __future__ import annotations

import numpy as np
import pytest
from closed_head import above, distance, grey, pose, see
from scipy.spatial import cKDTree

from fringed_plugins.registration.meshing.integrate import integrate
from fringed_plugins.registration.meshing.triangles import topology
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.transforms import inverse, rigid

NOISE = 0.05
PITCH = 1.8
SIDES = [(60 * k, 20 * (-1) ** k) for k in range(6)] + [(0, 80), (180, -80)]  # round, from above, from below


@pytest.fixture(scope="module")
def views():
    size = (148, 128)
    return [see(pose(*side), PITCH, size, NOISE, seed) for seed, side in enumerate(SIDES)]


@pytest.fixture(scope="module")
def given(views):
    surfaces = [prepare(view.xyz_mm, name=f"view {k}") for k, view in enumerate(views)]
    poses = [views[0].T_camera_object @ inverse(view.T_camera_object) for view in views]
    return surfaces, [intensity(view) for view in views], np.array(poses)


@pytest.fixture(scope="module")
def opened(given):
    return integrate(*given)


def intensity(view):
    x = in_object(view.clean_mm, view)
    return np.where(np.isfinite(x[..., 0]), np.rint(grey(np.nan_to_num(x))), 0).astype(np.uint8)


def in_object(x, view):
    back = inverse(view.T_camera_object)
    return x @ back[:3, :3].T + back[:3, 3]


def test_mesh_is_the_surface(views, opened):
    off, normals = distance(in_object(opened.vertices.astype(float), views[0]))
    # smooth patches and several views: a fraction of one view's noise, and no layer beside the surface
    assert np.sqrt(np.mean(off**2)) < 0.5 * NOISE and abs(off.mean()) < 0.1 * NOISE and np.abs(off).max() < 0.5
    turned = opened.normals @ views[0].T_camera_object[:3, :3]
    angle = np.degrees(np.arccos(np.clip((turned * normals).sum(1), -1, 1)))
    assert np.median(angle) < 1 and np.percentile(angle, 99) < 6
    assert topology(opened.faces).manifold and opened.faces.dtype == np.int32
    assert (opened.confidence > 0).mean() > 0.99


def test_intensity_is_that_of_the_surface(views, opened):
    off = opened.intensity - grey(in_object(opened.vertices.astype(float), views[0]))
    assert np.percentile(np.abs(off), 99) < 3  # a slope of 6 a mm, half a unit of rounding


def test_confidence_is_an_inverse_variance(views, opened):
    off, _ = distance(in_object(opened.vertices.astype(float), views[0]))
    low, high = np.percentile(opened.confidence, (20, 80))
    assert np.std(off[opened.confidence < low]) > 1.2 * np.std(off[opened.confidence > high])


def test_watertight_mesh_is_closed_and_manifold(views, given):
    mesh = integrate(*given, watertight=True)
    found = topology(mesh.faces)
    assert found.closed and found.manifold and found.euler == 2 and found.parts == 1
    known = mesh.confidence > 0
    off, _ = distance(in_object(mesh.vertices.astype(float), views[0]))
    assert np.sqrt(np.mean(off[known] ** 2)) < NOISE and 0 < (~known).mean() < 0.1
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) - mesh.vertices.mean(0) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    ball = np.random.default_rng(0).uniform(-1, 1, (200_000, 3)) * 130
    truth = (above(ball) < 0).mean() * 260.0**3
    assert abs(volume / truth - 1) < 0.01  # 0.3 % of sampling; positive: faces look outwards


@pytest.mark.parametrize("chosen", [[0], [0, 1], [0, 3]])
def test_few_views_are_closed_all_the_same(given, chosen):
    surfaces, images, poses = given
    mesh = integrate([surfaces[k] for k in chosen], [images[k] for k in chosen], poses[chosen], 3.0, watertight=True)
    found = topology(mesh.faces)
    assert found.closed and found.manifold and (mesh.confidence == 0).any()


def test_open_mesh_ends_where_nobody_has_looked(views, given):
    surfaces, images, poses = given
    mesh = integrate(surfaces[:1], images[:1], poses[:1])
    found = topology(mesh.faces)
    assert found.manifold and found.boundary_edges > 100
    x = mesh.vertices.astype(float)
    seen = surfaces[0].xyz[surfaces[0].valid] + surfaces[0].origin
    assert cKDTree(seen).query(x)[0].max() < 3 * PITCH


@pytest.mark.parametrize("moved", [False, True])
def test_rows_that_run_upwards_do_not_turn_the_mesh_inside_out(given, views, moved):
    _, images, poses = given
    chosen = [0, 2, 4]
    away = np.array([30.0, -20.0, -810.0], np.float32) if moved else np.zeros(3, np.float32)  # origin in the object
    upward = [prepare(views[k].xyz_mm[::-1] + away, name=f"view {k}") for k in chosen]
    back = [poses[k] @ rigid(np.eye(3), -away) for k in chosen]
    mesh = integrate(upward, [images[k][::-1] for k in chosen], back, 3.0, watertight=True)
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(float) - mesh.vertices.mean(0) for k in range(3))
    assert topology(mesh.faces).closed and np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0
    known = mesh.confidence > 0
    off, normals = distance(in_object(mesh.vertices[known].astype(float), views[0]))
    assert np.sqrt(np.mean(off**2)) < 2 * NOISE
    assert ((mesh.normals[known] @ views[0].T_camera_object[:3, :3]) * normals).sum(1).mean() > 0.98


def test_unit_of_length_does_not_matter(given):
    surfaces, images, poses = given
    shrunk = [prepare((s.xyz + s.origin).astype(np.float32) * np.float32(1e-3), ~s.valid) for s in surfaces[:2]]
    cropped = [
        i[s.corner[0] : s.corner[0] + s.valid.shape[0], s.corner[1] : s.corner[1] + s.valid.shape[1]]
        for i, s in zip(images[:2], surfaces[:2], strict=True)
    ]
    small = [rigid(T[:3, :3], 1e-3 * T[:3, 3]) for T in poses[:2]]
    a = integrate(surfaces[:2], images[:2], poses[:2], 2.0)
    b = integrate(shrunk, cropped, small, 2e-3)
    assert abs(len(a.vertices) / len(b.vertices) - 1) < 0.05  # depth jumps are judged in float32
    assert np.allclose(a.vertices.mean(0), 1e3 * b.vertices.mean(0), atol=0.5)
    assert np.isclose(np.median(a.confidence), 1e-6 * np.median(b.confidence), rtol=0.1)


def test_deterministic_and_independent_of_threads(given):
    surfaces, images, poses = given
    one = integrate(surfaces[:2], images[:2], poses[:2], 2.5)
    two = integrate(surfaces[:2], images[:2], poses[:2], 2.5, threads=2)
    assert np.array_equal(one.vertices, two.vertices) and np.array_equal(one.faces, two.faces)


def test_report_is_heard_and_may_stop(given):
    surfaces, images, poses = given
    heard = []
    integrate(surfaces[:2], images[:2], poses[:2], 3.0, watertight=True, report=lambda f, text: heard.append(f))
    assert len(heard) > 50 and min(heard) >= 0 and max(heard) == heard[-1] == 1.0

    def stop(fraction, text):
        if fraction > 0.3:
            raise RuntimeError(text)

    with pytest.raises(RuntimeError, match="distances to the view"):
        integrate(surfaces[:2], images[:2], poses[:2], 3.0, report=stop)


def test_impossible_requests_are_refused(given):
    surfaces, images, poses = given
    with pytest.raises(ValueError, match="same number of each"):
        integrate(surfaces, images[:2], poses)
    with pytest.raises(ValueError, match="expected at least a quarter"):
        integrate(surfaces[:1], images[:1], poses[:1], 0.1)
    with pytest.raises(ValueError, match="expected at least a quarter"):
        integrate(surfaces[:1], images[:1], poses[:1], float("nan"))
    with pytest.raises(ValueError, match="expected that of its whole range image"):
        integrate(surfaces[:1], [images[0][:20]], poses[:1])
    with pytest.raises(ValueError, match="not rigid"):
        integrate(surfaces[:1], images[:1], 2 * poses[:1])


def test_too_fine_a_voxel_says_which_one_fits(given, monkeypatch):
    from fringed_plugins.registration.meshing import volume

    surfaces, images, poses = given
    monkeypatch.setattr(volume, "MOST_BLOCKS", 300)
    with pytest.raises(ValueError, match="needs more than 300 blocks") as caught:
        integrate(surfaces[:2], images[:2], poses[:2], 1.0)
    fits = float(str(caught.value).rsplit("one of ", 1)[1].split()[0])
    integrate(surfaces[:2], images[:2], poses[:2], 1.15 * fits)
