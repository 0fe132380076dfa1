"""Draw docs/pictures/comparison-*.png: every fringe method against noise, steps and gamma, and on a surface with jumps.

    python tools/pictures/comparison.py

What is drawn comes from `tests/bench/bench_methods.py`, whose surfaces are seen by a generator of its own.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from analytic import CROSSTALK, FULL_DN, Conditions, Scene, relief, see  # noqa: E402
from bench_methods import (  # noqa: E402
    GAMMAS,
    SNRS,
    STEPS,
    Method,
    available,
    decoded,
    encoded,
    steps_tables,
    tables,
)
from shrink import shrink  # noqa: E402

from fringed.loading import Catalogue, load_plugins  # noqa: E402
from fringed_client.pictures.figures import FAINT, INK, figure, labelled, save, titled  # noqa: E402

PICTURES = ROOT / "docs" / "pictures"
PANELS = {
    "one frequency, wrapped": (
        "phase-shift N=3", "phase-shift N=4", "phase-shift N=8", "double steps 2 x 3", "dithered, blur 3 px",
        "unknown-shifts N=5",
    ),
    "several frequencies or a code, absolute": (
        "multi-frequency 3 x 3", "multi-frequency 3 x 4", "heterodyne", "number-theoretic", "gray-phase-shift",
        "gray-code",
    ),
    "a single exposure": (
        "fourier", "windowed-fourier", "one-shot-phase-shift", "one-shot, coloured", "one-shot-frequencies",
        "one-shot-freq., coloured",
    ),
}  # fmt: skip
MAPS = (
    "phase-shift N=4", "spatial unwrapping N=4", "multi-frequency 3 x 4", "heterodyne", "number-theoretic",
    "gray-phase-shift", "gray-code", "fourier", "windowed-fourier", "one-shot-phase-shift", "one-shot-frequencies",
)  # fmt: skip
COLOURS = (
    "#000000",
    "#d55e00",
    "#0072b2",
    "#cc79a7",
    "#e69f00",
    "#009e73",
)  # Okabe and Ito's, safe for the colour-blind
MARKS = ("o", "s", "^", "D", "v", "P")
LEVELS_PX = (-0.6, -0.4, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.4, 0.6)
LEAST_KEPT = 0.02
PERIOD_PX = 16.0
BLUR_PX = Conditions().blur_px


def draw_lines(axes: Any, found: dict[str, Any], labels: tuple[str, ...], x: Any, key: str) -> None:
    """Draw the errors of some methods; where next to nothing is kept there is none."""
    for number, label in enumerate(labels):
        rms = [point["rms_px"] if point["kept"] > LEAST_KEPT else np.nan for point in found[label][key]]
        look = {"color": COLOURS[number], "marker": MARKS[number], "markersize": 4.5, "linewidth": 1.4}
        axes.plot(x, rms, label=label, **look)


def finished(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_yscale("log")
    axes.grid(True, color=FAINT, alpha=0.25, linewidth=0.5)
    titled(axes, title, simulated=False)
    labelled(axes, x, y)
    axes.legend(fontsize=7.5, frameon=False, labelcolor=INK)


def draw_noise(found: dict[str, Any]) -> Path:
    """Draw error against noise."""
    drawn = figure(11.5, 4.1)
    panels = drawn.subplots(1, 3, sharey=True)
    for axes, (title, labels) in zip(panels, PANELS.items(), strict=True):
        draw_lines(axes, found, labels, SNRS, "noise")
        axes.set_xscale("log")
        axes.set_xticks(SNRS, [f"{snr:g}" for snr in SNRS])
        axes.minorticks_off()
        first = axes is panels[0]
        finished(axes, title, "modulation / noise of a frame", "RMS error / projector px" if first else "")
    return save(drawn, PICTURES / "comparison-noise.png")


def draw_gamma(found: dict[str, Any]) -> Path:
    """Draw error against gamma, as it is and with the tone curve inverted."""
    drawn = figure(11.5, 4.1)
    panels = drawn.subplots(1, 3, sharey=True)
    for axes, (title, labels) in zip(panels, PANELS.items(), strict=True):
        draw_lines(axes, found, labels, GAMMAS, "gamma")
        for number, label in enumerate(labels):
            rms = [point["rms_px"] for point in found[label]["compensated"]]
            axes.plot(GAMMAS, rms, color=COLOURS[number], linewidth=1.0, linestyle=(0, (2, 2)))
        axes.plot([], [], color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label="with the tone curve inverted")
        axes.set_ylim(0.003, 8)
        axes.set_xticks(GAMMAS)
        first = axes is panels[0]
        finished(axes, title, "gamma of the projector, no noise", "RMS error / projector px" if first else "")
        axes.legend(fontsize=7, frameon=False, labelcolor=INK, ncols=2, loc="upper center", columnspacing=1.0)
    return save(drawn, PICTURES / "comparison-gamma.png")


def aliased_px(steps: int, gamma: float) -> float:
    """Return the RMS error that harmonics N - 1 and N + 1 of gamma make, blurred; fringes of full contrast."""
    ratio, ratios = 1.0, {1: 1.0}
    for k in range(2, steps + 2):
        ratio *= (gamma - k + 1) / (gamma + k)
        ratios[k] = ratio * np.exp(-2 * (np.pi * BLUR_PX / PERIOD_PX) ** 2 * (k * k - 1))
    # Both turn the phase by their sine of N times the phase: the lower one forwards, the upper one backwards.
    aliased = abs(ratios[steps - 1] - ratios[steps + 1]) / np.sqrt(2)
    return float(np.hypot(aliased, rounding_rad(steps)) * PERIOD_PX / (2 * np.pi))


def rounding_rad(steps: int) -> float:
    """Return the phase noise of whole grey levels in camera and projector, for a surface that reflects 72 %."""
    seen = 0.5 * FULL_DN * 0.72 * np.exp(-2 * (np.pi * BLUR_PX / PERIOD_PX) ** 2)
    averaged = np.sqrt(2 * np.sqrt(np.pi) * BLUR_PX)  # what blur makes of the projector's independent levels
    return float(np.sqrt(2 / steps / 12) * np.hypot(1 / seen, 1 / 127.5 / averaged))


def draw_steps(found: dict[str, list[float]]) -> Path:
    """Draw error against the number of steps."""
    drawn = figure(10.0, 3.9)
    left, right = drawn.subplots(1, 2)
    (noisy, measured), predicted = next(iter(found.items())), found["predicted"]
    left.plot(STEPS, measured, color=COLOURS[2], marker="o", linestyle="none", label="measured")
    left.plot(STEPS, predicted, color=INK, linewidth=1.0, label="predicted, sqrt(2 / N) sigma / B")
    finished(left, noisy, "steps N", "RMS error / projector px")
    left.set_yscale("linear")
    left.set_ylim(0, 0.14)
    for number, gamma in enumerate(GAMMAS[1:4], start=1):
        look = {"color": COLOURS[number], "marker": MARKS[number], "markersize": 5}
        right.plot(STEPS, found[f"gamma {gamma:g}"], linestyle="none", label=f"gamma {gamma:g}", **look)
        right.plot(STEPS, [aliased_px(n, gamma) for n in STEPS], color=COLOURS[number], linewidth=0.9, linestyle="--")
    right.plot([], [], color=INK, linewidth=0.9, linestyle="--", label="predicted: harmonics N - 1 and N + 1, rounding")
    right.set_ylim(2e-3, 1)
    finished(right, "no noise, nothing compensated", "steps N", "RMS error / projector px")
    for axes in (left, right):
        axes.set_xticks(STEPS)
    return save(drawn, PICTURES / "comparison-steps.png")


def error_px(catalogue: Catalogue, method: Method, scene: Scene) -> tuple[Any, str]:
    """Return the method's error at every pixel, NaN where dropped, and the kind of its phase."""
    mixed = CROSSTALK / CROSSTALK.sum(axis=1, keepdims=True)
    phase = decoded(catalogue, method, see(encoded(catalogue, method), scene, Conditions(snr=25)), mixed)
    off = (phase.phase_rad.astype(float) - phase.initial_phase_rad) * phase.period_px / (2 * np.pi) - scene.column
    if phase.kind == "wrapped":
        off -= phase.period_px * np.rint(off / phase.period_px)
    if phase.kind == "relative":
        off -= phase.period_px * np.rint(np.nanmedian(off) / phase.period_px)
    return off, phase.kind


def draw_maps(catalogue: Catalogue) -> Path:
    """Draw the error of each method on a surface with jumps, a shadow and a dark patch."""
    scene = relief(steps=True)
    methods = {method.label: method for method in available(catalogue)}
    drawn = figure(11.5, 5.9)
    panels = drawn.subplots(4, 3).ravel()
    panels[0].imshow(np.where(scene.lit, scene.albedo, 0.0), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    titled(panels[0], "the surface: light, shadow, dark patch", simulated=False)
    for left in (90, 170, 250, 330, 400):
        panels[0].axvline(left - 0.5, color="#e69f00", linewidth=1.0)
    norm = BoundaryNorm(LEVELS_PX, 256, extend="both")
    image = None
    for axes, label in zip(panels[1:], MAPS, strict=True):
        off, kind = error_px(catalogue, methods[label], scene)
        axes.set_facecolor("#30363d")
        shown = np.ma.masked_invalid(off)
        image = axes.imshow(shown, cmap=colormaps["RdBu_r"], norm=norm, interpolation="nearest")
        titled(axes, f"{label}: {kind}", simulated=False)
    for axes in panels:
        axes.set_xticks([])
        axes.set_yticks([])
    assert image is not None
    bar = drawn.colorbar(image, ax=list(panels), fraction=0.02, pad=0.01, ticks=LEVELS_PX, spacing="uniform")
    bar.ax.tick_params(labelsize=8, colors=INK, length=2)
    bar.set_label("error / projector px", fontsize=9, color=INK)
    return save(drawn, PICTURES / "comparison-maps.png")


def main() -> None:
    catalogue = load_plugins()
    found = tables(catalogue, available(catalogue))
    for path in (draw_noise(found), draw_gamma(found), draw_steps(steps_tables(catalogue)), draw_maps(catalogue)):
        print(shrink(path))


if __name__ == "__main__":
    main()
