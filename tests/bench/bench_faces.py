"""Two views of a face, independently sampled: our default against peers from PyPI, in twelve cases, in one run.

About 126 thousand points a view; turned by 5, 15 and 30 degrees; noise 0 and 0.1 mm; full and half overlap. Everybody
starts from where the views stand and is timed from raw arrays; errors are RMS over some draws of noise. The
Cramer-Rao bound is computed from the true surface: no unbiased method has less variance.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "registration"))

from analytic_relief import errors, head, pose, see
from peers_registration import PEERS, quiet

from fringed_plugins.registration.plane import information, jacobian
from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.surface import prepare

SIZE = {"pitch_mm": 0.484, "size": (490, 380)}
DRAWS = 8
SECONDS, OVER_BOUND, NOISELESS = 0.3, 1.5, (1e-3, 2e-3)
RIGHT_DEG = 1.0  # a peer that is farther off has found nothing, and its time is none
FAST_ONLY = "VGICP"  # faster than GICP and several times less exact: printed, not counted for its time
HALVES = {"full": (None, None), "50 %": ((0.0, 0.68), (0.32, 1.0))}


def views(degrees, noise_mm, overlap, draw):
    columns = HALVES[overlap]
    reference = see(head, noise_mm=noise_mm, seed=100 * draw + 1, columns=columns[0], **SIZE)
    model = see(head, pose((0, degrees, 0)), noise_mm=noise_mm, seed=100 * draw + 2, columns=columns[1], **SIZE)
    return reference, model


def bound(reference, model, noise_mm):
    """Return the Cramer-Rao bound as (degrees, RMS mm): the model's points that the reference sees too, all known.

    Each point tells n . (R p + t - surface) with the variance of both views along the normal; the bound of two noisy
    samplings of one unknown surface is that of their difference.
    """
    from scipy.spatial import cKDTree

    ours, theirs = (view.clean_mm[np.isfinite(view.clean_mm[..., 0])] for view in (model, reference))
    T = reference.T_camera_object @ np.linalg.inv(model.T_camera_object)
    points = ours @ T[:3, :3].T + T[:3, 3]
    tree = cKDTree(theirs)
    distance, _ = tree.query(points)
    seen = points[distance < SIZE["pitch_mm"]]
    local = (seen - reference.T_camera_object[:3, 3]) @ reference.T_camera_object[:3, :3]
    step = 0.01
    slope_x = (head(local[:, 0] + step, local[:, 1]) - head(local[:, 0] - step, local[:, 1])) / (2 * step)
    slope_y = (head(local[:, 0], local[:, 1] + step) - head(local[:, 0], local[:, 1] - step)) / (2 * step)
    n = np.stack([slope_x, slope_y, -np.ones(len(local))], axis=1)
    n = n / np.linalg.norm(n, axis=1, keepdims=True) @ reference.T_camera_object[:3, :3].T
    variance = np.zeros(len(seen))
    for view in (reference, model):
        eye = np.zeros(3) if view is reference else T[:3, 3]
        ray = seen - eye
        cosine = np.einsum("ij,ij->i", ray, n) / np.linalg.norm(ray, axis=1)
        variance += (noise_mm * cosine) ** 2
    middle = points.mean(0)
    H = information(jacobian(seen - middle, n), 1.0 / variance)
    C = np.linalg.inv(H)
    J = jacobian_of_points(points - middle)
    rms = np.sqrt(np.einsum("nki,ij,nkj->n", J, C, J).mean())
    return float(np.degrees(np.sqrt(np.trace(C[:3, :3])))), float(rms)


def jacobian_of_points(points):
    J = np.zeros((len(points), 3, 6))
    J[:, :, :3] = np.stack([np.cross(axis, points) for axis in np.eye(3)], axis=2)
    J[:, :, 3:] = np.eye(3)
    return J


def ours(reference, model):
    return register(prepare(reference), prepare(model), Options(threads=2)).T_reference_model


def raw(view):
    return view.xyz_mm[np.isfinite(view.xyz_mm[..., 0])].astype(np.float64)


def main() -> int:
    missing = {"GICP twice", "VGICP", "Open3D multi-scale", "KISS + GICP"} - set(PEERS)
    if missing:
        print(f"INFO  not installed, so not compared: {', '.join(sorted(missing))}")
    warm = views(5, 0.1, "full", 9)
    ours(warm[0].xyz_mm, warm[1].xyz_mm)
    won = cases = 0
    for degrees in (5, 15, 30):
        for noise_mm in (0.0, 0.1):
            for overlap in HALVES:
                won += case(degrees, noise_mm, overlap)
                cases += 1
    print(
        f"{'PASS' if won >= 10 else 'MISS'}  lower error than every peer in no more time: {won} of {cases} cases (10)"
    )
    return 0


def case(degrees, noise_mm, overlap):
    """Print one case and return whether ours was at least as fast as the fastest and more exact than all."""
    methods = {"ours": None, **PEERS}
    seconds = {name: [] for name in methods}
    off = {name: [] for name in methods}
    for draw in range(DRAWS if noise_mm else 1):
        pair = views(degrees, noise_mm, overlap, draw)
        clouds = [raw(view) for view in pair]
        for name, work in methods.items():
            started = time.perf_counter()
            with quiet():
                T = ours(pair[0].xyz_mm, pair[1].xyz_mm) if work is None else work(*clouds)
            seconds[name].append(time.perf_counter() - started)
            off[name].append(errors(np.asarray(T), *pair))
    rms = {name: np.sqrt((np.array(values) ** 2).mean(0)) for name, values in off.items()}
    spent = {name: float(np.median(values)) for name, values in seconds.items()}
    most = tuple(OVER_BOUND * b for b in bound(*pair, noise_mm)) if noise_mm else NOISELESS
    right = bool((rms["ours"] <= most).all()) and spent["ours"] <= SECONDS
    said = f"{degrees:2d} deg, noise {noise_mm:g} mm, overlap {overlap}, {len(clouds[0]):,} points"
    print(
        f"{'PASS' if right else 'MISS'}  {said}: {spent['ours']:.2f} s, {rms['ours'][0]:.5f} deg, "
        f"{rms['ours'][1]:.5f} mm (at most {SECONDS:g} s, {most[0]:.5f} deg, {most[1]:.5f} mm"
        f"{', 1.5 x Cramer-Rao' if noise_mm else ''})"
    )
    for name in PEERS:
        ratios = f"{spent[name] / spent['ours']:5.1f} x the time, {rms[name][1] / rms['ours'][1]:8.1f} x the error"
        print(
            f"INFO    {name:20s} {spent[name]:.2f} s, {rms[name][0]:.5f} deg, {rms[name][1]:.5f} mm; {ratios}",
            flush=True,
        )
    best = all(rms["ours"][1] <= rms[name][1] for name in PEERS)  # of the points: rotation and translation at once
    rivals = [spent[name] for name in PEERS if name != FAST_ONLY and rms[name][0] < RIGHT_DEG]
    fastest = min(rivals, default=np.inf)
    if not (best and spent["ours"] <= fastest):
        why = "" if best else "a peer is more exact; "
        print(f"INFO    not won: {why}ours {spent['ours']:.3f} s, theirs {fastest:.3f} s")
    return best and spent["ours"] <= fastest


if __name__ == "__main__":
    sys.exit(main())
