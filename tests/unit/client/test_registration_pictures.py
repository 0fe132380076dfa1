"""Pictures of registrations show the figures that were put in: lines, limits, distances, colours, places."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fringed.data import IterationRecord, Model, Provenance, RangeImage, Registration
from fringed.errors import UsageError
from fringed_client.pictures import convergence, gallery, layers, models, registration
from fringed_client.pictures.figures import APART
from fringed_client.pictures.partners import partners_of
from fringed_client.pictures.shading import VIEWS, window_of


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Every figure is drawn and kept here instead of written."""
    figures: list[Any] = []

    def keep(drawn: Any, path: Path, *_: Any, **__: Any) -> Path:
        drawn.canvas.draw()
        figures.append(drawn)
        return path

    for module in (convergence, layers, registration):
        monkeypatch.setattr(module, "save", keep)
    return figures


def a_history(count: int = 6, stages: tuple[str, ...] = ("medium", "fine"), alpha_mm: float = 0.0) -> tuple:
    return tuple(
        IterationRecord(
            0.5**n, 100 + n, 4 * 0.5**n if n else float("inf"), np.radians(2 * 0.1**n), 0.3 * 0.1**n,
            stages[n * len(stages) // count], alpha_mm,
        )
        for n in range(count)
    )  # fmt: skip


def a_registration(T: Any = None, history: tuple = (), converged: bool = True) -> Registration:
    T = np.eye(4) if T is None else T
    reason = "it stands still" if converged else "the overlap is 3.0%; at least 20% is needed"
    return Registration("a", "b", T, converged, reason, 0.05, 0.7, history=history)


def texts(drawn: Any) -> str:
    from matplotlib.text import Text

    return "\n".join(found.get_text() for found in drawn.findobj(Text) if found.get_visible())


def test_convergence_shows_every_figure_of_every_iteration(kept: list[Any]) -> None:
    history = a_history(alpha_mm=0.25)
    convergence.draw_convergence(Path("c.png"), [a_registration(history=history)], True)
    main, pairs, limits, rotation, translation = kept[0].axes
    drawn = [np.asarray(axes.lines[0].get_ydata(), float) for axes in (main, pairs, limits, rotation, translation)]
    assert drawn[0] == pytest.approx([one.rms_mm for one in history])
    assert drawn[1] == pytest.approx([one.pairs for one in history])
    assert np.isnan(drawn[2][0])  # no limit is infinitely far: not drawn
    assert drawn[2][1:] == pytest.approx([one.threshold_mm for one in history[1:]])
    assert drawn[3] == pytest.approx([2 * 0.1**n for n in range(6)])  # degrees
    assert drawn[4] == pytest.approx([one.translation_mm for one in history])
    assert np.asarray(limits.lines[1].get_ydata()) == pytest.approx([0.25] * 6)
    assert main.get_yscale() == "log" and pairs.get_yscale() == "linear"
    shown = texts(kept[0])
    for word in ("medium", "fine", "SIMULATED", "alpha", "70% overlap", "0.05 mm RMS", "view 2 → 1: converged"):
        assert word in shown


def test_methods_are_compared_by_name_and_told_apart(kept: list[Any]) -> None:
    names = [f"method {n}" for n in range(9)]
    convergence.draw_histories(Path("c.png"), {name: a_history(3 + n) for n, name in enumerate(names)}, False, "nine")
    main, pairs = kept[0].axes[:2]
    assert len(pairs.lines) == 9
    looks = {(line.get_color(), line.get_linestyle()) for line in pairs.lines}
    assert len(looks) == 9 > len(APART)
    assert main.get_xlim() == (0.5, 11.5)
    shown = texts(kept[0])
    assert all(name in shown for name in names)
    assert "alpha" not in shown and "SIMULATED" not in shown


@pytest.mark.parametrize("history", [(), (IterationRecord(0.0, 0, 0.0, 0.0, 0.0),)])
def test_a_registration_without_iterations_is_drawn_too(kept: list[Any], history: tuple) -> None:
    convergence.draw_convergence(Path("c.png"), [a_registration(history=history, converged=False)], False)
    assert "NOT converged" in texts(kept[0])
    convergence.draw_convergence(Path("c.png"), [], False)


def test_stages_are_the_runs_of_one_name() -> None:
    history = [IterationRecord(1.0, 1, 1.0, 0.0, 0.0, name) for name in ("a", "a", "b", "a")]
    assert convergence.stages_of(history) == [("a", 1, 2), ("b", 3, 3), ("a", 4, 4)]


def a_view(xyz_mm: Any, name: str = "") -> RangeImage:
    xyz = np.asarray(xyz_mm, np.float32)
    rejected = np.where(np.isfinite(xyz[..., 2]), 0, 2).astype(np.uint16)
    intensity = np.full(rejected.shape, 200, np.uint8)
    return RangeImage(xyz, rejected, intensity, id=name, provenance=Provenance(simulated=True))


def a_plane(x_mm: float = 0.0, z_mm: float = 1000.0, size: int = 61) -> RangeImage:
    y, x = np.mgrid[0:size, 0:size] - (size - 1) / 2
    return a_view(np.dstack([x + x_mm, y, np.full_like(x, z_mm)]))


def a_sphere(radius_mm: float = 60.0, offset_px: float = 0.0) -> RangeImage:
    y, x = np.mgrid[0:121, 0:121] - 60.0
    x, y = x + offset_px, y - offset_px
    below = np.clip(radius_mm**2 - x**2 - y**2, 0, None)
    z = np.where(x**2 + y**2 < 50**2, 1000 - np.sqrt(below), np.nan)
    return a_view(np.dstack([x, y, z]))


def shifted(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0) -> Any:
    T = np.eye(4)
    T[:3, 3] = x_mm, y_mm, z_mm
    return T


@pytest.mark.parametrize("away_mm", [0.3, -0.3, 4.0])
def test_error_map_tells_the_distance_of_a_moved_plane(kept: list[Any], away_mm: float) -> None:
    # towards the camera is negative z; between the points, so that nearest points are aside
    found = a_registration(shifted(0.4, 0.4, -away_mm))
    registration.draw_error_map(Path("e.png"), a_plane(), a_plane(), found)
    shown = texts(kept[0])
    number = {0.3: "RMS 300 µm, median +300 µm", -0.3: "RMS 300 µm, median -300 µm", 4.0: "RMS 4 mm, median +4 mm"}
    assert number[away_mm] in shown
    assert "SIMULATED" in shown
    top = kept[0].axes[1].get_xlim()
    assert top == pytest.approx((-300, 300) if abs(away_mm) < 1 else (-5, 5))


def test_distance_between_two_spheres_is_that_of_their_radii() -> None:
    # along the mean normal nothing of the curvature is left: the old tangent's 1.5^2 / (2 * 60) mm would be 0.019
    found = partners_of(a_sphere(60.0), a_sphere(60.2, 0.43), np.eye(4))
    assert found.partner.mean() > 0.95
    assert np.median(found.distance_mm[found.partner]) == pytest.approx(0.2, abs=0.002)


def test_points_beside_and_behind_have_no_partner() -> None:
    beside = partners_of(a_plane(), a_plane(x_mm=30), np.eye(4))
    over = beside.points_mm[:, 0] <= 30
    # the rim's normals need three of five pixels: partners end within two pixels of the edge
    assert beside.partner[over & (beside.points_mm[:, 0] < 28)].all()
    assert not beside.partner[beside.points_mm[:, 0] > 32].any()
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])  # seen from behind
    turned[2, 3] = 2000
    assert not partners_of(a_plane(), a_plane(), turned).partner.any()


def test_error_map_of_views_that_do_not_meet_is_grey(kept: list[Any]) -> None:
    registration.draw_error_map(Path("e.png"), a_plane(), a_plane(), a_registration(shifted(500), converged=False))
    shown = texts(kept[0])
    assert "0 points have a partner" in shown and "no partner: 3,481 points" in shown  # 59 x 59: a rim has no normals
    assert "NOT converged" in shown and "at least 20% is needed" in shown.replace("\n", " ")


def test_both_views_are_seen_from_four_sides_before_and_after(kept: list[Any]) -> None:
    ball = a_sphere()
    registration.draw_registration(Path("r.png"), ball, ball, a_registration(shifted(40, 0, 20)))
    axes = kept[0].axes
    assert [one.get_title("left") for one in axes] == [
        f"{when}, {side}" for when in ("before", "after") for side in ("X–Y", "Y–Z", "X–Z", "oblique")
    ]
    assert [(one.get_xlabel(), one.get_ylabel()) for one in axes[:3]] == [
        ("x / mm", "y / mm"), ("z / mm", "y / mm"), ("x / mm", "z / mm"),
    ]  # fmt: skip
    low, high = axes[0].get_xlim()
    # of both rows: from -50 to 50 + 40, with a margin of 4 %
    assert (low, high) == pytest.approx((-54, 94), abs=3) and axes[4].get_xlim() == (low, high)
    scales = {round(one.bbox.width / abs(np.ptp(one.get_xlim())), 1) for one in axes}
    assert len(scales) == 1  # pixels for each mm
    assert all(one.get_aspect() == 1 for one in axes)


def test_the_nearer_surface_hides_the_other() -> None:
    near, far = a_plane(z_mm=990, size=31), a_plane(z_mm=1000, size=61)
    red, green = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    both = [layers.layer_of(near, red), layers.layer_of(far, green)]
    for order in (both, both[::-1]):
        shown = layers.composed(order, VIEWS["x-y"], 200)
        middle, side = shown.rgb[shown.rgb.shape[0] // 2, [shown.rgb.shape[1] // 2, shown.rgb.shape[1] // 6]]
        assert middle[0] > 150 > middle[1] and side[1] > 150 > side[0]


def test_a_torn_grid_is_shown_as_points() -> None:
    xyz = a_plane().xyz_mm.copy()
    xyz[::2], xyz[:, ::2] = np.nan, np.nan  # no point has a neighbour
    torn = layers.layer_of(a_view(xyz), np.ones(3))
    assert len(torn.points_mm) == 30 * 30
    assert np.all(torn.normals[:, 2] < -0.9)  # they face the camera
    assert layers.composed([torn], VIEWS["x-y"], 100).covered.mean() > 0.5


def test_correspondences_join_matched_points(kept: list[Any]) -> None:
    T = shifted(20, 5, -2)
    registration.draw_correspondences(Path("c.png"), a_plane(), a_plane(), a_registration(T), most=40)
    axes = kept[0].axes[0]
    (lines,) = axes.collections
    segments = np.array(lines.get_segments())
    assert segments.shape == (40, 2, 2)
    ends, starts = segments[:, 0], segments[:, 1]
    # the model's own x, y, moved aside, is where the reference's is after the registration: one shift for all
    apart = starts - ends
    assert np.ptp(apart, axis=0) == pytest.approx([0, 0], abs=1e-3)
    assert apart[0, 1] == pytest.approx(-5, abs=1e-3)
    aside = apart[0, 0] + 20
    assert aside == pytest.approx(1.2 * 58, abs=0.2)  # points with normals span 58 mm
    assert starts[:, 0].min() > 30 > ends[:, 0].max()
    assert "40 of" in axes.get_title("left")


def test_a_window_holds_all_clouds() -> None:
    window = window_of([np.zeros((5, 3)), np.full((5, 3), 7.0), np.zeros((0, 3))], VIEWS["x-y"], 100)
    assert np.all(window.low <= 0) and np.all(window.high >= 7)
    assert np.all(np.isfinite(window_of([], VIEWS["x-y"], 100).high))


def a_model(views: int = 3, **more: Any) -> Model:
    """A sphere of 60 mm with 3,000 points, the views one above the other."""
    n = 3000
    z = 1 - 2 * (np.arange(n) + 0.5) / n
    angle = np.arange(n) * np.pi * (3 - np.sqrt(5))
    normals = np.stack([np.cos(angle) * np.sqrt(1 - z**2), z, np.sin(angle) * np.sqrt(1 - z**2)], axis=1)
    points = (60 * normals + [0, 0, 1000]).astype(np.float32)
    index = (np.arange(n) * views // n).astype(np.uint8)  # rising downwards: from y = 60 to -60
    intensity = np.where(points[:, 1] > 0, 255, 30).astype(np.uint8)
    names = tuple(f"id{i}" for i in range(views))
    return Model(points, normals.astype(np.float32), intensity, names, np.stack([np.eye(4)] * views),
                 view_index=index, **more)  # fmt: skip


def picture_of(axes: Any) -> Any:
    return np.asarray(axes.images[0].get_array())


def test_a_model_is_seen_from_four_sides_in_the_colours_of_its_views(kept: list[Any]) -> None:
    models.draw_model(Path("m.png"), a_model(), azimuth_deg=-30, elevation_deg=10)
    axes = kept[0].axes
    assert [one.get_title("left") for one in axes] == ["X–Y", "Y–Z", "X–Z", "azimuth -30°, elevation 10°"]
    rgb = picture_of(axes[0]).astype(float)
    middle = rgb.shape[1] // 2
    palette = models.view_colours(3)
    for part, view in ((0.2, 2), (0.5, 1), (0.8, 0)):  # view 0 has the largest y, which is below
        seen = rgb[int(part * rgb.shape[0]), middle]
        shade = [seen @ colour / np.linalg.norm(seen) / np.linalg.norm(colour) for colour in palette]
        assert int(np.argmax(shade)) == view
    shown = texts(kept[0])
    assert "view 2 (id1): 33% of the points" in shown and "model of 3 views: 3,000 points" in shown


def test_a_model_is_coloured_by_intensity(kept: list[Any]) -> None:
    models.draw_model(Path("m.png"), a_model(), "intensity")
    rgb = picture_of(kept[0].axes[0])
    middle = rgb.shape[1] // 2
    # light comes from above, y is downwards: the lower half is bright all the same
    assert rgb[int(0.7 * rgb.shape[0]), middle].mean() > 2 * rgb[int(0.3 * rgb.shape[0]), middle].mean()


def test_a_model_without_views_is_clay_and_says_what_it_lacks(kept: list[Any]) -> None:
    from dataclasses import replace

    plain = replace(a_model(), view_index=None)
    models.draw_model(Path("m.png"), plain)
    assert not kept[0].legends
    with pytest.raises(UsageError, match="does not know which view"):
        models.draw_model(Path("m.png"), plain, "views")
    with pytest.raises(UsageError, match="by views, intensity or clay"):
        models.draw_model(Path("m.png"), plain, "rainbow")  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [1, 6, 12, 30])
def test_views_have_colours_of_their_own(kept: list[Any], count: int) -> None:
    assert len(np.unique(models.view_colours(count).round(4), axis=0)) == count
    models.draw_model(Path("m.png"), a_model(count))
    shown = texts(kept[0])
    assert "view 1" in shown and ("16 more" in shown) == (count == 30)


def test_triangles_are_filled_evenly() -> None:
    corners = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [10, 10, 0]], float)
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    layer = layers.Layer(corners, np.tile([0.0, 0, -1], (4, 1)), np.eye(4)[:, :3])
    found = models.filled(layer, faces, 8000)
    assert len(found.points_mm) == 8000
    assert found.points_mm.min() >= 0 and found.points_mm.max() <= 10 and not found.points_mm[:, 2].any()
    counts, _, _ = np.histogram2d(*found.points_mm[:, :2].T, bins=4)
    assert abs(counts - 500).max() < 5 * np.sqrt(500)
    assert found.normals == pytest.approx(np.tile([0.0, 0, -1], (8000, 1)))
    flat = models.filled(layer, np.array([[0, 0, 0]]), 100)  # no area at all
    assert len(flat.points_mm) == 1


def test_a_registration_is_drawn_with_its_views_where_they_are_known(tmp_path: Path) -> None:
    found = a_registration(history=a_history())
    assert [path.name for path in gallery.draw_all(found, tmp_path)] == ["registration.png"]
    drawn = gallery.draw_all(found, tmp_path, (a_sphere(), a_sphere(60.1, 0.4)))
    assert [path.stem for path in drawn] == ["registration", "views", "error", "correspondences"]
    assert all(5_000 < path.stat().st_size < 200_000 for path in drawn)
    assert "views" in {path.stem for path in gallery.draw_all(a_model(), tmp_path)}


def test_sparse_points_leave_no_specks() -> None:
    ball = a_model()
    layer = layers.Layer(ball.points_mm, ball.normals, np.ones(3))
    shown = layers.composed([layer], VIEWS["y-z"], 300)
    grey = shown.rgb.mean(axis=2)[100:200, 100:200]  # the middle, lit smoothly: a third of the ball's width
    assert abs(np.diff(grey, axis=0)).max() < 12 and abs(np.diff(grey, axis=1)).max() < 12
