"""Pictures show what they should: no holes, right colours, axes the right way round."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from fringed.data import IterationRecord, Model, PhaseMap, Provenance, RangeImage, Registration, Truth
from fringed.errors import UsageError
from fringed_client.demo import measure
from fringed_client.pictures import gallery, views
from fringed_client.pictures.geometry import cloud_of, grid_normals
from fringed_client.pictures.shading import VIEWS, render_points
from fringed_client.pictures.thumbs import thumbnail


def sphere(noise_mm: float = 0.0, size: int = 160) -> RangeImage:
    """A sphere of 60 mm radius, 1000 mm away, seen by a camera that is far away enough to be parallel."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[0:size, 0:size].astype(np.float32) - (size - 1) / 2
    inside = x**2 + y**2 < 58**2
    z = 1000 - np.sqrt(np.clip(60**2 - x**2 - y**2, 0, None)) + rng.normal(0, noise_mm, x.shape)
    xyz = np.where(inside[..., None], np.dstack([x, y, z]), np.nan).astype(np.float32)
    rejected = np.where(inside, 0, 2).astype(np.uint8)
    sigma = np.full(x.shape, noise_mm, np.float32)
    return RangeImage(xyz, rejected, rejected, sigma, provenance=Provenance(simulated=True))


def test_normals_of_a_sphere_point_away_from_its_centre() -> None:
    image = sphere()
    normals = grid_normals(image.xyz_mm)
    true = (image.xyz_mm - [0, 0, 1000]) / 60
    near_pole = np.hypot(image.xyz_mm[..., 0], image.xyz_mm[..., 1]) < 40
    # smoothing over 5 px of a 60 mm sphere turns normals by less than (2 / 60)^2 rad
    assert np.einsum("ijk,ijk->ij", normals, true)[near_pole].min() > np.cos(0.02)


@pytest.mark.parametrize("view", list(VIEWS))
def test_shaded_surface_has_no_holes(view: str) -> None:
    points, normals, _ = cloud_of(sphere(0.05).xyz_mm)
    covered = render_points(points, normals, VIEWS[view], 400).covered
    filled = covered.astype(np.uint8)
    cv2.floodFill(filled, None, (0, 0), 2)
    assert covered.mean() > 0.3
    assert (filled == 0).sum() == 0


def test_view_from_the_side_shows_near_points_at_the_right() -> None:
    points, normals, _ = cloud_of(sphere().xyz_mm)
    shown = render_points(points, normals, VIEWS["y-z"], 400)
    left, right, bottom, top = shown.extent_mm
    assert -left > -right  # z falls to the right
    assert pytest.approx(-right, abs=6) == 940
    assert bottom > top


def test_values_are_painted_where_they_belong() -> None:
    points, normals, values = cloud_of(sphere().xyz_mm, sphere().xyz_mm[..., 0])
    shown = render_points(points, normals, VIEWS["x-y"], 400, values)
    middle = shown.values[shown.values.shape[0] // 2]
    assert middle[60] < -20 and middle[-60] > 20


def test_pictures_of_every_type_are_drawn(tmp_path: Path) -> None:
    image = sphere(0.05)
    plane = np.zeros(image.rejected.shape, np.float32)
    phase = PhaseMap(plane, plane + 20, plane + 50, image.rejected, "absolute", 16.0)
    points, normals, _ = cloud_of(image.xyz_mm)
    history = tuple(IterationRecord(1.0 / n, 10, 1.0, 0.1, 0.1, "fine") for n in range(1, 5))
    registration = Registration("a", "b", np.eye(4), True, "it stands still", 0.1, 0.5, history=history)
    model = Model(
        points, normals, np.zeros(len(points), np.uint8), ("a", "b"), np.stack([np.eye(4)] * 2), (registration,)
    )
    for content, count in ((image, 7), (phase, 4), (model, 5), (registration, 1)):
        drawn = gallery.draw_all(content, tmp_path / type(content).__name__)
        assert len(drawn) == count
        for path in drawn:
            picture = cv2.imread(str(path))
            assert picture is not None and picture.std() > 1
    assert thumbnail(model) is not None and thumbnail(image).shape[2] == 3
    with pytest.raises(UsageError, match="no picture"):
        gallery.draw_all(history[0], tmp_path)


@pytest.mark.parametrize("kind", ["wrapped", "relative", "absolute"])
@pytest.mark.parametrize("more", [False, True])
def test_a_phase_map_is_drawn_with_all_that_it_carries(tmp_path: Path, kind: str, more: bool) -> None:
    plane = np.linspace(0, 3, 40 * 60, dtype=np.float32).reshape(40, 60)
    rejected = np.zeros(plane.shape, np.uint16)
    rejected[5:10] = 1024  # a reason beyond a byte
    plane[5:10] = np.nan
    sure = np.where(plane > 2, np.inf, plane + 4)  # infinite where there was no order to choose
    phase = PhaseMap(plane, plane + 20, plane + 50, rejected, kind, 16.0, orientation="rows", projector_px=768,
                     sigma_rad=plane / 50 if more else None, confidence=sure if more else None)  # fmt: skip
    names = {path.stem for path in gallery.draw_all(phase, tmp_path)}
    expected = {"wrapped-phase", "modulation", "mask"} | ({"sigma", "confidence"} if more else set())
    assert names == expected | ({"phase"} if kind != "wrapped" else set())


def test_a_map_with_nothing_kept_is_drawn_too(tmp_path: Path) -> None:
    nothing = np.full((20, 30), np.nan, np.float32)
    rejected = np.full(nothing.shape, 2, np.uint16)
    phase = PhaseMap(nothing, nothing, nothing, rejected, "absolute", 16.0, sigma_rad=nothing, confidence=nothing)
    assert len(gallery.draw_all(phase, tmp_path)) == 6


def test_painted_surfaces_share_a_scale(tmp_path: Path) -> None:
    points, normals, values = cloud_of(sphere().xyz_mm, sphere().xyz_mm[..., 0])
    path = views.draw_painted(
        tmp_path / "p.png",
        [views.Painted(points, normals, values, name) for name in ("a", "b")],
        "x / mm",
        simulated=True,
    )
    assert cv2.imread(str(path)).shape[1] > 700


def truth_of(image: RangeImage, T_camera_object: np.ndarray | None = None) -> Truth:
    lit = (image.rejected == 0).astype(np.uint8)
    pixels = np.zeros((*lit.shape, 2), np.float32)
    T = np.eye(4) if T_camera_object is None else T_camera_object
    return Truth(image.xyz_mm, pixels, lit, lit, lit, T)


def test_figures_of_a_view_are_those_that_were_put_in() -> None:
    true, noisy = sphere(), sphere(0.05)
    xyz, rejected = noisy.xyz_mm.copy(), noisy.rejected.copy()
    xyz[80, 80, 2] += 3.0  # one flyer
    rejected[60:70, 60:70] = 2
    xyz[60:70, 60:70] = np.nan
    image = RangeImage(xyz, rejected, rejected, noisy.sigma_mm)
    found = measure.view_figures(image, truth_of(true))
    kept = int((true.rejected == 0).sum())
    assert found["flyers"] == 1
    assert found["completeness"] == pytest.approx(1 - 100 / kept)
    # n = 10,000 points: the mean is good to sigma / 100, the deviation to sigma / 141
    assert abs(found["bias_mm"]) < 4 * 0.05 / 100
    assert found["scatter_mm"] == pytest.approx(0.05, rel=4 / 141 + 0.01)
    assert found["scatter_ratio"] == pytest.approx(1.0, rel=0.04)


def test_transform_error_is_the_angle_and_the_shift_at_the_points() -> None:
    angle = np.deg2rad(0.1)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    points = np.array([[100.0, 0, 1000], [100.0, 10, 1000], [100.0, -10, 1000]])
    found = measure.transform_error(turn, np.eye(4), points)
    assert found["rotation_error_deg"] == pytest.approx(0.1, rel=1e-6)
    assert found["translation_error_mm"] == pytest.approx(100 * angle, rel=1e-3)


def test_distance_to_the_true_surface_sees_a_shift() -> None:
    image = sphere()
    surface = measure.true_surface([truth_of(image)])
    points, normals, _ = cloud_of(image.xyz_mm)
    top = np.hypot(points[:, 0], points[:, 1]) < 30
    # nearest samples are 2 mm apart on a 60 mm sphere: the tangent is off by at most 1.4^2 / 120 mm
    error = surface.distance_mm(points[top] + 0.1 * normals[top])
    assert np.median(error) == pytest.approx(0.1, abs=0.017)
