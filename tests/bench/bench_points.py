"""Speed of phase to points with deviations, 1392 x 1040, beside a copy of the same bytes, and how exact they are.

The bytes are what goes in (phase, its deviation, mask and background) and what comes out (points, their deviation, mask
and intensity): 33 for each pixel. Both are timed in turns in one run, in processes of their own for memory that is new
to the process and for memory that is kept and used again, as a worker of the station has it; ratios are those of the
best. The processor is timed whole: sampling for the thresholds, flyers, and the covariance of the calibration included.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from bench_decode import timed, told
from stationkit import figure, info

from fringed.config.simulated import SimulationConfig
from fringed.data import Calibration, PhaseMap, RangeImage
from fringed.simulation.optics import exact_calibration
from fringed.testing import RecordingContext
from fringed.workers.memory import keep_freed_pages
from fringed_plugins.calibration.pixel.derivatives import NUMBERS
from fringed_plugins.calibration.reference import phase_at_depth
from fringed_plugins.calibrators.pixel_models import FitPixelModel
from fringed_plugins.calibrators.ranging import pinhole, rig_of
from fringed_plugins.triangulation_plugin import Triangulate

WIDTH_PX, HEIGHT_PX, ROUNDS, PERIOD_PX, MOST = 1392, 1040, 31, 16.0, 3.0
DEPTHS_MM = (900.0, 930.0, 960.0, 990.0, 1020.0)
_MMAP_THRESHOLD, _NEW_FROM_BYTES = -3, 128 * 1024
_DEVIATIONS = np.array(
    [
        *(0.15, 0.15, 0.1, 0.1, 4e-4, 2e-3, 3e-5, 3e-5, 3e-3),
        *(0.2, 0.2, 0.15, 0.15, 8e-4, 4e-3, 5e-5, 5e-5, 6e-3),
        *(4e-5, 5e-5, 3e-5, 0.02, 0.02, 0.05),
    ]
)

Array = np.ndarray[Any, Any]


def relief() -> Array:
    """Return depths (mm) of a bump with waves."""
    y, x = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX]
    bump: Array = 1000 - 60 * np.exp(-(((x - 700) / 300) ** 2) - ((y - 500) / 300) ** 2) + 3 * np.sin(x / 60)
    return bump


def phase_of(calibration: Calibration, depth_mm: Array) -> PhaseMap:
    """Return the phase map of a surface, without noise."""
    shape = depth_mm.shape
    empty = PhaseMap(
        np.zeros(shape, np.float32), np.full(shape, 80, np.float32), np.full(shape, 100, np.float32),
        np.zeros(shape, np.uint16), "absolute", PERIOD_PX, sigma_rad=np.full(shape, 0.01, np.float32),
    )  # fmt: skip
    camera, axis, fringes = rig_of(empty, calibration)
    return replace(empty, phase_rad=phase_at_depth(camera, axis, fringes, depth_mm).astype(np.float32))


def triangulated(phase: PhaseMap, calibration: Calibration, threads: int) -> RangeImage:
    inputs = {"phase": phase, "calibration": calibration}
    return Triangulate().run(inputs, Triangulate.Params(), RecordingContext(threads=threads))


def calibrations() -> dict[str, Calibration]:
    """Return the rig as it is, as it is known by a calibration, and by a model of each pixel."""
    exact = exact_calibration(SimulationConfig(), "bench")
    known = replace(exact, covariance=np.diag(_DEVIATIONS**2), parameters=NUMBERS)
    planes = tuple(phase_of(exact, np.full((HEIGHT_PX, WIDTH_PX), depth)) for depth in DEPTHS_MM)
    start = time.perf_counter()
    pixels = FitPixelModel().run(
        {"phases": planes, "calibration": exact}, FitPixelModel.Params(depths_mm=DEPTHS_MM), RecordingContext(threads=2)
    )
    info("models of 1.45 million pixels fitted to 5 planes", f"{time.perf_counter() - start:.2f} s with compilation")
    return {"stereo": exact, "with the calibration's covariance": known, "model of each pixel": pixels}


def speed(memory: str) -> None:
    """Print the processor beside copies, in one kind of memory."""
    if memory == "new":
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _NEW_FROM_BYTES)
    else:
        keep_freed_pages(400)
    rigs = calibrations()
    phase = phase_of(rigs["stereo"], relief())
    went_in = (phase.phase_rad, phase.sigma_rad, phase.rejected, phase.background)
    first = triangulated(phase, rigs["stereo"], 2)
    came_out = (first.xyz_mm, first.sigma_mm, first.rejected, first.intensity)
    assert all(part is not None for part in went_in + came_out)
    everything: Any = went_in + came_out
    jobs: dict[str, Callable[[], Any]] = {
        "copy": lambda: [part.copy() for part in everything],
        "copy of what comes out": lambda: [part.copy() for part in everything[4:]],
        "one thread": lambda: triangulated(phase, rigs["with the calibration's covariance"], 1),
    }
    for name, rig in rigs.items():
        jobs[name] = lambda rig=rig: triangulated(phase, rig, 2)
    taken = timed(jobs, ROUNDS)
    best = {name: min(times) for name, times in taken.items()}
    for name in rigs:
        ratio = best[name] / best["copy"]
        text = f"{ratio:.2f} times a copy ({told(taken[name])}; copy {told(taken['copy'])})"
        what = f"1.45 million points, phase to XYZ and sigma, {name}, {memory} memory"
        figure(what, text, f"at most {MOST:g} times a copy of the same bytes", ratio <= MOST)
    info(
        f"... beside a copy of what comes out alone, {memory} memory",
        f"{best['stereo'] / best['copy of what comes out']:.2f} times ({told(taken['copy of what comes out'])})",
    )
    info(f"... on one thread, {memory} memory", told(taken["one thread"]))


def exactness() -> None:
    """Print the largest error against the depths that the phases were made of."""
    depth = relief()
    for name, rig in calibrations().items():
        found = triangulated(phase_of(exact_calibration(SimulationConfig(), "bench"), depth), rig, 2)
        kept = found.rejected == 0
        worst = float(np.abs(found.xyz_mm[..., 2] - depth)[kept].max())
        most = 0.01 if rig.model == "pixel" else 1e-3
        text = f"{worst:.1e} mm, {kept.mean():.2%} of the points"
        figure(f"largest error of 1.45 million points, {name}", text, f"{most:g} mm", worst < most)
    start = time.perf_counter()
    camera = pinhole(replace(rig.camera, distortion=rig.camera.distortion * 1.001))
    from fringed_plugins.calibration.rig import camera_rays

    camera_rays(camera, 2)
    info("rays of another camera", f"{1e3 * (time.perf_counter() - start):.0f} ms, once")


def main() -> None:
    parts: dict[str, Callable[[], None]] = {
        "new": lambda: speed("new"), "kept": lambda: speed("kept"), "exactness": exactness
    }  # fmt: skip
    if len(sys.argv) > 1:
        parts[sys.argv[1]]()
        return
    info("processor", f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name in parts:  # allocators remember: a process for each
        subprocess.run([sys.executable, __file__, name], check=True)


if __name__ == "__main__":
    main()
