"""Meshes from files: what was written is read, and what is broken is refused with a reason."""

import struct

import numpy as np
import pytest

from fringed.data import Mesh, Model
from fringed.errors import DataError
from fringed.simulation.shapes.files import MeshOptions, mesh_file
from fringed.surface_files.reading import product_of_file, read_surface

VERTICES = np.array([[0.0, 0, 0], [10, 0, 0], [10, 20, 0], [0, 20, 5]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def ply_ascii():
    head = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in VERTICES)
    return (head + rows + "4 0 1 2 3\n").encode()


def ply_binary(order, colours=False, quad=False):
    name = {"<": "little", ">": "big"}[order]
    head = f"ply\nformat binary_{name}_endian 1.0\nelement vertex 4\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) if colours else ""
    count = 1 if quad else 2
    head += f"element face {count}\nproperty list uchar uint vertex_indices\nend_header\n"
    body = b"".join(struct.pack(order + "3d", *v) + (bytes([255, 255, 255]) if colours else b"") for v in VERTICES)
    faces = [[0, 1, 2, 3]] if quad else FACES.tolist()
    body += b"".join(struct.pack(f"{order}B{len(f)}I", len(f), *f) for f in faces)
    return head.encode() + body


def stl_binary():
    raw = bytes(80) + struct.pack("<I", 2)
    for face in FACES:
        raw += struct.pack("<12f", 0, 0, 1, *VERTICES[face].ravel()) + b"\0\0"
    return raw


def stl_ascii():
    text = "solid thing\n"
    for face in FACES:
        text += "facet normal 0 0 1\nouter loop\n"
        text += "".join("vertex {} {} {}\n".format(*VERTICES[i]) for i in face) + "endloop\nendfacet\n"
    return (text + "endsolid thing\n").encode()


def obj():
    return (
        "# quad\n" + "".join("v {} {} {}\n".format(*v) for v in VERTICES) + "vn 0 0 1\nf 1//1 2//1 3//1 -1//1\n"
    ).encode()


GOOD = {
    "ascii.ply": ply_ascii(),
    "little.ply": ply_binary("<"),
    "big.ply": ply_binary(">"),
    "quad.ply": ply_binary("<", quad=True),
    "colours.PLY": ply_binary("<", colours=True),
    "binary.stl": stl_binary(),
    "ascii.stl": stl_ascii(),
    "plain.obj": obj(),
}


@pytest.mark.parametrize("name", GOOD)
def test_every_format_gives_the_same_triangles(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(GOOD[name])
    read = read_surface(path)
    np.testing.assert_allclose(read.vertices[read.faces], VERTICES[FACES])
    assert (read.albedo is not None) == name.startswith("colours")
    mesh = product_of_file(path)
    assert isinstance(mesh, Mesh) and mesh.faces.dtype == np.int32
    np.testing.assert_allclose(mesh.vertices_mm[mesh.faces], VERTICES[FACES])


@pytest.mark.parametrize("name", GOOD)
def test_a_truncated_file_is_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(GOOD[name][: -len(GOOD[name]) // 8])
    with pytest.raises(DataError, match=name):
        mesh_file(MeshOptions(path=str(path)))


@pytest.mark.parametrize("name", GOOD)
def test_noise_is_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(np.random.default_rng(1).bytes(600))
    with pytest.raises(DataError, match=name):
        mesh_file(MeshOptions(path=str(path)))


def test_size_and_place_can_be_chosen(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(ply_ascii())
    shape = mesh_file(MeshOptions(path=str(path), scale=10.0))
    np.testing.assert_allclose(shape.vertices_mm.max(axis=0), [50, 100, 25])
    as_is = mesh_file(MeshOptions(path=str(path), centre=False))
    np.testing.assert_allclose(as_is.vertices_mm, VERTICES)


def test_a_missing_file_and_another_format_are_named(tmp_path):
    with pytest.raises(DataError, match="there is no file"):
        read_surface(tmp_path / "none.ply")
    with pytest.raises(DataError, match=r"\.ply, \.stl, \.obj"):
        read_surface(tmp_path / "a.step")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(DataError, match="cannot be read"):
        read_surface(tmp_path / "folder.ply")


POINTS = {
    "normals.ply": "ply\nformat ascii 1.0\nelement vertex 4\n"
    + "".join(f"property float {n}\n" for n in ("x", "y", "z", "nx", "ny", "nz"))
    + "property uchar intensity\nend_header\n"
    + "".join(f"{x} {y} {z} 0 0 1 51\n" for x, y, z in VERTICES),
    "normals.xyz": "# by hand\n" + "".join(f"{x} {y} {z} 0 0 1\n" for x, y, z in VERTICES),
    "commas.xyz": "".join(f"{x}, {y}, {z}\n" for x, y, z in VERTICES),
    "points.obj": "".join("v {} {} {}\n".format(*v) for v in VERTICES),
}


@pytest.mark.parametrize("name", POINTS)
def test_points_without_triangles_are_a_model(tmp_path, name):
    path = tmp_path / name
    path.write_text(POINTS[name])
    model = product_of_file(path)
    assert isinstance(model, Model) and model.faces is None
    np.testing.assert_allclose(model.points_mm, VERTICES)
    assert model.normals.tolist() == [[0, 0, 1.0 if name.startswith("normals") else 0]] * 4
    assert model.intensity.tolist() == [51 if name == "normals.ply" else 0] * 4
    if name.endswith((".ply", ".obj")):
        with pytest.raises(DataError, match="triangles"):
            mesh_file(MeshOptions(path=str(path)))


@pytest.mark.parametrize("text", ["", "1 2\n3 4\n", "1 2 3\n1 2\n", "a b c\n"])
def test_lines_that_are_no_points_are_refused(tmp_path, text):
    path = tmp_path / "a.xyz"
    path.write_text(text)
    with pytest.raises(DataError, match="XYZ"):
        read_surface(path)
