"""The face database to models: three views of each head, 60 degrees apart, registered with no guess and integrated.

Default settings throughout: pairs, closed loops, one open mesh for each head. The truth is the head's own mesh, which
the views have never seen as such: distances of the model's vertices from it, in the frame that the front view's exact
pose says. A model counts as right where all views are in it and its surface is within the limit, RMS.

    python tests/bench/bench_models.py [--folder FOLDER] [--count 30] [--resolution 0.5] [--output PICTURE.png]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from heads import Array, HeadView, arguments, heads, say
from scipy.spatial import cKDTree

from fringed.simulation.shapes.head import HeadOptions, head
from fringed_plugins.registration.chaining import chain
from fringed_plugins.registration.meshing.integrate import integrate
from fringed_plugins.registration.meshing.sampling import sampled
from fringed_plugins.registration.meshing.triangles import TriangleMesh
from fringed_plugins.registration.register import Options
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.views.closing import close_loops

SURFACE_MM, RATE = 0.1, 0.95
TRUE_POINTS = 1_500_000
FAR_MM = 1.0
THREADS = 2


class Made(NamedTuple):
    """One head's model and how right it is: RMS distance (mm) of its vertices, part of them that is far off, poses."""

    variant: int
    mesh: TriangleMesh
    views: int
    surface_mm: float
    middle_mm: float
    far: float
    pose_mm: float
    seconds: float
    before_mm: float
    after_mm: float

    @property
    def right(self) -> bool:
        return self.views == 3 and self.surface_mm < SURFACE_MM


def model(views: list[HeadView]) -> Made:
    """Return the model of one head's views, from raw arrays."""
    started = time.perf_counter()
    surfaces = [
        prepare(view.xyz_mm, view.rejected, view.sigma_mm, f"head {view.variant} at {view.angle_deg}") for view in views
    ]
    options = Options(threads=THREADS)
    linked = chain(surfaces, options, require=False)
    known = {(link.partner, link.view): link.alignment for link in linked.links}
    poses, before, after = linked.T_model_view, 0.0, 0.0
    if len(poses) > 2:
        closed = close_loops(surfaces, poses, known, options)
        poses, before, after = closed.T_model_view, closed.before[1], closed.after[1]
    placed = sorted(poses)
    mesh = integrate(
        [surfaces[i] for i in placed],
        [views[i].intensity for i in placed],
        [poses[i] for i in placed],
        threads=THREADS,
    )
    seconds = time.perf_counter() - started
    off = distances(mesh, views[0])
    near = np.abs(off) < FAR_MM
    return Made(
        views[0].variant, mesh, len(placed), float(np.sqrt((off[near] ** 2).mean())), float(np.median(np.abs(off))),
        float((~near).mean()), pose_error(poses, views), seconds, before, after,
    )  # fmt: skip


def distances(mesh: TriangleMesh, front: HeadView) -> Array:
    """Return signed distances (n,) of the mesh's vertices from the true head, along its facets' normals."""
    shape = head(HeadOptions(variant=front.variant))
    points, normals = sampled(shape.vertices_mm, shape.faces, TRUE_POINTS)
    T = np.linalg.inv(front.T_camera_object)
    seen = mesh.vertices.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    index = cKDTree(points, balanced_tree=False, compact_nodes=False).query(seen, workers=2)[1]
    return np.einsum("ij,ij->i", seen - points[index], normals[index])


def pose_error(poses: dict[int, Array], views: list[HeadView]) -> float:
    """Return the RMS error in mm of the worst view's points."""
    worst = 0.0
    for number, T in poses.items():
        off = T - views[0].T_camera_object @ np.linalg.inv(views[number].T_camera_object)
        points = views[number].xyz_mm[views[number].rejected == 0][::20].astype(np.float64)
        worst = max(worst, float(np.sqrt(((points @ off[:3, :3].T + off[:3, 3]) ** 2).sum(1).mean())))
    return worst


def summary(made: list[Made]) -> None:
    right = [one for one in made if one.right]
    rate = len(right) / len(made)
    verdict = "PASS" if rate > RATE else "MISS"
    print(
        f"{verdict}  models of three views, no guess: {len(right)} of {len(made)} right, {rate:.1%} (over {RATE:.0%})"
    )
    figures = np.array(
        [(o.surface_mm, o.middle_mm, o.pose_mm, o.far, o.before_mm, o.after_mm, o.seconds) for o in made]
    )
    names = (
        "surface, mm RMS", "surface, mm median", "worst view's pose, mm RMS", "vertices off by over 1 mm",
        "pairs off the chain, mm", "... shared out, mm", "seconds a model",
    )  # fmt: skip
    for name, column in zip(names, figures.T, strict=True):
        print(f"INFO  {name:28s} median {np.median(column):.4f}, worst {column.max():.4f}")
    triangles = [len(one.mesh.faces) for one in made]
    print(f"INFO  triangles a model: {min(triangles):,} to {max(triangles):,}")


def draw(path: Path, made: list[Made]) -> None:
    """Draw all models obliquely, matt, at one scale."""
    from fringed_client.pictures.figures import figure, save, titled
    from fringed_client.pictures.layers import Layer, composed, filled
    from fringed_client.pictures.models import CLAY
    from fringed_client.pictures.shading import turned
    from fringed_client.pictures.views import show

    columns = min(6, len(made))
    rows = -(-len(made) // columns)
    drawn = figure(2.1 * columns, 2.6 * rows)
    view = turned("aside", 25.0, 8.0)
    panels = np.atleast_1d(drawn.subplots(rows, columns, squeeze=False)).ravel()
    for panel in panels:
        panel.set_axis_off()
    for one, panel in zip(made, panels, strict=False):
        layer = filled(Layer(one.mesh.vertices, one.mesh.normals, np.array(CLAY)), one.mesh.faces, 150_000)
        show(panel, composed([layer], view, 260), view)
        titled(panel, f"{one.variant}: {1000 * one.surface_mm:.0f} µm", simulated=one is made[0], narrow=True)
    save(drawn, path, 200)
    print(f"INFO  the models are drawn in {path}")


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--output", type=Path, help="draw all models here")
    asked = parser.parse_args()
    views = heads(asked.folder, asked.count, asked.resolution)
    made = []
    for number, group in enumerate(zip(views[::3], views[1::3], views[2::3], strict=True), 1):
        made.append(model(list(group)))
        one = made[-1]
        print(
            f"INFO    head {one.variant:2d}: {one.views} views, surface {one.surface_mm:.4f} mm RMS, worst pose "
            f"{one.pose_mm:.4f} mm, {len(one.mesh.faces):,} triangles, {one.seconds:.1f} s", flush=True,
        )  # fmt: skip
        say(f"models {number} of {asked.count}")
    summary(made)
    if asked.output:
        draw(asked.output, made)
    return 0


if __name__ == "__main__":
    sys.exit(main())
