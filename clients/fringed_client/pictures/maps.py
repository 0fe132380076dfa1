"""Maps over the camera's pixels: frames, phases, modulation, masks, depth.

Owns which colours, limits and units each quantity has.
"""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from fringed.data import Array, FrameSet, PhaseMap, RangeImage, Reject
from fringed_client.pictures.figures import INK, PAPER, colour_bar, figure, labelled, limits, save, thinned, titled

_REASONS = {
    Reject.KEPT: ("kept", "#dfe8e3"),
    Reject.SATURATED: ("saturated", "#d1495b"),
    Reject.LOW_MODULATION: ("low modulation: dark, shadow or backdrop", "#30363d"),
    Reject.FRINGE_ORDER: ("fringe order contradicts", "#e8a33d"),
    Reject.RESIDUAL: ("no sinusoid fits", "#8e5ea2"),
    Reject.OUT_OF_RANGE: ("out of range", "#2e86ab"),
    Reject.ISOLATED: ("isolated", "#6ca965"),
    Reject.DISCONTINUITY: ("depth edge", "#c9693c"),
    Reject.OTHER: ("other", "#9c9c9c"),
    Reject.HOT_PIXEL: ("hot pixel", "#f06ab2"),
    Reject.SHADOW: ("shadow: light without fringes", "#5b6770"),
    Reject.REPEATED: ("repeats a projector pixel", "#a3c4dc"),
}


def draw_map(
    path: Path,
    values: Array,
    title: str,
    label: str,
    *,
    colours: str = "viridis",
    span: tuple[float, float] | None = None,
    simulated: bool = False,
    ticks: dict[float, str] | None = None,
) -> Path:
    """Draw values over camera pixels with a colour bar; NaN is paper."""
    height, width = values.shape
    drawn = figure(7.6, 7.6 * 0.80 * height / width + 0.75)
    axes = drawn.add_subplot()
    axes.set_facecolor(PAPER)
    low, high = span or limits(values)
    shown = axes.imshow(
        thinned(values), cmap=colours, vmin=low, vmax=high, extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        interpolation="nearest",
    )  # fmt: skip
    titled(axes, title, simulated)
    labelled(axes, "column / px", "row / px")
    bar = colour_bar(drawn, shown, axes, label, "neither" if span else "both")
    if ticks:
        bar.set_ticks(list(ticks), labels=list(ticks.values()))
    return save(drawn, path)


def draw_frame(path: Path, frames: FrameSet, index: int) -> Path:
    """Draw one captured frame."""
    described = frames.sequence.frames[index]
    what = f"{described.style}, period {described.period_px:g} px, shift {np.degrees(described.shift_rad):.0f}°"
    top = 255.0 if frames.frames.dtype == np.uint8 else float(2 ** max(frames.settings.bits, 9) - 1)
    title = f"{frames.role}, frame {index + 1} of {len(frames.frames)}: {what}"
    simulated = frames.provenance.simulated
    return draw_map(path, frames.frames[index], title, "grey level / DN", colours="gray", span=(0, top),
                    simulated=simulated)  # fmt: skip


def draw_wrapped(path: Path, phase: PhaseMap) -> Path:
    """Draw the wrapped phase of the finest fringes over a cyclic colour map."""
    wrapped = phase.wrapped_rad if phase.wrapped_rad is not None else _wrapped(phase)
    ticks = {-pi: "−π", -pi / 2: "−π/2", 0.0: "0", pi / 2: "π/2", pi: "π"}
    title = f"wrapped phase, period {phase.period_px:g} px"
    return draw_map(path, wrapped, title, "phase / rad", colours="twilight", span=(-pi, pi),
                    simulated=phase.provenance.simulated, ticks=ticks)  # fmt: skip


def _wrapped(phase: PhaseMap) -> Array:
    return np.asarray(np.arctan2(np.sin(phase.phase_rad), np.cos(phase.phase_rad)))


def draw_phase(path: Path, phase: PhaseMap) -> Path:
    """Draw the phase as it is: absolute (with the projector's pixels beside), relative or a difference."""
    what = "difference of relative phases" if phase.difference_to else f"{phase.kind} phase"
    if phase.kind != "absolute":
        title = f"{what}, along projector {phase.orientation}"
        return draw_map(path, phase.phase_rad, title, "phase / rad", simulated=phase.provenance.simulated)
    one = "column" if phase.orientation == "columns" else "row"
    low, high = limits(phase.phase_rad)
    ticks = {tick: f"{tick:.0f}\n({_pixel(phase, tick):.0f})" for tick in np.linspace(low, high, 6)[1:-1]}
    title = f"absolute phase of projector {phase.orientation}, period {phase.period_px:g} px"
    return draw_map(path, phase.phase_rad, title, f"phase / rad (projector {one} / px)",
                    simulated=phase.provenance.simulated, ticks=ticks)  # fmt: skip


def _pixel(phase: PhaseMap, phase_rad: float) -> float:
    return (phase_rad - phase.initial_phase_rad) * phase.period_px / (2 * pi)


def draw_modulation(path: Path, phase: PhaseMap) -> Path:
    """Draw the fringes' amplitude."""
    high = limits(phase.modulation)[1]
    return draw_map(path, phase.modulation, "modulation", "amplitude / DN", colours="magma", span=(0, high),
                    simulated=phase.provenance.simulated)  # fmt: skip


def draw_phase_sigma(path: Path, phase: PhaseMap) -> Path | None:
    """Draw the predicted standard deviation of the phase; None where the map carries none."""
    if phase.sigma_rad is None:
        return None
    sigma: Any = np.where(phase.rejected == 0, phase.sigma_rad * 1000, np.nan)
    return draw_map(path, sigma, "predicted standard deviation of the phase", "σ / mrad", colours="cividis",
                    span=(0.0, limits(sigma, 1, 98)[1]), simulated=phase.provenance.simulated)  # fmt: skip


def draw_confidence(path: Path, phase: PhaseMap) -> Path | None:
    """Draw by how much noise each fringe order is not the next one; None where the map carries nothing of it."""
    if phase.confidence is None:
        return None
    sure: Any = np.where(phase.rejected == 0, phase.confidence, np.nan)
    return draw_map(path, sure, "confidence of the fringe order", "standard deviations from the next order",
                    colours="cividis", span=(0.0, limits(sure, 1, 98)[1]),
                    simulated=phase.provenance.simulated)  # fmt: skip


def draw_mask(path: Path, rejected: Array, simulated: bool) -> Path:
    """Draw which pixels were kept, and why the others were not, with each reason's share."""
    height, width = rejected.shape
    first = np.where(rejected == 0, 0, rejected & -rejected.astype(np.int32)).astype(np.uint16)  # lowest flag
    present = [reason for reason in _REASONS if (first == reason).any()]
    codes = np.searchsorted([int(r) for r in present], first)
    drawn = figure(7.6, 7.6 * 0.80 * height / width + 0.95)
    axes = drawn.add_subplot()
    colours = ListedColormap([_REASONS[r][1] for r in present])
    norm = BoundaryNorm(np.arange(len(present) + 1) - 0.5, len(present))
    axes.imshow(thinned(codes), cmap=colours, norm=norm, extent=(-0.5, width - 0.5, height - 0.5, -0.5),
                interpolation="nearest")  # fmt: skip
    shares = [np.mean(first == reason) for reason in present]
    patches = [
        Patch(facecolor=_REASONS[r][1], edgecolor=INK, linewidth=0.4, label=f"{_REASONS[r][0]} ({_percent(share)})")
        for r, share in zip(present, shares, strict=True)
    ]
    axes.legend(handles=patches, loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=3, fontsize=8, frameon=False)
    titled(axes, "mask", simulated)
    labelled(axes, "column / px", "row / px")
    return save(drawn, path)


def _percent(share: float) -> str:
    return f"{share:.1%}" if share >= 0.001 else "< 0.1%"


def draw_depth(path: Path, image: RangeImage) -> Path:
    """Draw z as a depth map in millimetres, near is bright."""
    share = float(np.mean(image.rejected == 0))
    title = f"range image, {share:.0%} of {image.rejected.size:,} pixels"
    z = image.xyz_mm[..., 2]
    return draw_map(path, z, title, "z / mm", colours="viridis_r", span=limits(z, 0.2, 99.8),
                    simulated=image.provenance.simulated)  # fmt: skip


def draw_sigma(path: Path, image: RangeImage) -> Path | None:
    """Draw the predicted standard deviation along the ray; None where the image carries none."""
    if image.sigma_mm is None:
        return None
    sigma: Any = np.where(image.rejected == 0, image.sigma_mm * 1000, np.nan)
    return draw_map(path, sigma, "predicted standard deviation along the ray", "σ / µm", colours="cividis",
                    span=(0.0, limits(sigma, 1, 98)[1]), simulated=image.provenance.simulated)  # fmt: skip
