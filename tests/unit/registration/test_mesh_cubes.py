"""Marching cubes: every field of signs gives a closed manifold; a sphere comes out as one."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from fringed_plugins.registration.meshing.cubes import joined, march, table, weld
from fringed_plugins.registration.meshing.triangles import fanned, topology, vertex_normals


def surface(values):
    found = weld(*march(values[None], np.zeros((1, 3), np.int64)))
    return found.vertices, found.faces


def closed(values):
    """Return the field with a border that is outside."""
    out = values.copy()
    for axis in range(3):
        np.moveaxis(out, axis, 0)[[0, -1]] = 1.0
    return out


def test_every_case_is_triangulated():
    edges, count = table()
    assert count[0] == count[255] == 0 and count[1] == 1 and count.max() <= 6
    assert all((edges[case, : count[case]] >= 0).all() for case in range(256))


def test_random_signs_give_closed_manifold_edges():
    rng = np.random.default_rng(0)
    for smoothing in (0.0, 0.7, 1.5):  # with none all 256 cases and all pairs of them occur
        values = closed(gaussian_filter(rng.normal(size=(32, 32, 32)), smoothing))
        _, faces = surface(values)
        found = topology(faces)
        assert found.closed and found.boundary_edges == 0


def test_sphere_is_a_sphere():
    x = np.stack(np.meshgrid(*[np.arange(24.0)] * 3, indexing="ij"), axis=-1) - 11.37
    vertices, faces = surface(np.linalg.norm(x, axis=-1) - 8.0)
    found = topology(faces)
    assert found.closed and found.euler == 2 and found.parts == 1
    off = np.linalg.norm(vertices - 11.37, axis=1) - 8.0
    assert np.abs(off).max() < 0.02  # 1 / (8 r) of linear interpolation
    normals = vertex_normals(vertices, faces)
    outward = (normals * (vertices - 11.37)).sum(1) / (8.0 + off)
    assert outward.min() > 0.98


def test_cells_with_an_unknown_corner_are_left_out():
    x = np.stack(np.meshgrid(*[np.arange(24.0)] * 3, indexing="ij"), axis=-1) - 11.37
    values = np.linalg.norm(x, axis=-1) - 8.0
    values[..., 12:] = np.nan
    vertices, faces = surface(values)
    found = topology(faces)
    assert found.manifold and not found.closed and found.euler == 1 and found.parts == 1
    assert vertices[:, 2].max() <= 11.0


def test_fans_that_meet_in_a_point_are_parted():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 3, 4]], np.int32)
    assert not topology(faces).manifold
    taken, parted = fanned(faces, np.ones(5, bool))
    assert topology(parted).manifold and len(taken) == 6
    assert np.allclose(vertices[taken][parted], vertices[faces])


def test_blocks_join_to_one_surface():
    x = np.stack(np.meshgrid(*[np.arange(17.0)] * 3, indexing="ij"), axis=-1) - 7.63
    values = np.linalg.norm(x, axis=-1) - 6.0
    corners = [np.array([[i, j, k]]) * 8 for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    cut = [values[tuple(slice(a, a + 9) for a in corner[0])][None] for corner in corners]
    found = joined([weld(*march(part, corner)) for part, corner in zip(cut, corners, strict=True)])
    whole = weld(*march(values[None], np.zeros((1, 3), np.int64)))
    assert topology(found.faces).closed and np.array_equal(found.keys, whole.keys)
    assert not found.rim.any() and not found.parts.any() and np.allclose(found.vertices, whole.vertices)


def test_two_cubes_that_touch_in_an_edge_stay_apart():
    values = np.ones((8, 8, 8))
    values[2:4, 2:4, 2:5] = values[4:6, 4:6, 2:5] = -1.0
    found = topology(surface(values)[1])
    assert found.closed and found.parts == 2 and found.euler == 4
