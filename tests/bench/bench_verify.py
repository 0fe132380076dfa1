"""Verification on known artefacts at full size: figures against what the artefacts are, and a calibration that is off.

The rig has its defaults (1392 x 1040 px, 400 mm field, noise, blur, gamma, distortion); the devices are driven
directly. The calibration is the simulator's own: what is measured here is the verification. Then the same scans with
a calibration that is off by known amounts: the light has to say so.

    python tests/bench/bench_verify.py [--average 4] [--seed 1]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np
from bench_accuracy import simulated, take
from stationkit import figure, info

from fringed.data import Calibration, FrameSet, RangeImage, Verification
from fringed.testing import RecordingContext
from fringed_plugins.calibrators.ranges import AverageRange
from fringed_plugins.calibrators.verify import VerifyPlane, VerifySphere, VerifyStep
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder
from fringed_plugins.triangulation_plugin import Triangulate

ARTEFACTS: dict[str, tuple[dict[str, Any], type[Any], dict[str, Any]]] = {
    "plane": ({"object": "plane"}, VerifyPlane, {}),
    "sphere": ({"object": "sphere", "options": {"radius_mm": 60.0}}, VerifySphere, {"radius_mm": 60.0}),
    "ball-bar": (
        {"object": "ball-bar", "options": {"radius_mm": 25.0, "spacing_mm": 200.0}, "rotation_deg": (0.0, 20.0, 25.0)},
        VerifySphere,
        {"radius_mm": 25.0, "spacing_mm": 200.0},
    ),
    "step": ({"object": "steps"}, VerifyStep, {"heights_mm": (10.0, 20.0, 30.0, 40.0)}),
}
EXACT_MM, SYSTEMATIC_MM = 0.01, 0.03
LENGTHS = ("probing_error_size", "sphere_spacing_error", "step_error")


def ranged(frames: FrameSet, calibration: Calibration) -> RangeImage:
    context = RecordingContext()
    phase = MultiFrequencyDecoder().run({"frames": frames}, MultiFrequencyDecoder.Params(), context)
    return Triangulate().run({"phase": phase, "calibration": calibration}, Triangulate.Params(), context)


def mean(images: list[RangeImage]) -> RangeImage:
    return AverageRange().run({"ranges": tuple(images)}, AverageRange.Params(), RecordingContext())


def verified(name: str, image: RangeImage) -> Verification:
    _, processor, params = ARTEFACTS[name]
    return processor().run({"range": image}, processor.Params(**params), RecordingContext())


def off_by(calibration: Calibration, kind: str) -> Calibration:
    """Return the calibration with one thing wrong, as much as a careless hand or a warm day makes it."""
    T, matrix = calibration.T_projector_camera.copy(), calibration.camera.matrix.copy()
    distortion = calibration.camera.distortion.copy()
    if kind == "baseline 0.1 % too long":
        T[:3, 3] *= 1.001
    elif kind == "projector turned by 0.2 mrad":
        turn = np.array([[1, 0, 2e-4], [0, 1, 0], [-2e-4, 0, 1]])
        T[:3, :3] = turn @ T[:3, :3]
    elif kind == "camera's k1 off by 0.01":
        distortion[0] += 0.01
    camera = replace(calibration.camera, matrix=matrix, distortion=distortion)
    return replace(calibration, camera=camera, T_projector_camera=T)


def told(found: Verification) -> str:
    return ", ".join(f"{name} {found.figures[name]:+.4f} +- {found.figures[f'{name}_u']:.4f}" for name in found.limits)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--average", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    kept = {}
    for name, (scene, _, _) in ARTEFACTS.items():
        rig = simulated(scene, asked.seed)
        calibration = rig.calibration()
        frames = [take(rig) for _ in range(asked.average)]
        kept[name] = (frames, calibration)
        start = time.perf_counter()
        found = verified(name, ranged(frames[0], calibration))
        info(f"{name}: one scan", f"{told(found)} mm; {time.perf_counter() - start:.1f} s")
        found = verified(name, mean([ranged(one, calibration) for one in frames]))
        info(f"{name}: mean of {asked.average}", f"{told(found)} mm")
        for key in (key for key in found.figures if key.startswith("rms")):
            rms = found.figures[key]
            what = f"{name}: {key} of means of 7 x 7 px"
            figure(what, f"{rms:.4f} mm", f"under {SYSTEMATIC_MM} mm", rms < SYSTEMATIC_MM)
        for key in (key for key in LENGTHS if key in found.limits):
            error = found.figures[key] / (2 if key == "probing_error_size" else 1)
            what = f"{name}: {'radius' if key == 'probing_error_size' else key}"
            figure(what, f"{error:+.4f} mm", f"under {EXACT_MM} mm", abs(error) < EXACT_MM)
        figure(f"{name}: light", found.verdict, "green", found.verdict == "green")
    for kind in ("baseline 0.1 % too long", "projector turned by 0.2 mrad", "camera's k1 off by 0.01"):
        worst = []
        for name, (frames, calibration) in kept.items():
            found = verified(name, ranged(frames[0], off_by(calibration, kind)))
            worst.append(found.verdict)
            info(f"{kind}: {name}", f"{found.verdict}; {told(found)} mm")
        figure(kind, f"{worst.count('red')} of {len(worst)} red", "at least one", "red" in worst)


if __name__ == "__main__":
    main()
