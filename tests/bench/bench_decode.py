"""Speed and noise of decoding, 1392 x 1040, beside NumPy, `fringes` and a copy of the same bytes.

All are timed in turns in one run, so that the machine's mood counts for all; median and best are printed, and ratios
are those of the best. A copy is timed twice, in processes of their own: with every array in memory that is new to the
process, as the first copy of a program is, and with memory that is kept and used again, as a worker of the station
has it (`keep_freed_pages`); whatever is compared with it gets its memory in the same way. Figures in milliseconds hold
for two idle cores.
"""

from __future__ import annotations

import ctypes
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from stationkit import figure, info

from fringed.config.simulated import SimulationConfig
from fringed.data import CameraSettings, FrameSet, PatternSequence, PhaseMap
from fringed.hookspecs import FrameSetStart, ProjectorTarget
from fringed.simulation.optics import exact_calibration
from fringed.testing import RecordingContext
from fringed.workers.memory import keep_freed_pages
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder, PhaseShiftDecoder
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.parallel import thread_count
from fringed_plugins.phase.arctangent import fast_atan2
from fringed_plugins.phase.decode import LEAN, Keep, decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group, groups_of
from fringed_plugins.phase.weighting import weigh
from fringed_plugins.triangulation_plugin import Triangulate

WIDTH_PX, HEIGHT_PX, ROUNDS = 1392, 1040, 41
TARGET = ProjectorTarget(1024, 768)
SENSOR = NoiseModel.from_sensor(51.0, 12.0)
_SETTINGS = CameraSettings(electrons_per_dn=51.0, read_noise_electrons=12.0)
# Each pixel by itself, which is what NumPy, fringes and the figures of the issue do.
ALONE = Thresholds(saturation_dn=255.0, similar_neighbours=0, border_glow=0.0, window_snr=0.0)
_MMAP_THRESHOLD, _NEW_FROM_BYTES = -3, 128 * 1024

Array = np.ndarray[Any, Any]


def frames(sequence: PatternSequence) -> FrameSet:
    """Return what a camera sees of a slanted wavy sheet, with 1.5 grey levels of noise."""
    rng = np.random.default_rng(1)
    images = [0.8 * np.interp(columns(), np.arange(1024), pattern[0, :, 0]) for pattern in sequence.patterns]
    noisy = [np.clip(np.rint(image + rng.normal(0, 1.5, image.shape)), 0, 255).astype(np.uint8) for image in images]
    return FrameSet(np.array(noisy), sequence, settings=_SETTINGS)


def columns() -> Array:
    """Return the projector column that each pixel sees."""
    return np.linspace(20, 1000, WIDTH_PX) + 8 * np.sin(np.arange(HEIGHT_PX) / 90)[:, None]


def numpy_six(stack: Array, tuned: bool = False) -> tuple[Array, Array, Array]:
    """Return wrapped phase, modulation and mask of six steps, float32: as it is written down, or sums by BLAS."""
    steps = 2 * np.pi * np.arange(6, dtype=np.float32) / 6
    light = stack.astype(np.float32)
    if tuned:
        cosine = np.tensordot(np.cos(steps), light, 1) / 3
        sine = np.tensordot(-np.sin(steps), light, 1) / 3
    else:
        cosine = (light * np.cos(steps)[:, None, None]).sum(axis=0) / 3
        sine = -(light * np.sin(steps)[:, None, None]).sum(axis=0) / 3
    modulation = np.hypot(cosine, sine)
    background = light.mean(axis=0)
    misfit = (light**2).sum(axis=0) - 6 * background**2 - 3 * modulation**2
    rejected = (stack.max(axis=0) >= 255) | (modulation < 3) | (misfit > 60 + 0.03 * modulation**2)
    return np.where(rejected, np.nan, np.arctan2(sine, cosine)), modulation, rejected


def numpy_twelve(stack: Array) -> tuple[Array, ...]:
    """Return absolute phase, mask, deviation and modulation of three frequencies of four steps, float32."""
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
    variance = np.float32(SENSOR.constant_dn2) + np.float32(SENSOR.slope_dn) * level.mean(axis=0)
    sigma = np.sqrt(variance / 2) / modulation
    return np.where(rejected, np.nan, turns * np.float32(2 * np.pi)), rejected, sigma, modulation


def timed(jobs: dict[str, Callable[[], Any]], rounds: int) -> dict[str, list[float]]:
    """Return the milliseconds of each job, in turns, after one round that counts for nothing."""
    taken: dict[str, list[float]] = {name: [] for name in jobs}
    for turn in range(rounds + 1):
        for name, job in jobs.items():
            start = time.perf_counter()
            job()
            if turn:
                taken[name].append(1e3 * (time.perf_counter() - start))
    return taken


def told(times: list[float]) -> str:
    """Return median and best."""
    return f"median {statistics.median(times):.2f} ms, best {min(times):.2f} ms"


def kernels(memory: str) -> None:
    """Print the kernels beside copies, in one kind of memory."""
    if memory == "new":
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _NEW_FROM_BYTES)
    else:
        keep_freed_pages(400)
    twelve = frames(MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), TARGET))
    six = frames(PhaseShiftEncoder().encode(PhaseShiftEncoder.Params(periods=64.0), TARGET))
    many, one = (groups_of(s.sequence.frames, s.sequence.groups()) for s in (twelve, six))
    twelve_maps = Keep(background=False)
    taken = timed(
        {
            "copy 6": six.frames.copy,
            "6": lambda: decode(six.frames, one, SENSOR, ALONE, keep=LEAN, threads=2),
            "6 on one thread": lambda: decode(six.frames, one, SENSOR, ALONE, keep=LEAN, threads=1),
            "copy 12": twelve.frames.copy,
            "12": lambda: decode(twelve.frames, many, SENSOR, ALONE, 1024, keep=twelve_maps, threads=2),
            "12 on one thread": lambda: decode(twelve.frames, many, SENSOR, ALONE, 1024, keep=twelve_maps, threads=1),
        },
        ROUNDS,
    )
    taken |= timed(
        {
            "numpy 6": lambda: numpy_six(six.frames),
            "tuned 6": lambda: numpy_six(six.frames, tuned=True),
            "numpy 12": lambda: numpy_twelve(twelve.frames),
        },
        5,
    )
    best = {name: min(times) for name, times in taken.items()}
    for name, most in (("6", 1.5), ("12", 3.0)):
        ratio = best[name] / best[f"copy {name}"]
        what = (
            "6 steps to wrapped phase, modulation, mask" if name == "6" else "12 frames to absolute phase, mask, sigma"
        )
        text = f"{ratio:.2f} times a copy ({told(taken[name])}; copy {told(taken[f'copy {name}'])})"
        figure(f"{what}, {memory} memory", text, f"at most {most:g} times a copy of the same bytes", ratio <= most)
        info(f"... on one thread, {memory} memory", told(taken[f"{name} on one thread"]))
    faster = best["numpy 6"] / best["6"]
    figure(
        f"6 steps beside NumPy, {memory} memory",
        f"{faster:.0f} times as fast (NumPy {told(taken['numpy 6'])})",
        "at least 20 times",
        faster >= 20,
    )
    info(f"6 steps beside NumPy with sums by BLAS, {memory} memory", f"{best['tuned 6'] / best['6']:.0f} times as fast")
    info(f"12 frames beside NumPy, {memory} memory", f"{best['numpy 12'] / best['12']:.0f} times as fast")


def whole() -> None:
    """Print what decoders and triangulation take with all their defaults, neighbours included."""
    keep_freed_pages(400)
    context = RecordingContext(threads=thread_count())
    twelve = frames(MultiFrequencyEncoder().encode(MultiFrequencyEncoder.Params(), TARGET))
    six = frames(PhaseShiftEncoder().encode(PhaseShiftEncoder.Params(periods=64.0), TARGET))
    decoder, wrapped, range_ = MultiFrequencyDecoder(), PhaseShiftDecoder(), Triangulate()
    phase: PhaseMap = decoder.run({"frames": twelve}, decoder.Params(), context)
    inputs = {"phase": phase, "calibration": exact_calibration(SimulationConfig(), "bench")}
    taken = timed(
        {
            "copy": twelve.frames.copy,
            "12": lambda: decoder.run({"frames": twelve}, decoder.Params(), context),
            "confidence": lambda: decoder.run({"frames": twelve}, decoder.Params(keep_confidence=True), context),
            "weights": lambda: decoder.run({"frames": twelve}, decoder.Params(weights="noise"), context),
            "6": lambda: wrapped.run({"frames": six}, wrapped.Params(), context),
            "triangulate": lambda: range_.run(inputs, range_.Params(), context),
        },
        25,
    )
    ratio = min(taken["12"]) / min(taken["copy"])
    info(
        "the whole multi-frequency decoder, neighbours included",
        f"{told(taken['12'])}; {ratio:.1f} copies in kept memory",
    )
    info("... with confidence", told(taken["confidence"]))
    info("... weighted by noise", told(taken["weights"]))
    info("the whole phase-shift decoder, 6 steps", told(taken["6"]))
    figure(
        "1.45 million points triangulated", told(taken["triangulate"]), "about 15 ms", min(taken["triangulate"]) <= 15
    )
    for name, processor, frame_set in (("12 frames", decoder, twelve), ("6 steps", wrapped, six)):
        after = [streamed(processor, frame_set, context) for _ in range(25)]
        figure(f"{name} streamed: left after the last frame", told(after), "at most 5 ms", min(after) <= 5)


def streamed(processor: Any, frame_set: FrameSet, context: RecordingContext) -> float:
    """Return the milliseconds from the last frame to the phase map."""
    start = FrameSetStart(frame_set.sequence, frame_set.settings, frame_set.frames.shape[1:], "uint8")
    sink = processor.begin(start, processor.Params(), context)
    last = len(frame_set.frames) - 1
    for index in range(last):
        sink.add(index, frame_set.frames[index])
    begun = time.perf_counter()
    sink.add(last, frame_set.frames[last])
    sink.finish(frame_set, context)
    return 1e3 * (time.perf_counter() - begun)


def peer() -> None:
    """Print how long `fringes` takes for the same three frequencies of four steps, and whether it is right."""
    keep_freed_pages(400)
    try:
        from fringes import Fringes
    except ImportError:
        info("peer fringes", "not installed: pip install --no-deps fringes, as `make bench` does")
        return
    other = Fringes()
    other.reset()
    other.D, other.X, other.Y = 1, TARGET.width_px, 1
    other.K, other.N, other.v = 3, 4, [1, 8, 64]
    lines = np.asarray(other.encode()).reshape(other.T, -1).astype(float)
    rng = np.random.default_rng(1)
    images = [
        0.8 * np.interp(columns(), np.arange(1024), line) + rng.normal(0, 1.5, (HEIGHT_PX, WIDTH_PX)) for line in lines
    ]
    stack = np.clip(np.rint(images), 0, 255).astype(np.uint8)
    steps, groups = 2 * np.pi * np.arange(4) / 4, []
    for k, period in enumerate(
        (1024.0, 128.0, 16.0)
    ):  # its patterns run the other way: I = A + B cos(2 pi u / p - shift)
        groups.append(Group(tuple(range(4 * k, 4 * k + 4)), tuple(-steps), period, _initial(lines[4 * k], period)))
    keep = Keep(background=False)
    # One after the other: its threads keep a core busy for a while after each call, waiting for more.
    taken = timed({"ours": lambda: decode(stack, groups, SENSOR, ALONE, 1024, keep=keep)}, ROUNDS)
    taken |= timed({"theirs": lambda: other.decode(stack[..., None], check_overexposure=False)}, 7)
    got = decode(stack, groups, SENSOR, ALONE, 1024, keep=keep)
    ours = (got.phase_rad - groups[-1].initial_rad) * 16 / (2 * np.pi)
    theirs = np.squeeze(np.asarray(other.decode(stack[..., None], check_overexposure=False).x)).reshape(
        HEIGHT_PX, WIDTH_PX
    )
    errors = [np.abs(found - columns()) for found in (ours, theirs)]
    right = [
        f"{name} median error {np.nanmedian(e):.3f} px, {np.mean(e > 8):.1e} wrong"
        for name, e in zip(("ours", "theirs"), errors, strict=True)
    ]
    ratio = min(taken["theirs"]) / min(taken["ours"])
    figure(
        "12 frames beside fringes",
        f"{ratio:.0f} times as fast ({told(taken['ours'])}; fringes {told(taken['theirs'])})",
        "at least 50 times",
        ratio >= 50,
    )
    info("... of the same frames", "; ".join(right))


def _initial(line: Array, period: float) -> float:
    """Return the phase of column 0 in the first frame of a frequency."""
    u = np.arange(len(line))
    return float(np.angle(np.sum((line - line.mean()) * np.exp(-2j * np.pi * u / period))))


def arctangent() -> None:
    """Print the largest error of the kernel's arctangent."""
    from numba import njit

    @njit
    def all_of(y: Array, x: Array, out: Array) -> None:
        for i in range(y.size):
            out[i] = fast_atan2(y[i], x[i])

    angle = np.linspace(-np.pi, np.pi, 4_000_001)
    worst = 0.0
    for scale in (1e-3, 1.0, 1e4):
        y, x = (scale * np.sin(angle)).astype(np.float32), (scale * np.cos(angle)).astype(np.float32)
        found = np.empty_like(y)
        all_of(y, x, found)
        off = found - np.arctan2(y.astype(float), x.astype(float))
        worst = max(worst, float(np.abs(np.angle(np.exp(1j * off))).max()))
    figure("arctangent, float32, 12 million angles", f"{worst:.1e} rad", "under 1e-6 rad", worst < 1e-6)


def noise() -> None:
    """Print the scatter of the phase over the Cramer-Rao bound, shot and read noise, N from 3 to 16."""
    rng = np.random.default_rng(0)
    phases = np.linspace(-np.pi, np.pi, 96, endpoint=False)
    for modulation in (50.0, 80.0, 105.0):
        ratios = [_over_bound(steps, modulation, phases, rng) for steps in range(3, 17)]
        plain, weighed = (max(r[i] for r in ratios) for i in (0, 1))
        what = f"phase noise, N = 3 to 16, background 110, modulation {modulation:g} DN"
        figure(f"{what}, weights 'noise'", f"at most {weighed:.3f} of the bound", "within 3 %", weighed <= 1.03)
        info(f"{what}, equal weights", f"at most {plain:.3f} of the bound; sigma_rad tells it")


def _over_bound(steps: int, modulation: float, phases: Array, rng: np.random.Generator) -> tuple[float, float]:
    shifts = 2 * np.pi * np.arange(steps) / steps
    angle = phases + shifts[:, None]
    light = 110 + modulation * np.cos(angle)
    variance = SENSOR.constant_dn2 + SENSOR.slope_dn * light
    gradient = np.stack([np.ones_like(angle), np.cos(angle), -modulation * np.sin(angle)], axis=-1)
    information = np.einsum("kxi,kxj,kx->xij", gradient, gradient, 1 / variance)
    bound = np.sqrt(np.linalg.inv(information)[:, 2, 2].mean())
    scatter = np.sqrt(variance)[:, None, :] * rng.normal(size=(steps, 2000, phases.size))
    stack = (light[:, None, :] + scatter).astype(np.float32)
    group = Group(tuple(range(steps)), tuple(shifts), 16.0)
    got = decode(stack, [group], SENSOR, ALONE)
    plain = _rms(got.phase_rad, phases)
    weigh(got.phase_rad, got.sigma_rad, stack, group, SENSOR)
    return plain / bound, _rms(got.phase_rad, phases) / bound


def _rms(found: Array, phases: Array) -> float:
    return float(np.sqrt(np.nanmean(np.angle(np.exp(1j * (found.astype(float) - phases))) ** 2)))


def main() -> None:
    parts: dict[str, Callable[[], None]] = {
        "new": lambda: kernels("new"), "kept": lambda: kernels("kept"), "whole": whole, "peer": peer,
    }  # fmt: skip
    if len(sys.argv) > 1:
        parts[sys.argv[1]]()
        return
    info("processor", f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name in parts:  # allocators remember: a process for each
        subprocess.run([sys.executable, __file__, name], check=True)
    arctangent()
    noise()


if __name__ == "__main__":
    main()
