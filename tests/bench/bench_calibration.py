"""A calibration made from images only, against the simulator's truth: 12 poses of the board x 24 images, 400 mm field.

The rig has its defaults: distortion in both lenses, blur, gamma 2.2, vignetting, flicker, 8 bits, shot and read noise.
The devices are driven directly. Board centres are compared with the projection of the true ones, the calibration with
the rig's own numbers. What the calibration makes of plane, sphere, steps and face is measured on sets without noise,
flicker and quantisation of the camera, so that what is left is systematic; the scatter on sets with them.

    python tests/bench/bench_calibration.py [--seeds 1] [--sensor-blur 0.0]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
from bench_accuracy import along_ray_mm, take
from stationkit import figure, info

from fringed.boards import Board, diameters_mm, points_mm
from fringed.config.simulated import SceneConfig, SimulationConfig
from fringed.data import BoardView, Calibration, PhaseMap, RangeImage, Truth
from fringed.simulation import optics
from fringed.simulation.rig import SimulatedRig
from fringed.testing import RecordingContext
from fringed_client.calibration.poses import plan, scene_of
from fringed_plugins.calibration.artefacts.spheres import find_spheres
from fringed_plugins.calibration.detect.bias import ellipse_centres
from fringed_plugins.calibrators.calibrate import Calibrate
from fringed_plugins.calibrators.detect_board import DetectBoard
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder
from fringed_plugins.triangulation_plugin import Triangulate

BOARD = Board()
OBJECTS: dict[str, dict[str, Any]] = {
    "plane": {"object": "plane"},
    "sphere": {"object": "sphere", "options": {"radius_mm": 60.0}},
    "steps": {"object": "steps"},
    "face": {"object": "face"},
}
POSES, FIELD_MM = 12, 400.0
CAMERA_PX, PROJECTOR_PX, CENTRES_PX, BIAS_PX = 0.05, 0.08, 0.03, 0.01
SIGMAS, SHARE, SYSTEMATIC_MM, EXACT_MM, SCATTER = 3.0, 1e-3, 0.03, 0.01, 0.10
OBJECT_BOARD = np.diag([1.0, -1.0, -1.0, 1.0])

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Taken:
    """One pose: what was found, and the board's true pose."""

    view: BoardView
    T_camera_board: Array


def rig_of(seed: int, noisy: bool, sensor_blur: float, scene: dict[str, Any]) -> SimulatedRig:
    """Return a rig; without noise its lamp is steady and its frames have 16 bits."""
    lamp = {} if noisy else {"projector": {"flicker": 0.0}}
    table = {
        "seed": seed, "real_time": False, "noise": noisy, "quantise": noisy, "scene": scene,
        "sensor": {"blur_px": sensor_blur}, **lamp,
    }  # fmt: skip
    return SimulatedRig(msgspec.convert(table, SimulationConfig))


def run(processor: Any, inputs: dict[str, Any], **params: Any) -> Any:
    return processor().run(inputs, processor.Params(**params), RecordingContext())


def phase_of(frames: Any, orientation: str = "columns") -> PhaseMap:
    found: PhaseMap = run(MultiFrequencyDecoder, {"frames": frames}, orientation=orientation)
    return found


def poses(rig: SimulatedRig) -> tuple[list[Taken], float]:
    """Return every pose, and the seconds that decoding and detection took."""
    found, seconds = [], 0.0
    geometry, sensor = msgspec.to_builtins(rig.config.geometry), rig.config.sensor
    for pose in plan(POSES):
        scene = scene_of(pose, BOARD, geometry, sensor.height_px / sensor.width_px)
        rig.set_scene(msgspec.convert(scene, SceneConfig))
        frames = take(rig, orientation="both")
        began = time.perf_counter()
        maps = {name: phase_of(frames, name) for name in ("columns", "rows")}
        view: BoardView = run(DetectBoard, maps, board=BOARD, name=pose.name)
        seconds += time.perf_counter() - began
        found.append(Taken(view, rig.truth().T_camera_object @ OBJECT_BOARD))
        if not view.found:
            info(pose.name, f"not found: {view.reason}")
    return found, seconds


def centre_errors(taken: Taken, camera: Any) -> tuple[Array, Array, float]:
    """Return the errors (n, 2) of the centres, the biases (n, 2) that were undone, and the tilt in degrees."""
    pose, index = taken.T_camera_board, taken.view.index
    points = points_mm(BOARD)[index] @ pose[:3, :3].T + pose[:3, 3]
    centres = optics.project(camera, points)
    radii = diameters_mm(BOARD)[index] / 2
    bias = ellipse_centres(points, pose[:3, 2], radii, camera.matrix, camera.distortion) - centres
    tilt = float(np.degrees(np.arccos(np.clip(abs(pose[2, 2]), 0, 1))))
    return taken.view.camera_px - bias - centres, bias, tilt


def judge_centres(taken: list[Taken], camera: Any) -> None:
    errors, biases, tilts = zip(*(centre_errors(one, camera) for one in taken if one.view.found), strict=True)
    every, bias = np.concatenate(errors), np.concatenate(biases)
    rms = float(np.sqrt(np.mean(every**2)))
    size = np.linalg.norm(bias, axis=1)
    along = np.einsum("ij,ij->i", every, bias / np.maximum(size, 1e-12)[:, None])[size > np.median(size)]
    told = f"{rms:.4f} px RMS of each coordinate, {np.abs(every).max():.3f} px at most, {len(every)} centres"
    figure(
        f"board centres against truth, tilts to {max(tilts):.0f} degrees", told, f"{CENTRES_PX} px", rms < CENTRES_PX
    )
    told = f"{along.mean():+.4f} px along it where it is large; it was {size.mean():.3f} px, {size.max():.3f} at most"
    figure("perspective's bias, undone", told, f"{BIAS_PX} px", abs(float(along.mean())) < BIAS_PX)


def numbers(calibration: Calibration) -> dict[str, float]:
    """Return the numbers that are compared."""
    found = {}
    for name, lens in (("camera", calibration.camera), ("projector", calibration.projector)):
        matrix = lens.matrix
        found |= {f"{name}.fx": matrix[0, 0], f"{name}.fy": matrix[1, 1]}
        found |= {f"{name}.cx": matrix[0, 2], f"{name}.cy": matrix[1, 2]}
    translation = calibration.T_projector_camera[:3, 3]
    return found | {"baseline": float(np.linalg.norm(translation))}


def sigmas(calibration: Calibration) -> dict[str, float]:
    assert calibration.covariance is not None
    names = list(calibration.parameters)
    found = {name: float(np.sqrt(calibration.covariance[i, i])) for i, name in enumerate(names)}
    translation = calibration.T_projector_camera[:3, 3]
    place = [names.index(f"stereo.{axis}") for axis in ("tx", "ty", "tz")]
    along = translation / np.linalg.norm(translation)
    return found | {"baseline": float(np.sqrt(along @ calibration.covariance[np.ix_(place, place)] @ along))}


def judge_numbers(found: Calibration, exact: Calibration) -> None:
    ours, true, known = numbers(found), numbers(exact), sigmas(found)
    for name, value in ours.items():
        off, scale = value - true[name], abs(true[name])
        if name.endswith(("cx", "cy")):  # of a principal point: over the picture's size
            lens = exact.camera if name.startswith("camera") else exact.projector
            scale = lens.width_px if name.endswith("cx") else lens.height_px
        told = f"off by {off:+.4f}, {off / known[name]:+.2f} of its deviations, {abs(off) / scale:.4%}"
        figure(name, told, "3 deviations, 0.1 %", abs(off) < SIGMAS * known[name] and abs(off) < SHARE * scale)


def view_of(phase: PhaseMap, calibration: Calibration) -> RangeImage:
    found: RangeImage = run(Triangulate, {"phase": phase, "calibration": calibration})
    return found


def judge_object(name: str, seed: int, blur: float, found: Calibration) -> None:
    rig = rig_of(seed, False, blur, OBJECTS[name])
    still = view_of(phase_of(take(rig)), found)
    truth = rig.truth()
    error = along_ray_mm(still, truth)
    kept = (still.rejected == 0) & (truth.is_object > 0) & (np.abs(error) < 1.0)
    rms, mean = float(np.sqrt(np.mean(error[kept] ** 2))), float(np.mean(error[kept]))
    wild = float(((still.rejected == 0) & (truth.is_object > 0) & ~kept).sum() / kept.sum())
    figure(
        f"{name}: systematic error",
        f"{rms:.4f} mm RMS, {wild:.1e} beyond 1 mm",
        f"{SYSTEMATIC_MM} mm",
        rms < SYSTEMATIC_MM,
    )
    figure(
        f"{name}: trueness", f"{mean:+.4f} mm, 1:{FIELD_MM / abs(mean):,.0f}", "1:10,000", abs(mean) < FIELD_MM / 1e4
    )
    noisy = view_of(phase_of(take(rig_of(seed + 100, True, blur, OBJECTS[name]))), found)
    assert noisy.sigma_mm is not None
    both = kept & (noisy.rejected == 0)
    scatter = np.linalg.norm(noisy.xyz_mm, axis=2) - np.linalg.norm(still.xyz_mm, axis=2)
    ratio = float(np.std((scatter / noisy.sigma_mm)[both & (np.abs(scatter) < 1.0)]))
    figure(f"{name}: scatter over stated deviation", f"{ratio:.3f}", "within 10 %", abs(ratio - 1) < SCATTER)
    if name == "sphere":
        judge_sphere(still)
    if name == "steps":
        judge_steps(still, truth)


def judge_sphere(view: RangeImage) -> None:
    (ball,) = find_spheres(view.xyz_mm, view.rejected == 0, view.sigma_mm)
    off = ball.radius_mm - 60.0
    figure("sphere: radius of 60 mm", f"off by {off:+.4f} mm", f"{EXACT_MM} mm", abs(off) < EXACT_MM)


def judge_steps(view: RangeImage, truth: Truth) -> None:
    """Heights over the first tread, each tread's plane by its own points; which tread a point is on, truth says."""
    pose = np.linalg.inv(truth.T_camera_object)
    true = truth.xyz_mm @ pose[:3, :3].T + pose[:3, 3]
    seen = view.xyz_mm.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    kept = (view.rejected == 0) & (truth.is_object > 0)
    heights = [
        float(seen[..., 2][kept & (np.abs(true[..., 2] - h) < 1e-3)].mean()) for h in (10.0, 20.0, 30.0, 40.0, 50.0)
    ]
    off = np.array(heights) - heights[0] - np.arange(5) * 10.0
    figure(
        "steps: heights of 10 to 40 mm",
        f"off by {np.abs(off).max():.4f} mm at most",
        f"{EXACT_MM} mm",
        bool(np.abs(off).max() < EXACT_MM),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--sensor-blur", type=float, default=0.0, help="Gaussian sigma of the camera's lens, px")
    asked = parser.parse_args()
    for seed in range(1, asked.seeds + 1):
        rig = rig_of(seed, True, asked.sensor_blur, {"object": "plane"})
        exact = replace(rig.calibration(), residuals={})
        taken, seconds = poses(rig)
        judge_centres(taken, exact.camera)
        began = time.perf_counter()
        found: Calibration = run(Calibrate, {"views": [one.view for one in taken]})
        info("24 images decoded, and the board found", f"{seconds / POSES:.2f} s for each pose")
        info("calibration of 12 poses", f"{time.perf_counter() - began:.2f} s")
        for name, most in (("camera", CAMERA_PX), ("projector", PROJECTOR_PX)):
            rms = found.residuals[f"{name}_rms_px"]
            figure(f"reprojection, {name}", f"{rms:.4f} px RMS", f"{most} px", rms < most)
        judge_numbers(found, exact)
        for name in OBJECTS:
            judge_object(name, seed, asked.sensor_blur, found)


if __name__ == "__main__":
    main()
