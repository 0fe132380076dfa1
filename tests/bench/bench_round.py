"""Twelve views around a head, 30 degrees apart, on the simulated rig with its default noise: a loop, one model.

Fringes are decoded and triangulated with the rig's exact calibration; nothing is told about the turns. Printed: the
views' errors after chaining and after the loops are closed and all surfaces are brought together, RMS over each view's
true points, and how far the merged model's points are from the true surface.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from bench_accuracy import measured, simulated, take
from scipy.spatial import cKDTree

from fringed_plugins.registration.chaining import chain
from fringed_plugins.registration.merging import merge
from fringed_plugins.registration.register import Options
from fringed_plugins.registration.surface import prepare
from fringed_plugins.registration.views.closing import close_loops
from fringed_plugins.registration.views.joint import Wish, refine_all

VIEWS, STEP_DEG = 12, 30.0
SURFACE_MM, POSE_MM = 0.05, 0.05


def scan(number):
    """Return a view's points, deviations, true points (NaN elsewhere) and T_camera_object."""
    rig = simulated({"object": "face", "rotation_deg": [0.0, STEP_DEG * number, 0.0]}, 70 + number)
    view, truth = measured(rig, take(rig)), rig.truth()
    kept = (view.rejected == 0) & (truth.is_object > 0)
    points, true = (np.where(kept[..., None], xyz, np.nan) for xyz in (view.xyz_mm, truth.xyz_mm))
    return points.astype(np.float32), view.sigma_mm, true.astype(np.float32), np.asarray(truth.T_camera_object)


def pose_errors(poses, scans):
    """Return each view's RMS error in mm over its true points, in the frame of the first."""
    out = []
    for number, (_, _, true, T) in enumerate(scans):
        off = poses[number] - scans[0][3] @ np.linalg.inv(T)
        points = true[np.isfinite(true[..., 0])][::40].astype(np.float64)
        out.append(float(np.sqrt(((points @ off[:3, :3].T + off[:3, 3]) ** 2).sum(1).mean())))
    return np.array(out)


def surface_error(cloud, scans):
    """Return the RMS distance in mm of the model's points from the true surface, along their normals."""
    true = []
    for _, _, points, T in scans:
        move = scans[0][3] @ np.linalg.inv(T)
        some = points[np.isfinite(points[..., 0])][::2].astype(np.float64)
        true.append(some @ move[:3, :3].T + move[:3, 3])
    every = np.vstack(true)
    chosen = slice(None, None, 20)
    points, normals = cloud.points[chosen].astype(np.float64), cloud.normals[chosen]
    distance, index = cKDTree(every, balanced_tree=False, compact_nodes=False).query(points, workers=2)
    off = np.einsum("ij,ij->i", points - every[index], normals)
    return float(np.sqrt((off[distance < 1.0] ** 2).mean())), float((distance >= 1.0).mean()), len(cloud.points)


def said(off):
    """Return poses' errors in words."""
    return f"{off.max():.4f} mm at most, {off[-1]:.4f} mm where the loop ends"


def main() -> int:
    scans = [scan(number) for number in range(VIEWS)]
    started = time.perf_counter()
    surfaces = [prepare(points, None, sigma, f"view {k}") for k, (points, sigma, _, _) in enumerate(scans)]
    linked = chain(surfaces, Options(threads=2))
    chained = time.perf_counter() - started
    known = {(link.partner, link.view): link.alignment for link in linked.links}
    started = time.perf_counter()
    graph = close_loops(surfaces, linked.T_model_view, known, Options(threads=2), refine=False)
    closed = time.perf_counter() - started
    started = time.perf_counter()
    joint = refine_all(surfaces, graph.T_model_view, 0, None, Wish(threads=2))
    refined = time.perf_counter() - started
    stages = (linked.T_model_view, graph.T_model_view, joint.T_model_view)
    before, middle, after = (pose_errors(poses, scans) for poses in stages)
    print(f"INFO  chained: {chained:.1f} s, {said(before)}")
    print(f"INFO  loops closed ({len(graph.edges)} pairs): {closed:.1f} s more, {said(middle)}")
    passed = "PASS" if after.max() < POSE_MM else "MISS"
    print(f"{passed}  all surfaces at once: {refined:.1f} s more, {said(after)} (at most {POSE_MM:g} mm)")
    grey = [np.zeros(points.shape[:2], np.uint8) for points, *_ in scans]
    cloud = merge(surfaces, grey, np.array([joint.T_model_view[k] for k in range(VIEWS)]))
    rms, far, count = surface_error(cloud, scans)
    passed = "PASS" if rms < SURFACE_MM else "MISS"
    print(f"{passed}  model of {count:,} points: {rms:.4f} mm RMS from the true surface (at most {SURFACE_MM:g} mm)")
    print(f"INFO  {far:.2e} of its points are more than 1 mm from any true point")
    return 0


if __name__ == "__main__":
    sys.exit(main())
