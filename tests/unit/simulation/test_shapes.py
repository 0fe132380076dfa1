"""The objects: whole, of the size that they claim, and refused with a reason where they cannot be."""

import numpy as np
import pytest

from fringed.config.simulated import SceneConfig
from fringed.data import Mesh
from fringed.errors import ConfigurationError, DataError
from fringed.simulation.shapes import OBJECTS, shape_maker
from fringed.simulation.shapes.formula import evaluate


def made(name, mesh=None, **options):
    return shape_maker(SceneConfig(object=name, options=options), mesh)()


def open_edges(faces):
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int((counts != 2).sum())


def test_a_head_is_a_head():
    shape = made("face", columns=160, rows=120)
    low, high = shape.vertices_mm.min(axis=0), shape.vertices_mm.max(axis=0)
    width, height, depth = high - low
    assert 140 < width < 190
    assert 220 < height < 260
    assert 180 < depth < 240
    tip = shape.vertices_mm[shape.vertices_mm[:, 2].argmax()]
    assert abs(tip[0]) < 2  # the nose is in the middle and what stands out furthest
    assert -40 < tip[1] < 0
    assert shape.albedo.min() > 0.4
    assert shape.albedo.max() <= 1.0


def test_a_head_is_symmetrical_deterministic_and_one_persons():
    shape = made("face", columns=96, rows=64)
    again = made("face", columns=96, rows=64)
    other = made("face", columns=96, rows=64, seed=5)
    assert (shape.vertices_mm == again.vertices_mm).all()
    apart = np.linalg.norm(shape.vertices_mm - other.vertices_mm, axis=1)
    assert 1.0 < apart.max() < 40.0
    grid = shape.vertices_mm.reshape(64, 96, 3)
    mirrored = grid[:, np.r_[0, 95:0:-1]] * [-1, 1, 1]
    np.testing.assert_allclose(grid, mirrored, atol=0.05)


def test_a_head_is_closed():
    shape = made("face", columns=96, rows=64)
    # crown and neck are one point each, told 96 times
    for pole in (shape.vertices_mm[:96], shape.vertices_mm[-96:]):
        assert (np.ptp(pole, axis=0) < 1e-3).all()
    one = np.arange(64 * 96)
    one[:96], one[-96:] = 0, 64 * 96 - 1
    faces = one[shape.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    assert open_edges(faces[whole]) == 0


def test_a_hand_has_five_fingers_on_a_slab():
    shape = made("hand", pitch_mm=1.0)
    grid = shape.vertices_mm[: 251 * 211].reshape(251, 211, 3)
    across = grid[np.argmin(np.abs(grid[:, 0, 1] - 45))][:, 2] > 4.0  # through four fingers
    assert np.count_nonzero(np.diff(across.astype(int)) == 1) == 4
    thumb = grid[np.argmin(np.abs(grid[:, 0, 1] - 0))][:, 2] > 4.0
    assert np.count_nonzero(np.diff(thumb.astype(int)) == 1) == 2
    assert 15 < shape.vertices_mm[:, 2].max() < 40
    assert shape.vertices_mm[:, 2].min() == -15


def test_normals_point_out_of_a_freeform_surface():
    shape = made("freeform", formula="0.5*x - 0.25*y", width_mm=20, height_mm=20, pitch_mm=5)
    expected = np.array([-0.5, 0.25, 1]) / np.linalg.norm([-0.5, 0.25, 1])
    np.testing.assert_allclose(shape.normals, np.tile(expected, (len(shape.normals), 1)), atol=1e-9)


def test_a_formula_means_what_it_says():
    x, y = np.meshgrid(np.linspace(-3, 3, 7), np.linspace(-2, 2, 5))
    np.testing.assert_allclose(evaluate("-2*x**2 + sin(pi*y)/exp(x)", x, y), -2 * x**2 + np.sin(np.pi * y) / np.exp(x))
    np.testing.assert_allclose(evaluate("3", x, y), np.full_like(x, 3))


@pytest.mark.parametrize(
    "formula",
    ["__import__('os')", "x.real", "open('f')", "z + 1", "x if y else 1", "[x]", "lambda: 1", "x +", "'a'", "True",
     "sin(x, where=y)", "sqrt(x)", "1/0", "9**9**9**9", "(" * 500 + "x" + ")" * 500, "x" * 3000, "sin()", ""],
)  # fmt: skip
def test_anything_else_than_a_formula_is_refused(formula):
    x = np.linspace(-1, 1, 4)
    with pytest.raises(ValueError, match=r"formula|finite"):
        evaluate(formula, x, x)


def test_a_wrong_formula_is_a_configuration_error():
    with pytest.raises(ConfigurationError, match="open"):
        made("freeform", formula="open('secret')")
    with pytest.raises(ConfigurationError, match="pitch_mm"):
        made("freeform", pitch_mm=0.001)


def test_an_unknown_object_names_those_that_exist():
    with pytest.raises(ConfigurationError) as caught:
        made("teapot")
    assert all(name in str(caught.value) for name in OBJECTS)


def test_every_wrong_option_is_named():
    with pytest.raises(ConfigurationError) as caught:
        made("sphere", radius_mm=-1.0, colour="red")
    assert len(caught.value.problems) == 2


def test_a_plug_ins_mesh_is_taken_whatever_its_name():
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]], np.int32))
    assert len(made("anything", mesh).faces) == 1


@pytest.mark.parametrize(
    ("vertices", "faces", "says"),
    [
        (np.zeros((3, 3)), np.zeros((0, 3)), "no triangle"),
        (np.eye(3), [[0, 1, 3]], "vertices 0 to 2"),
        (np.eye(3), [[0, 1, -1]], "vertices -1"),
        (np.array([[0.0, 0, np.nan], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]], "finite"),
        (np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), [[0, 1, 2]], "degenerate"),
    ],
)
def test_a_mesh_that_contradicts_itself_is_refused(vertices, faces, says):
    with pytest.raises(DataError, match=says):
        made("anything", Mesh(np.asarray(vertices, float), np.asarray(faces, np.int32)))
