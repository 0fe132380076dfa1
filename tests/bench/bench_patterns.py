"""Patterns: the phase error of each style against blur, what dithering gains, and the best frequencies.

    python tests/bench/bench_patterns.py

The projector is a tone curve and a Gaussian blur, the camera is ideal, the phase plain least squares written here: what
is printed is the patterns' own error. Blur is the Gaussian's standard deviation as a share of the period.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from stationkit import info

from fringed.config import validate
from fringed.data import PatternSequence
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder, PhaseShiftEncoder
from fringed_plugins.phase.projection import frequencies

WIDTH_PX, HEIGHT_PX, MARGIN_PX = 768, 256, 64
TARGET = ProjectorTarget(WIDTH_PX, HEIGHT_PX)
GAMMA = (np.arange(256) / 255) ** 2.2
LINEAR = np.arange(256) / 255
STYLES = (
    "sinusoidal", "triangular", "trapezoidal", "sawtooth", "binary", "binary-pulse-width", "binary-dithered",
)  # fmt: skip
DITHERS = ("none", "quiet", "ordered", "error-diffusion")
BLURS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4)


def encode(target: ProjectorTarget = TARGET, **params: Any) -> PatternSequence:
    """Return a sequence of one frequency."""
    return PhaseShiftEncoder().encode(validate(params, PhaseShiftEncoder.Params), target)


def lights(sequence: PatternSequence, blur_px: float, tone: Any = LINEAR) -> Any:
    """Return what an ideal camera sees of each pattern, (frames, height, width) without a margin."""
    inner = (slice(MARGIN_PX, -MARGIN_PX), slice(MARGIN_PX, -MARGIN_PX))
    seen = []
    for pattern in sequence.patterns:
        light = np.broadcast_to(tone[pattern[..., 0]], (HEIGHT_PX, WIDTH_PX))
        seen.append((gaussian_filter(light, blur_px) if blur_px else light)[inner])
    return np.array(seen)


def phase_error(sequence: PatternSequence, blur_px: float, tone: Any = LINEAR) -> tuple[float, float]:
    """Return the RMS error of the phase (rad), and the modulation over that of a sinusoid in focus (1/2)."""
    first = sequence.frames[0]
    shifts = np.array([frame.shift_rad for frame in sequence.frames])
    model = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    _, c, s = np.tensordot(np.linalg.pinv(model), lights(sequence, blur_px, tone), 1)
    u = np.arange(MARGIN_PX, WIDTH_PX - MARGIN_PX)
    true = 2 * np.pi * u / first.period_px + first.initial_phase_rad
    off = np.angle(np.exp(1j * (np.arctan2(s, c) - true)))
    return float(np.sqrt((off**2).mean())), float(2 * np.hypot(c, s).mean())


def style_errors(steps: int, period_px: float = 36.0) -> dict[str, list[tuple[float, float]]]:
    """Return error and modulation of each style at each blur."""
    found = {}
    for style in STYLES:
        sequence = encode(style=style, period_px=period_px, steps=steps)
        found[style] = [phase_error(sequence, blur * period_px) for blur in BLURS]
    return found


def dither_errors(period_px: float, steps: int, blur_px: float) -> dict[str, tuple[float, float]]:
    """Return for each way to round the RMS error of the local mean light (of its range), and of the phase (rad)."""
    target = ProjectorTarget(WIDTH_PX, HEIGHT_PX, GAMMA)
    u = np.arange(MARGIN_PX, WIDTH_PX - MARGIN_PX)
    found = {}
    for dither in DITHERS:
        sequence = encode(target, period_px=period_px, steps=steps, dither=dither)
        damping = np.exp(-2 * (np.pi * blur_px / period_px) ** 2)
        wanted = [(1 + damping * np.cos(2 * np.pi * u / period_px + frame.shift_rad)) / 2 for frame in sequence.frames]
        light = lights(sequence, blur_px, GAMMA) - np.array(wanted)[:, None]
        found[dither] = float(np.sqrt((light**2).mean())), phase_error(sequence, blur_px, GAMMA)[0]
    return found


def main() -> None:
    for steps in (3, 4, 5):
        for style, found in style_errors(steps).items():
            text = ", ".join(f"{blur:g}: {error:.4f}" for blur, (error, _) in zip(BLURS, found, strict=True))
            info(f"{style}, {steps} steps, 36 px, phase error (rad rms) at blur/period", text)
    for period_px, blur_px in ((16.0, 0.8), (32.0, 0.8), (32.0, 2.0), (48.0, 2.0)):
        for dither, (light, phase) in dither_errors(period_px, 4, blur_px).items():
            info(
                f"gamma 2.2 compensated, {period_px:g} px, blur {blur_px:g} px, dither {dither}",
                f"local mean light off by {1e4 * light:.2f}e-4, phase by {1e3 * phase:.3f} mrad rms (4 steps)",
            )
    for frames, snr in ((9, 20.0), (12, 20.0), (12, 5.0), (24, 5.0)):
        for design in (
            frequencies.design_hierarchical,
            frequencies.design_heterodyne,
            frequencies.design_number_theoretic,
        ):
            made = design(1024, frames, snr)
            info(
                f"{made.method}, {frames} frames, SNR {snr:g}, 1024 px",
                f"periods {made.periods}, steps {made.steps}, column noise {made.sigma_px:.4f} px alone, "
                f"{made.combined_sigma_px:.4f} px combined, wrong orders {made.failure:.0e}",
            )
    target = ProjectorTarget(1024, 768, GAMMA)
    for name, params in (("lines", {}), ("dithered", {"dither": "error-diffusion"})):
        best = min(_seconds(params, target) for _ in range(5))
        info(f"12 patterns of 1024 x 768, {name}", f"{1e3 * best:.1f} ms to encode (best of 5)")


def _seconds(params: dict[str, Any], target: ProjectorTarget) -> float:
    asked = validate(params, MultiFrequencyEncoder.Params)
    begun_s = time.perf_counter()
    MultiFrequencyEncoder().encode(asked, target)
    return time.perf_counter() - begun_s


if __name__ == "__main__":
    main()
