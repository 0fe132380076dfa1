"""Fringes from first principles, to compare methods on: surface, light, gamma, blur, noise.

Shares no code with the simulated rig or with any plug-in; what is projected comes from the encoder under test, as
grey levels. SNR is the modulation of a white surface over the standard deviation of one frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fringed.data import Array, CameraSettings, FrameSet, PatternSequence, PhaseMap

FULL_DN, AMBIENT = 210.0, 0.06
CROSSTALK = np.array([[0.90, 0.08, 0.02], [0.07, 0.85, 0.08], [0.01, 0.09, 0.90]])
_ELECTRONS = 1e6  # for one grey level: what noise there is, is given by its deviation


@dataclass(frozen=True)
class Scene:
    """`column` and `row` (height, width) are the projector pixels that each camera pixel sees; `albedo` 0 to 1."""

    column: Array
    row: Array
    albedo: Array
    lit: Array


@dataclass(frozen=True)
class Conditions:
    """How it is seen: noise as SNR (inf: none), the projector's gamma, its blur in pixels, what R, G and B reflect."""

    snr: float = 25.0
    gamma: float = 1.0
    blur_px: float = 0.7
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    seed: int = 1


def relief(width: int = 512, height: int = 160, steps: bool = False, slope: float = 1.7) -> Scene:
    """Return a smooth relief, `slope` columns a pixel, or one with jumps of 2 to 40, a shadow and a dark patch."""
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    bumps = 14 * np.sin(x / 61) * np.cos(y / 37) + 9 * np.exp(-((x - 0.6 * width) ** 2 + (y - 0.5 * height) ** 2) / 900)
    column, albedo = 70 + slope * x + bumps, 0.75 + 0.2 * np.sin(x / 83 + y / 47)
    lit = np.ones((height, width), bool)
    if steps:
        for left, jump in ((90, 2.0), (170, 7.0), (250, 16.0), (330, -23.0), (400, 40.0)):
            column += jump * (x >= left)
        lit[30:70, 120:150] = False
        albedo[90:130, 420:470] *= 0.12
    return Scene(column, 100 + 3.1 * y + 0.02 * x, albedo, lit)


def see(sequence: PatternSequence, scene: Scene, how: Conditions) -> FrameSet:
    """Return the 8-bit frames of a camera; those of one shot get the three colours of one exposure."""
    rng = np.random.default_rng(how.seed)
    sigma_dn = 0.5 * FULL_DN / how.snr
    frames = []
    for frame, pattern in zip(sequence.frames, sequence.patterns, strict=True):
        light = np.stack([_sampled(pattern[..., c], scene, how) for c in range(pattern.shape[2])], axis=-1)
        if frame.shot >= 0:
            camera = ("red", "green", "blue").index(frame.channel)
            seen = (light * how.colour) @ CROSSTALK[camera] / CROSSTALK[camera].sum()
        else:
            seen = light.max(axis=-1)
        image = FULL_DN * scene.albedo * (np.where(scene.lit, seen, 0.0) + AMBIENT)
        noise = rng.normal(0.0, sigma_dn, image.shape) if np.isfinite(how.snr) else 0.0
        frames.append(np.clip(np.rint(image + noise), 0, 255).astype(np.uint8))
    read = sigma_dn * _ELECTRONS if np.isfinite(how.snr) else 0.0
    settings = CameraSettings(
        electrons_per_dn=_ELECTRONS, read_noise_electrons=read, channel="rgb" if _shots(sequence) else "green"
    )
    return FrameSet(np.array(frames), sequence, settings=settings)


def _shots(sequence: PatternSequence) -> bool:
    return any(frame.shot >= 0 for frame in sequence.frames)


def _sampled(grey: Array, scene: Scene, how: Conditions) -> Array:
    """Return the light that each camera pixel gets from one channel of a pattern."""
    light = (grey / 255.0) ** how.gamma
    for axis in (0, 1):
        if light.shape[axis] > 1:
            light = gaussian_filter1d(light, how.blur_px, axis=axis, mode="nearest")
    if light.shape[0] == 1:
        return np.interp(scene.column, np.arange(light.shape[1]), light[0])
    if light.shape[1] == 1:
        return np.interp(scene.row, np.arange(light.shape[0]), light[:, 0])
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(light, [scene.row, scene.column], order=1, mode="nearest"))


@dataclass(frozen=True)
class Errors:
    """Against the truth, in projector pixels: RMS of what is right within half a period, wrong orders, what is kept."""

    rms_px: float
    wrong: float
    kept: float
    sigma_px: float


def errors_of(phase: PhaseMap, scene: Scene) -> Errors:
    """Compare a phase map with the scene; for wrapped and relative ones whole periods are nobody's fault."""
    truth = scene.column if phase.orientation == "columns" else scene.row
    pixels = phase.phase_rad.astype(float) - phase.initial_phase_rad
    off = pixels * phase.period_px / (2 * np.pi) - truth
    kept = (phase.rejected == 0) & np.isfinite(off)
    whole = np.rint(off / phase.period_px)
    if phase.kind == "relative" and kept.any():
        whole -= np.median(whole[kept])
    wrong = kept & (whole != 0) if phase.kind != "wrapped" else np.zeros_like(kept)
    fine = (off - phase.period_px * np.rint(off / phase.period_px))[kept & scene.lit]
    sigma = phase.sigma_rad[kept] * phase.period_px / (2 * np.pi) if phase.sigma_rad is not None else np.array([np.nan])
    return Errors(
        float(np.sqrt(np.mean(fine**2))) if fine.size else float("nan"),
        float(wrong.sum() / max(kept.sum(), 1)),
        float((kept & scene.lit).sum() / scene.lit.sum()),
        float(np.sqrt(np.mean(sigma**2))) if sigma.size else float("nan"),
    )


def without_noise(how: Conditions, **changes: Any) -> Conditions:
    """Return the conditions without noise."""
    return replace(how, snr=float("inf"), **changes)
