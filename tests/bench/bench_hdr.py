"""A shiny dome with patches of albedo from 0.05 to 0.9, taken with one exposure and with three that are fused.

Known are, from the simulator, which points are visible and lit, and where they are. What is printed is the share of
these points that the range image has, the median standard deviation of the phase, and how far the phase is from the
truth in units of what it claims. The single exposures are those of the bracket and the one that `suggest_exposures`
would pick alone.

    python tests/bench/bench_hdr.py [--sensor 1392x1040]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import msgspec
import numpy as np
from stationkit import figure, info

from fringed.acquisition.checks import check_frames
from fringed.config import CheckConfig
from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings, FrameSet, Mesh, PhaseMap
from fringed.devices.camera.sim import SimulatedCamera
from fringed.devices.projector.sim import SimulatedProjector
from fringed.hookspecs import ProjectorTarget
from fringed.simulation.rig import SimulatedRig
from fringed.testing import RecordingContext
from fringed_plugins.decoders.fusion import FuseExposures
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder

ALBEDOS = (0.9, 0.05, 0.5, 0.1, 0.2, 0.7)
SPECULAR = 1.0
GOOD_RAD = 0.04  # a deviation of a tenth of a projector pixel, with fringes of 16 pixels
EXPOSURE_US = 8333.333
FACTORS = (0.125, 1.0, 8.0)
SETTLE_S = 0.012


def dome(side: int = 241, radius_mm: float = 140.0) -> Mesh:
    """Return a dome of 45 mm height with patches of every albedo."""
    y, x = np.meshgrid(*2 * [np.linspace(-radius_mm, radius_mm, side)], indexing="ij")
    z = 45 * np.exp(-(x**2 + y**2) / (2 * 75.0**2))
    patch = (np.floor((x + radius_mm) / 47) + 2 * np.floor((y + radius_mm) / 47)).astype(int) % len(ALBEDOS)
    index = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    albedo = np.array(ALBEDOS, np.float32)[patch].ravel()
    return Mesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, albedo)


def rig_of(width_px: int, height_px: int, seed: int = 1) -> SimulatedRig:
    table = {
        "seed": seed,
        "real_time": False,
        "scene": {"object": "mesh", "albedo": 1.0, "specular": SPECULAR},
        "sensor": {"width_px": width_px, "height_px": height_px},
    }
    return SimulatedRig(msgspec.convert(table, SimulationConfig), mesh=dome())


def take(rig: SimulatedRig, exposure_us: float, role: str = "object") -> FrameSet:
    """Take the default set with one exposure."""
    calibration = rig.calibration()
    target = ProjectorTarget(calibration.projector.width_px, calibration.projector.height_px, calibration.tone_curve)
    sequence = MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), target)
    camera, projector = SimulatedCamera(rig, {"warm_up": False}), SimulatedProjector(rig)
    camera.open()
    projector.open()
    projector.load(sequence, role)
    settings = camera.arm(CameraSettings(exposure_us=exposure_us, channel="green", trigger="software"))
    frames = []
    for index in range(len(sequence.frames)):
        flip_s = projector.show(index)
        lit_s = flip_s + rig.config.projector.latency_frames / rig.config.projector.display_hz + SETTLE_S
        rig.clock.sleep(max(lit_s - rig.clock.now(), 0.0))
        camera.trigger()
        frames.append(camera.read(5.0).image)
    camera.close()
    projector.close()
    return FrameSet(np.array(frames), sequence, role=role, settings=settings)


def decoded(frame_set: FrameSet) -> PhaseMap:
    return MultiFrequencyDecoder().run({"frames": frame_set}, MultiFrequencyDecoder.Params(), RecordingContext())


def judged(phase: PhaseMap, rig: SimulatedRig) -> dict[str, float]:
    """Return what a map has of the points that there are, and how true it is."""
    truth = rig.truth()
    wanted = (truth.is_object > 0) & (truth.visible > 0) & (truth.lit > 0)
    kept = (phase.rejected == 0) & wanted
    assert phase.sigma_rad is not None
    error = phase.phase_rad - truth.projector_px[..., 0] * np.float32(2 * np.pi / phase.period_px)
    return {
        "share": float(kept.sum() / wanted.sum()),
        "good": float((kept & (phase.sigma_rad < GOOD_RAD)).sum() / wanted.sum()),
        "sigma": float(np.median(phase.sigma_rad[kept])),
        "worst": float(np.quantile(phase.sigma_rad[kept], 0.99)),
        "rms": float(np.sqrt(np.mean(error[kept].astype(np.float64) ** 2))),
        "ratio": float(np.sqrt(np.median((error[kept] / phase.sigma_rad[kept]) ** 2) / 0.4549)),
        "orders": float(np.mean(np.abs(error[kept]) > np.pi)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensor", default="1392x1040")
    width_px, height_px = map(int, parser.parse_args().sensor.split("x"))
    rig = rig_of(width_px, height_px)
    maps, rows = [], []
    for factor in FACTORS:
        frame_set = take(rig, EXPOSURE_US * factor)
        report = check_frames(frame_set.frames, frame_set.sequence, frame_set.settings, CheckConfig(saturated_max=1))
        maps.append(decoded(frame_set))
        rows.append(judged(maps[-1], rig))
        told = f"{report.saturated_fraction:.1%} of the pixels saturated, check {'passed' if report.passed else report}"
        tell(f"exposure {EXPOSURE_US * factor:.0f} us, {told}", rows[-1])
    fused, seconds = fuse(maps)
    row = judged(fused, rig)
    tell("three exposures fused", row)
    best = max(one["good"] for one in rows)
    figure(
        "points present, fused",
        f"{row['share']:.2%}, best single exposure {best:.2%}",
        "over 99 %",
        row["share"] > 0.99,
    )
    figure("phase error over what is claimed", f"{row['ratio']:.3f}", "at most 1.15", row["ratio"] <= 1.15)
    figure("fringe orders wrong", f"{row['orders']:.1e}", "under 1e-4", row["orders"] < 1e-4)
    info("fusing three maps", f"best {min(seconds) * 1e3:.0f} ms, median {np.median(seconds) * 1e3:.0f} ms")


def fuse(maps: list[PhaseMap]) -> tuple[PhaseMap, list[float]]:
    seconds, context = [], RecordingContext()
    FuseExposures.warm_up()
    for _ in range(7):
        began = time.perf_counter()
        fused = FuseExposures().run({"maps": tuple(maps)}, FuseExposures.Params(), context)
        seconds.append(time.perf_counter() - began)
    return fused, seconds


def tell(name: str, row: dict[str, Any]) -> None:
    told = (
        f"{row['share']:.2%} of the points, {row['good']:.2%} within {GOOD_RAD * 1e3:.0f} mrad; "
        f"sigma median {row['sigma'] * 1e3:.1f}, 99 % {row['worst'] * 1e3:.1f} mrad; "
        f"RMS error {row['rms'] * 1e3:.1f} mrad, {row['ratio']:.2f} of what is claimed; "
        f"wrong orders {row['orders']:.1e}"
    )
    info(name, told)


if __name__ == "__main__":
    main()
