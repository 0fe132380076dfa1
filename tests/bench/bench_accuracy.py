"""Accuracy of the range image against the simulator's truth: plane, sphere and steps, default noise, 400 mm field.

The devices are driven directly; no clock of the machine is in it. Every figure is over several seeds. What is
predicted is the deviation that the decoder and the geometry state for each point (shot, read and quantisation
noise of the sensor, the four steps of the finest fringes, the sensitivity of the ray); the scatter is that of the
points about the truth along their rays, in units of it.

    python tests/bench/bench_accuracy.py [--seeds 3] [--scene plane] [--sensor-blur 0.5]
"""

from __future__ import annotations

import argparse
from typing import Any

import msgspec
import numpy as np
from stationkit import figure, info

from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings, FrameSet, RangeImage, Truth
from fringed.devices.camera.sim import SimulatedCamera
from fringed.devices.projector.sim import SimulatedProjector
from fringed.hookspecs import ProjectorTarget
from fringed.simulation.rig import SimulatedRig
from fringed.testing import RecordingContext
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder
from fringed_plugins.triangulation_plugin import Triangulate

SCENES: dict[str, dict[str, Any]] = {
    "plane": {"object": "plane"},
    "sphere": {"object": "sphere", "options": {"radius_mm": 60.0}},
    "steps": {"object": "steps"},
}
MORE: dict[str, dict[str, Any]] = {"face": {"object": "face"}, "hand": {"object": "hand"}}
BIAS_MM, SCATTER, PRESENT, FLYER_MM = 0.02, 1.15, 0.98, 1.0
SETTLE_S = 0.012
DEADLINE_S = 5.0


def simulated(scene: dict[str, Any], seed: int, sensor: dict[str, Any] | None = None) -> SimulatedRig:
    table = {"seed": seed, "real_time": False, "scene": scene, "sensor": sensor or {}}
    return SimulatedRig(msgspec.convert(table, SimulationConfig))


def take(rig: SimulatedRig, encoder: Any = MultiFrequencyEncoder, role: str = "object", **params: Any) -> FrameSet:
    """Take one set with the simulated devices, each frame triggered after the light has settled."""
    calibration = rig.calibration()
    target = ProjectorTarget(calibration.projector.width_px, calibration.projector.height_px, calibration.tone_curve)
    sequence = encoder().encode(encoder.Params(**params), target)
    camera, projector = SimulatedCamera(rig, {"warm_up": False}), SimulatedProjector(rig)
    camera.open()
    projector.open()
    projector.load(sequence, role)
    settings = camera.arm(CameraSettings(exposure_us=8333.333, channel="green", trigger="software"))
    frames = []
    for index in range(len(sequence.frames)):
        flip_s = projector.show(index)
        wait_s = flip_s + rig.config.projector.latency_frames / rig.config.projector.display_hz + SETTLE_S
        rig.clock.sleep(max(wait_s - rig.clock.now(), 0.0))
        camera.trigger()
        frames.append(camera.read(DEADLINE_S).image)
    camera.close()
    projector.close()
    return FrameSet(np.array(frames), sequence, role=role, settings=settings)


def measured(rig: SimulatedRig, frame_set: FrameSet) -> RangeImage:
    context = RecordingContext()
    phase = MultiFrequencyDecoder().run({"frames": frame_set}, MultiFrequencyDecoder.Params(), context)
    inputs = {"phase": phase, "calibration": rig.calibration()}
    return Triangulate().run(inputs, Triangulate.Params(), context)


def along_ray_mm(view: RangeImage, truth: Truth) -> np.ndarray[Any, Any]:
    """Return the signed distance from the truth along each ray."""
    xyz = truth.xyz_mm.astype(np.float64)
    length = np.linalg.norm(xyz, axis=2)
    return np.asarray(np.einsum("...i,...i", view.xyz_mm - xyz, xyz) / length)


def nearest_surface_mm(view: RangeImage, truth: Truth, suspects: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return how far the suspects are from any true point nearby: a flyer is far from all of them."""
    xyz, found = truth.xyz_mm, []
    for row, column in suspects:
        near = xyz[max(row - 6, 0) : row + 7, max(column - 6, 0) : column + 7].reshape(-1, 3)
        found.append(np.nanmin(np.linalg.norm(near - view.xyz_mm[row, column], axis=1), initial=np.inf))
    return np.array(found)


def errors(rig: SimulatedRig, frame_set: FrameSet) -> dict[str, float]:
    view, truth = measured(rig, frame_set), rig.truth()
    wanted = (truth.is_object > 0) & (truth.visible > 0) & (truth.lit > 0)
    kept = (view.rejected == 0) & (truth.is_object > 0)
    error = along_ray_mm(view, truth)[kept]
    assert view.sigma_mm is not None
    suspects = np.argwhere((view.rejected == 0) & ~(np.abs(along_ray_mm(view, truth)) <= FLYER_MM))
    flyers = nearest_surface_mm(view, truth, suspects)
    return {
        "bias": float(error.mean()),
        "scatter": float(np.sqrt(np.mean((error - error.mean()) ** 2))),
        "predicted": float(np.sqrt(np.mean(view.sigma_mm[kept] ** 2))),
        "ratio": float(np.std(error / view.sigma_mm[kept])),
        "present": float(((view.rejected == 0) & wanted).sum() / wanted.sum()),
        "largest": float(np.abs(error).max()),
        "flyers": float((flyers > FLYER_MM).sum()),
        "suspects": float(len(suspects)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scene", choices=[*SCENES, *MORE], action="append")
    parser.add_argument("--sensor-blur", type=float, default=0.0, help="Gaussian sigma of the camera's lens, px")
    asked = parser.parse_args()
    for name in asked.scene or SCENES:
        rows = []
        for seed in range(1, asked.seeds + 1):
            rig = simulated((SCENES | MORE)[name], seed, {"blur_px": asked.sensor_blur})
            rows.append(errors(rig, take(rig)))
        worst = {key: max((row[key] for row in rows), key=abs) for key in rows[0]}
        present = min(row["present"] for row in rows)
        scatter = f"{worst['scatter']:.4f} mm, {worst['predicted']:.4f} mm predicted"
        info(f"{name}: scatter (RMS, all seeds' worst)", scatter)
        figure(f"{name}: bias", f"{worst['bias']:+.5f} mm", f"under {BIAS_MM} mm", abs(worst["bias"]) < BIAS_MM)
        ratio = worst["ratio"]
        figure(f"{name}: scatter over prediction", f"{ratio:.3f}", f"at most {SCATTER}", ratio <= SCATTER)
        figure(f"{name}: visible, lit points present", f"{present:.3%}", f"over {PRESENT:.0%}", present > PRESENT)
        flyers = f"{worst['flyers']:.0f}, of {worst['suspects']:.0f} points off by more along their ray"
        figure(f"{name}: flyers beyond {FLYER_MM:g} mm", flyers, "none", worst["flyers"] == 0)


if __name__ == "__main__":
    main()
