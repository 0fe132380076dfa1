"""Speed of decoding, triangulation and unwrapping, 1392 x 1040, warm, beside a plain NumPy decoder and a copy.

All are timed in turns in one run, so that the machine's mood counts for all; the median and the best are printed.
Memory is kept as a worker keeps it. The figures in milliseconds hold for two idle cores.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from stationkit import figure, info

from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings, FrameSet, PatternSequence, PhaseMap
from fringed.hookspecs import ProjectorTarget
from fringed.simulation.optics import exact_calibration
from fringed.testing import RecordingContext
from fringed.workers.memory import keep_freed_pages
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.parallel import thread_count
from fringed_plugins.triangulation_plugin import Triangulate
from fringed_plugins.unwrap.spatial import unwrap

WIDTH_PX, HEIGHT_PX, ROUNDS = 1392, 1040, 25
DECODE_MS, TRIANGULATE_MS, UNWRAP_MS = 10.0, 15.0, 1000.0
_SETTINGS = CameraSettings(electrons_per_dn=51.0, read_noise_electrons=12.0)


def frames(sequence: PatternSequence) -> FrameSet:
    """Return what a camera sees of a slanted wavy sheet, with 1.5 grey levels of noise."""
    u = np.linspace(20, 1000, WIDTH_PX) + 8 * np.sin(np.arange(HEIGHT_PX) / 90)[:, None]
    rng = np.random.default_rng(1)
    images = [0.8 * np.interp(u, np.arange(1024), pattern[0, :, 0]) for pattern in sequence.patterns]
    noisy = [np.clip(np.rint(image + rng.normal(0, 1.5, image.shape)), 0, 255).astype(np.uint8) for image in images]
    return FrameSet(np.array(noisy), sequence, settings=_SETTINGS)


def numpy_decode(stack: np.ndarray[Any, Any]) -> tuple[Any, ...]:
    """Do in NumPy, in float32, what the kernel does; without neighbours and noise."""
    frames_ = stack.astype(np.float32).reshape(3, 4, HEIGHT_PX, WIDTH_PX)
    turns, rejected = None, stack.max(axis=0) >= 255
    for level, ratio in zip(frames_, (1, 8, 8), strict=True):
        sine, cosine = (level[3] - level[1]) / 2, (level[0] - level[2]) / 2
        part = np.arctan2(sine, cosine) / np.float32(2 * np.pi)
        if turns is None:
            turns = part % 1
        else:
            predicted = turns * ratio
            turns = part + np.rint(predicted - part)
            rejected |= np.abs(predicted - turns) > 0.3
        modulation = np.hypot(sine, cosine)
        residual = np.abs(level[0] - level[1] + level[2] - level[3]) / 2
        rejected |= (modulation < 10) | (residual > 8 + 0.1 * modulation)
    assert turns is not None
    background = level.mean(axis=0)
    return np.where(rejected, np.nan, turns * np.float32(2 * np.pi)), modulation, background, rejected


def timed(jobs: dict[str, Callable[[], Any]], rounds: int) -> dict[str, list[float]]:
    taken: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            start = time.perf_counter()
            job()
            taken[name].append(1e3 * (time.perf_counter() - start))
    return taken


def main() -> None:
    keep_freed_pages(400)
    calibration = exact_calibration(msgspec.convert({}, SimulationConfig), "bench")
    target, context = ProjectorTarget(1024, 768), RecordingContext(threads=thread_count())
    twelve = frames(MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), target))
    six = frames(PhaseShiftEncoder().encode(PhaseShiftEncoder.Params(periods=64.0), target))
    decoder, wrapped, range_ = MultiFrequencyDecoder(), PhaseShiftDecoder(), Triangulate()
    phase: PhaseMap = decoder.run({"frames": twelve}, decoder.Params(), context)
    inputs = {"phase": phase, "calibration": calibration}
    taken = timed(
        {
            "decode": lambda: decoder.run({"frames": twelve}, decoder.Params(), context),
            "copy": twelve.frames.copy,
            "numpy": lambda: numpy_decode(twelve.frames),
            "six": lambda: wrapped.run({"frames": six}, wrapped.Params(), context),
            "triangulate": lambda: range_.run(inputs, range_.Params(), context),
        },
        ROUNDS,
    )
    wave = np.angle(np.exp(1j * phase.phase_rad)).astype(np.float32)
    taken |= timed({"unwrap": lambda: unwrap(wave, phase.modulation)}, 3)
    middle = {name: statistics.median(times) for name, times in taken.items()}
    told = {name: f"median {middle[name]:.1f} ms, best {min(times):.1f} ms" for name, times in taken.items()}
    figure(
        "12 frames to absolute phase, mask and sigma", told["decode"], "about 10 ms", min(taken["decode"]) <= DECODE_MS
    )
    info("a copy of the same 12 frames", told["copy"])
    info("decode over copy", f"{middle['decode'] / middle['copy']:.1f}")
    info("NumPy on the same 12 frames", f"{told['numpy']}; {middle['numpy'] / middle['decode']:.1f} times slower")
    info("6 steps to wrapped phase, mask and sigma", told["six"])
    figure(
        "1.45 million points triangulated",
        told["triangulate"],
        "about 15 ms",
        min(taken["triangulate"]) <= TRIANGULATE_MS,
    )
    figure("1.45 million pixels unwrapped in space", told["unwrap"], "under 1 s", middle["unwrap"] < UNWRAP_MS)


if __name__ == "__main__":
    main()
