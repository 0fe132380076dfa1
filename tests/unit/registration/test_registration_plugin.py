"""The processors "register" and "merge": parameters, products and errors as a user meets them."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest
from analytic_relief import errors, hand, head, pose, see
from scipy.spatial import Delaunay, cKDTree

from fringed.data import Mesh, Model, RangeImage, Registration
from fringed.errors import Cancelled, ConvergenceError, DataError, UsageError
from fringed.hookspecs import Processor
from fringed.wire import decode, encode
from fringed_plugins import registration_plugin
from fringed_plugins.registrars.model import Merge
from fringed_plugins.registrars.pair import Register
from fringed_plugins.registration.meshing.triangles import topology


class Host:
    threads = 2

    def __init__(self, stop_after=None):
        self.heard, self.logged, self.stop_after = [], [], stop_after

    def progress(self, fraction, text=""):
        self.heard.append(fraction)
        if self.stop_after is not None and len(self.heard) > self.stop_after:
            raise Cancelled("stopped")

    def check_cancelled(self):
        pass

    def log(self, level, text):
        self.logged.append((level, text))


def image(view, name, sigma=True):
    bad = ~np.isfinite(view.xyz_mm[..., 0])
    return RangeImage(
        view.xyz_mm,
        bad.astype(np.uint8) * 16,
        np.full(bad.shape, 99, np.uint8),
        sigma_mm=np.where(bad, np.nan, 0.05).astype(np.float32) if sigma else None,
        id=name,
    )


@pytest.fixture(scope="module")
def seen():
    return [see(T=pose((0, angle, 0)), noise_mm=0.05, seed=i) for i, angle in enumerate((-20, 0, 20))]


@pytest.fixture(scope="module")
def images(seen):
    return tuple(image(view, f"view-{i}") for i, view in enumerate(seen))


def test_processors_keep_the_contract():
    for cls in registration_plugin.register_processors():
        assert isinstance(cls(), Processor)
        schema = msgspec.json.schema(cls.Params)
        assert all("description" in field for field in schema["$defs"]["Params"]["properties"].values())


@pytest.mark.parametrize("sigma", [True, False])
def test_register_returns_a_product_that_travels(seen, images, sigma):
    views = images if sigma else [image(view, f"view-{i}", sigma=False) for i, view in enumerate(seen)]
    host = Host()
    product = Register().run({"reference": views[0], "model": views[1]}, Register.Params(), host)
    assert isinstance(product, Registration) and product.converged
    assert (product.reference, product.model) == ("view-0", "view-1")
    assert errors(product.T_reference_model, seen[0], seen[1])[0] < 0.03
    assert product.covariance.shape == (6, 6) and product.history
    assert host.heard[0] == 0 and host.heard[-1] == 1
    assert decode(encode(product)).content.history == product.history


def test_start_comes_as_nested_lists(seen, images):
    start = (seen[0].T_camera_object @ np.linalg.inv(seen[1].T_camera_object)).tolist()
    params = msgspec.convert({"T_reference_model": start}, Register.Params)
    assert Register().run({"reference": images[0], "model": images[1]}, params, Host()).converged
    json.dumps(msgspec.to_builtins(params))


def test_method_of_the_literature_is_chosen_by_name(seen, images):
    product = Register().run({"reference": images[0], "model": images[1]}, Register.Params(method="symmetric"), Host())
    assert product.converged and {made.stage for made in product.history} == {"symmetric"}
    assert errors(product.T_reference_model, seen[0], seen[1])[0] < 0.05
    icpif = Register().run({"reference": images[0], "model": images[1]}, Register.Params(method="icpif"), Host())
    assert icpif.history[0].alpha_mm > 0 and decode(encode(icpif)).content.history == icpif.history
    with pytest.raises(UsageError, match="did you mean icpif"):
        Register().run({"reference": images[0], "model": images[1]}, Register.Params(method="icpfi"), Host())


def test_refuted_start_is_followed_by_guesses_unless_told_not_to(images):
    start = np.eye(4)
    start[:3, 3] = [400.0, 0, 0]
    params = msgspec.convert({"T_reference_model": start.tolist(), "search": "none"}, Register.Params)
    alone = Register().run({"reference": images[0], "model": images[1]}, params, Host())
    assert not alone.converged
    params = msgspec.convert({"T_reference_model": start.tolist()}, Register.Params)
    assert Register().run({"reference": images[0], "model": images[1]}, params, Host()).converged


def test_guesses_of_one_kind_are_chosen_by_name(images):
    start = np.eye(4)
    start[:3, 3] = [400.0, 0, 0]
    params = msgspec.convert({"T_reference_model": start.tolist(), "search": "oriented-pairs"}, Register.Params)
    assert Register().run({"reference": images[0], "model": images[1]}, params, Host()).converged
    with pytest.raises(UsageError, match="did you mean oriented-pairs"):
        Register().run({"reference": images[0], "model": images[1]}, Register.Params(search="oriented-pair"), Host())
    with pytest.raises(UsageError, match="leave `search` out"):
        Register().run(
            {"reference": images[0], "model": images[1]}, Register.Params(method="zhang", search="none"), Host()
        )


def test_models_and_meshes_register_without_a_grid(seen, images):
    """A view, its bare points, and a mesh of the true relief: all meet, and tell it as range images do."""
    bare = images[1].xyz_mm[images[1].rejected == 0]
    cloud = Model(bare, np.zeros_like(bare), np.zeros(len(bare), np.uint8), id="bare")
    for reference, model in ((images[0], cloud), (cloud, images[0])):
        found = Register().run({"reference": reference, "model": model}, Register.Params(), Host())
        T = found.T_reference_model if reference is images[0] else np.linalg.inv(found.T_reference_model)
        assert found.converged and found.covariance.shape == (6, 6)
        assert errors(T, seen[0], seen[1])[1] < 0.05
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-80, 80, 161), np.linspace(-105, 105, 211)))
    faces = Delaunay(np.stack([x, y], axis=1)).simplices.astype(np.int32)
    vertices = np.stack([x, y, head(x, y)], axis=1)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    back = np.cross(b - a, c - a)[:, 2] > 0  # triangles that face away from the camera, which looks along z
    faces[back] = faces[back][:, ::-1]
    start = seen[0].T_camera_object @ pose((0, 5, 0), (2, 1, -1000))
    params = msgspec.convert({"T_reference_model": start.tolist()}, Register.Params)
    found = Register().run({"reference": images[0], "model": Mesh(vertices, faces)}, params, Host())
    assert found.converged, found.reason
    off = np.linalg.inv(seen[0].T_camera_object) @ found.T_reference_model
    assert np.abs(off - np.eye(4)).max() < 0.03


@pytest.mark.parametrize("method", ["symmetric", "icpif", "gicp"])
def test_methods_of_the_literature_take_clouds(seen, images, method):
    bare = images[1].xyz_mm[images[1].rejected == 0]
    cloud = Model(bare, np.zeros_like(bare), np.zeros(len(bare), np.uint8))
    found = Register().run({"reference": images[0], "model": cloud}, Register.Params(method=method), Host())
    assert errors(found.T_reference_model, seen[0], seen[1])[1] < (0.1 if method == "symmetric" else 1.0)
    with pytest.raises(DataError, match="no grid"):
        Register().run({"reference": cloud, "model": images[0]}, Register.Params(method="projective"), Host())


def test_failure_is_a_product_that_says_why(images):
    host = Host()
    other = image(see(hand, noise_mm=0.05), "hand")
    product = Register().run({"reference": images[0], "model": other}, Register.Params(), host)
    assert not product.converged and product.reason
    assert host.logged[0][0] == "warning"


def test_images_that_cannot_be_meant_are_data_errors(images):
    empty = RangeImage(images[0].xyz_mm * np.float32(np.nan), images[0].rejected, images[0].intensity, id="none")
    with pytest.raises(DataError, match="0 valid points"):
        Register().run({"reference": images[0], "model": empty}, Register.Params(), Host())
    with pytest.raises(DataError, match="view 2 none has 0 valid points"):
        Merge().run({"views": (images[0], empty)}, Merge.Params(), Host())
    with pytest.raises(DataError, match="counted from 0"):
        Merge().run({"views": images}, Merge.Params(reference=7), Host())
    mirrored = msgspec.convert({"T_reference_model": np.diag([1.0, 1, -1, 1]).tolist()}, Register.Params)
    with pytest.raises(DataError, match="not rigid"):
        Register().run({"reference": images[0], "model": images[1]}, mirrored, Host())


def test_merge_makes_one_model(seen, images):
    model = Merge().run({"views": images}, Merge.Params(), Host())
    assert isinstance(model, Model)
    assert model.views == ("view-0", "view-1", "view-2")
    assert [(r.reference, r.model) for r in model.registrations] == [("view-0", "view-1"), ("view-1", "view-2")]
    assert all(r.history for r in model.registrations)
    assert errors(model.T_model_view[2], seen[0], seen[2])[1] < 0.05
    assert model.points_mm.dtype == np.float32 and set(np.unique(model.intensity)) == {99}
    assert model.faces is None and model.confidence.min() >= 0 and np.median(model.confidence) > 1 / 0.05**2 / 4


@pytest.mark.parametrize("surface", ["open", "watertight"])
def test_merge_makes_triangles(images, surface):
    model = Merge().run({"views": images[:2]}, Merge.Params(surface=surface, voxel_mm=2.5), Host())
    told = topology(model.faces)
    assert told.manifold and told.closed == (surface == "watertight")
    assert (model.confidence > 0).mean() > 0.4
    seen = model.points_mm[model.confidence > 0].astype(float)
    true = images[0].xyz_mm[images[0].rejected == 0].astype(float)
    distance, _ = cKDTree(true).query(seen)
    assert np.median(distance) < 1.0 and set(np.unique(model.intensity[model.confidence > 0])) == {99}
    assert np.array_equal(decode(encode(model)).content.faces, model.faces)


def test_voxels_too_fine_say_which_fit(images):
    with pytest.raises(DataError, match="voxel"):
        Merge().run({"views": images[:2]}, Merge.Params(surface="open", voxel_mm=1e-3), Host())


def test_merge_takes_given_registrations(images):
    first = Register().run({"reference": images[0], "model": images[1]}, Register.Params(), Host())
    model = Merge().run({"views": images[:2], "registrations": (first,)}, Merge.Params(), Host())
    assert np.array_equal(model.T_model_view[1], first.T_reference_model)
    with pytest.raises(DataError, match="a registration joins"):
        Merge().run({"views": images[1:], "registrations": (first,)}, Merge.Params(), Host())


def test_merge_names_the_pair_that_fails_or_leaves_it_out(images):
    views = (images[0], image(see(hand, noise_mm=0.05), "hand"), images[1])
    with pytest.raises(ConvergenceError, match=r"view 2 \(hand\) to view 1 \(view-0\)"):
        Merge().run({"views": views}, Merge.Params(), Host())
    host = Host()
    model = Merge().run({"views": views}, Merge.Params(require_convergence=False), host)
    assert model.views == ("view-0", "view-1")
    assert [r.converged for r in model.registrations] == [False, True]
    assert any("hand" in text for _, text in host.logged)


def test_a_single_view_is_a_model(images):
    model = Merge().run({"views": images[:1]}, Merge.Params(), Host())
    assert len(model.points_mm) and model.registrations == ()


@pytest.mark.parametrize("number", [0, 10, 40])
def test_both_stop_when_somebody_asks(images, number):
    with pytest.raises(Cancelled):
        Merge().run({"views": images}, Merge.Params(), Host(stop_after=number))
    with pytest.raises(Cancelled):
        Register().run({"reference": images[0], "model": images[1]}, Register.Params(), Host(stop_after=number // 3))
