"""Exported files, read back by independent readers."""

from __future__ import annotations

import io
import re
import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest

from fringed.data import Mesh, Model, PhaseMap, Provenance, RangeImage
from fringed.errors import DataError
from fringed_plugins.exporters_plugin import (
    NpzExporter,
    ObjExporter,
    PcdExporter,
    PlyExporter,
    StlExporter,
    TiffExporter,
    XyzExporter,
    register_exporters,
)


@pytest.fixture
def range_image():
    y, x = np.mgrid[0:6, 0:8].astype(np.float32)
    xyz = np.stack([x, y, 1000 + 0.1 * x], axis=-1)
    xyz[:, 4:, 2] += 30  # a step of 30 mm
    xyz[2, 2] = np.nan
    return RangeImage(xyz, np.isnan(xyz[..., 0]).astype(np.uint8), np.arange(48, dtype=np.uint8).reshape(6, 8),
                      np.full((6, 8), 0.05, np.float32), calibration="abc")  # fmt: skip


@pytest.fixture
def model():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(5, 3)).astype(np.float32)
    faces = np.array([[0, 1, 2], [2, 3, 4]], np.int32)
    return Model(rng.normal(size=(5, 3)).astype(np.float32), normals, np.arange(5, dtype=np.uint8), faces=faces)


def export(cls, product, **params):
    return cls().export(product, cls.Params(**params))


def read_ply(content):
    head, _, body = content.partition(b"end_header\n")
    kinds = {"float": "<f4", "uchar": "u1", "int": "<i4"}
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    count = {m[1]: int(m[2]) for line in lines if (m := re.match(r"element (\w+) (\d+)", line))}
    dtype = np.dtype([(m[2], kinds[m[1]]) for line in lines if (m := re.match(r"property (float|uchar) (\w+)$", line))])
    vertices = np.frombuffer(body, dtype, count["vertex"])
    rest = body[vertices.nbytes :]
    faces = np.frombuffer(rest, np.dtype([("n", "u1"), ("v", "<i4", 3)]), count.get("face", 0))
    assert vertices.nbytes + faces.nbytes == len(body)
    assert (faces["n"] == 3).all()
    return vertices, faces["v"]


def positions(table):
    return np.stack([table["x"], table["y"], table["z"]], axis=1)


def test_ply_of_a_model_has_normals_intensity_and_faces(model):
    vertices, faces = read_ply(export(PlyExporter, model))
    assert np.array_equal(positions(vertices), model.points_mm)
    assert np.array_equal(np.stack([vertices[n] for n in ("nx", "ny", "nz")], axis=1), model.normals)
    assert np.array_equal(vertices["intensity"], model.intensity)
    assert np.array_equal(faces, model.faces)


def test_ply_of_a_range_image_has_its_finite_points_only(range_image):
    vertices, faces = read_ply(export(PlyExporter, range_image))
    assert len(vertices) == 47 and len(faces) == 0
    assert np.array_equal(positions(vertices), range_image.xyz_mm[range_image.rejected == 0])
    assert 18 not in vertices["intensity"]


def test_mesh_of_a_range_image_crosses_neither_holes_nor_steps(range_image):
    vertices, faces = read_ply(export(PlyExporter, range_image, mesh=True))
    corners = positions(vertices)[faces]
    assert np.ptp(corners[..., 2], axis=1).max() < 1
    # 5 x 3 cells on each side of the step; four cells touch the hole, two of their eight triangles do not.
    assert len(faces) == 2 * 2 * 15 - 6
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0).all()  # towards the camera, which looks along +z
    assert len(read_ply(export(PlyExporter, range_image, mesh=True, max_edge_mm=50.0))[1]) == 2 * 35 - 6


def test_pcd_keeps_the_grid_with_nan(range_image):
    content = export(PcdExporter, range_image)
    head, _, body = content.partition(b"DATA binary\n")
    words = dict(line.split(" ", 1) for line in head.decode().splitlines() if not line.startswith("#"))
    assert words["VERSION"] == "0.7"
    assert (words["WIDTH"], words["HEIGHT"], words["POINTS"]) == ("8", "6", "48")
    assert words["FIELDS"] == "x y z intensity"
    table = np.frombuffer(body, "<f4").reshape(6, 8, 4)
    assert np.array_equal(table[..., :3], range_image.xyz_mm, equal_nan=True)
    assert np.array_equal(table[..., 3], range_image.intensity)
    assert b"POINTS 47\n" in export(PcdExporter, range_image, organised=False)


def test_pcd_of_a_model_has_normals(model):
    head, _, body = export(PcdExporter, model).partition(b"DATA binary\n")
    assert b"FIELDS x y z normal_x normal_y normal_z intensity\n" in head
    assert np.array_equal(np.frombuffer(body, "<f4").reshape(5, 7)[:, 3:6], model.normals)


def test_xyz_is_a_point_a_line(range_image, model):
    table = np.loadtxt(io.BytesIO(export(XyzExporter, range_image)))
    assert np.allclose(table[:, :3], range_image.xyz_mm[range_image.rejected == 0], atol=1e-6)
    assert np.array_equal(table[:, 3], range_image.intensity[range_image.rejected == 0])
    assert np.loadtxt(io.BytesIO(export(XyzExporter, model))).shape == (5, 7)


def test_stl_has_the_triangles_with_their_normals(model):
    content = export(StlExporter, model)
    assert struct.unpack_from("<I", content, 80) == (2,)
    records = np.frombuffer(content[84:], np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]))
    assert np.array_equal(records["v"], model.points_mm[model.faces])
    expected = np.cross(records["v"][:, 1] - records["v"][:, 0], records["v"][:, 2] - records["v"][:, 0])
    assert np.allclose(records["n"], expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-5)


def test_obj_counts_from_one(model):
    lines = export(ObjExporter, model).decode().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    assert np.allclose(vertices, model.points_mm, atol=1e-6)
    assert [line for line in lines if line.startswith("f")] == ["f 1//1 2//2 3//3", "f 3//3 4//4 5//5"]


def test_obj_of_a_bare_mesh_and_of_points(model):
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    assert b"\nf 1 2 3\n" in export(ObjExporter, mesh)
    cloud = Model(model.points_mm, model.normals, model.intensity)
    assert export(ObjExporter, cloud).count(b"\np ") == 5


def test_tiff_is_read_by_opencv_with_x_y_z_in_order(range_image):
    picture = cv2.imdecode(np.frombuffer(export(TiffExporter, range_image), np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.dtype == np.float32
    assert np.array_equal(picture[..., ::-1], range_image.xyz_mm, equal_nan=True)  # OpenCV turns RGB to BGR


def test_npz_loads_without_pickle(range_image):
    with np.load(io.BytesIO(export(NpzExporter, range_image)), allow_pickle=False) as archive:
        assert np.array_equal(archive["xyz_mm"], range_image.xyz_mm, equal_nan=True)
        assert np.array_equal(archive["rejected"], range_image.rejected)
        assert str(archive["calibration"]) == "abc"


def test_npz_of_a_phase_map_has_its_fields():
    zeros = np.zeros((2, 3), np.float32)
    content = export(NpzExporter, PhaseMap(zeros, zeros, zeros, np.zeros((2, 3), np.uint8), "absolute", 16.0))
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        assert float(archive["period_px"]) == 16.0
        assert str(archive["kind"]) == "absolute"


@pytest.mark.parametrize("cls", [c for c in register_exporters() if c is not NpzExporter])
def test_nothing_left_to_write_is_an_error(cls, range_image):
    empty = RangeImage(np.full((4, 5, 3), np.nan, np.float32), np.ones((4, 5), np.uint8), np.zeros((4, 5), np.uint8))
    with pytest.raises(DataError, match="nothing is left to write"):
        export(cls, empty)


def test_stl_of_points_is_refused(model):
    with pytest.raises(DataError, match="no triangles"):
        export(StlExporter, Model(model.points_mm, model.normals, model.intensity))


ORIGIN = {"id": "20260102T030405.678901Z-1f0c", "calibration": "feedbeef"}


def simulated(range_image, is_so=True):
    return replace(range_image, **ORIGIN, provenance=Provenance(simulated=is_so))


def header(cls, content):
    """Return the part of a file that a reader takes for words."""
    ends = {"ply": b"end_header\n", "pcd": b"DATA binary\n"}
    if cls.name in ends:
        marks = {"ply": "comment ", "pcd": "#"}
        lines = content.partition(ends[cls.name])[0].decode().splitlines()
        return "\n".join(line for line in lines if line.startswith(marks[cls.name]))
    if cls.name == "stl":
        return content[:80].decode()
    return "\n".join(line for line in content.decode().splitlines() if line.startswith("#"))


@pytest.mark.parametrize("cls", [PlyExporter, PcdExporter, XyzExporter, ObjExporter, StlExporter])
def test_files_of_simulated_products_say_so_with_their_origin(cls, range_image):
    words = header(cls, export(cls, simulated(range_image)))
    assert "SIMULATED" in words and ORIGIN["id"] in words
    assert "feedbeef" in words or cls is StlExporter  # 80 bytes end before it
    words = header(cls, export(cls, simulated(range_image, False)))
    assert "SIMULATED" not in words and ORIGIN["id"] in words and "feedbeef" in words


@pytest.mark.parametrize("cls", [PlyExporter, PcdExporter, XyzExporter, ObjExporter, StlExporter])
def test_simulated_models_and_meshes_say_so_too(cls, model):
    marked = Provenance(simulated=True)
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), provenance=marked)
    for product in (replace(model, provenance=marked), mesh):
        assert "SIMULATED" in header(cls, export(cls, product))
    assert "SIMULATED" not in header(cls, export(cls, model))


def test_notes_change_no_number(range_image):
    marked = simulated(range_image)
    assert np.array_equal(read_ply(export(PlyExporter, marked))[0], read_ply(export(PlyExporter, range_image))[0])
    assert export(PcdExporter, marked).partition(b"DATA")[2] == export(PcdExporter, range_image).partition(b"DATA")[2]
    assert len(export(StlExporter, marked)) == len(export(StlExporter, range_image))
    tables = [np.loadtxt(io.BytesIO(export(XyzExporter, product))) for product in (marked, range_image)]
    assert np.array_equal(*tables)


def image_description(content):
    (start,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, start)
    entries = [struct.unpack_from("<HHII", content, start + 2 + 12 * i) for i in range(count)]
    assert [entry[0] for entry in entries] == sorted(entry[0] for entry in entries)
    for tag, kind, length, offset in entries:
        if tag == 270:
            assert kind == 2
            return content[offset : offset + length].decode()
    return ""


def test_tiff_of_a_simulated_product_says_so_and_is_still_read(range_image):
    content = export(TiffExporter, simulated(range_image))
    expected = f"SIMULATED: not measured; id {ORIGIN['id']}; calibration feedbeef\0"
    assert image_description(content) == expected
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(picture[..., ::-1], range_image.xyz_mm, equal_nan=True)
    assert "SIMULATED" not in image_description(export(TiffExporter, simulated(range_image, False)))


@pytest.mark.parametrize("is_so", [True, False])
def test_npz_says_whether_it_is_simulated(range_image, is_so):
    with np.load(io.BytesIO(export(NpzExporter, simulated(range_image, is_so))), allow_pickle=False) as archive:
        assert bool(archive["simulated"]) is is_so
        assert str(archive["id"]) == ORIGIN["id"]


def test_notes_cannot_break_a_header(range_image):
    content = export(PlyExporter, replace(range_image, id="a\nend_header\nö"))
    assert len(read_ply(content)[0]) == 47


def test_refusal_of_stl_says_what_works_instead(model):
    with pytest.raises(DataError, match=r"a Model without faces has no triangles.*ply.*RangeImage"):
        export(StlExporter, replace(model, faces=None))
