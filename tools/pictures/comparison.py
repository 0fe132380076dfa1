"""Draw docs/pictures/comparison-*.png: every fringe method against noise and gamma, and on a surface with jumps.

    python tools/pictures/comparison.py

What is drawn comes from `tests/bench/bench_methods.py`, whose surfaces are seen by a generator of its own.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from analytic import Conditions, relief, see  # noqa: E402
from bench_methods import GAMMAS, METHODS, SNRS, available, decoded, encoded, tables  # noqa: E402

from fringed.loading import Catalogue, load_plugins  # noqa: E402
from fringed_client.pictures.figures import INK, figure, labelled, save, titled  # noqa: E402

PICTURES = ROOT / "docs" / "pictures"
PANELS = {
    "one frequency, wrapped": [m.label for m in METHODS[:6]],
    "several frequencies or a code, absolute": [m.label for m in METHODS[6:12]],
    "a single exposure": [m.label for m in METHODS[12:]],
}
COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
)  # Okabe and Ito's, safe for the colour-blind
MARKS = ("o", "s", "^", "D", "v", "P")


def _lines(axes: Any, found: dict[str, Any], labels: list[str], x: Any, key: str, **style: Any) -> None:
    for number, label in enumerate(label for label in labels if label in found):
        rms = [point["rms_px"] if point["kept"] > 0.02 else np.nan for point in found[label][key]]
        axes.plot(
            x, rms, color=COLOURS[number], marker=MARKS[number], markersize=4, linewidth=1.4, label=label, **style
        )


def draw_noise(found: dict[str, Any]) -> None:
    drawn = figure(11.5, 3.9)
    panels = drawn.subplots(1, 3, sharey=True)
    for axes, (title, labels) in zip(panels, PANELS.items(), strict=True):
        _lines(axes, found, labels, SNRS, "noise")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(SNRS, [f"{snr:g}" for snr in SNRS])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        titled(axes, title, simulated=False)
        labelled(axes, "modulation / noise of a frame", "RMS error / projector px" if axes is panels[0] else "")
        axes.legend(fontsize=7.5, frameon=False)
    save(drawn, PICTURES / "comparison-noise.png")


def draw_gamma(found: dict[str, Any]) -> None:
    drawn = figure(11.5, 3.9)
    panels = drawn.subplots(1, 3, sharey=True)
    for axes, (title, labels) in zip(panels, PANELS.items(), strict=True):
        _lines(axes, found, labels, GAMMAS, "gamma")
        for number, label in enumerate(label for label in labels if label in found):
            rms = [point["rms_px"] for point in found[label]["compensated"]]
            axes.plot(GAMMAS, rms, color=COLOURS[number], linewidth=1.0, linestyle=(0, (2, 2)))
        axes.plot([], [], color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label="with the tone curve inverted")
        axes.set_yscale("log")
        axes.grid(alpha=0.3)
        titled(axes, title, simulated=False)
        labelled(axes, "gamma of the projector, no noise", "RMS error / projector px" if axes is panels[0] else "")
        axes.legend(fontsize=7.5, frameon=False)
    save(drawn, PICTURES / "comparison-gamma.png")


def draw_maps(catalogue: Catalogue) -> None:
    """Draw the error of each method on a surface with jumps, a shadow and a dark patch."""
    scene = relief(steps=True)
    chosen = [
        m for m in available(catalogue) if m.label not in ("phase-shift N=3", "phase-shift N=6", "phase-shift N=8")
    ]
    drawn = figure(11.5, 1.35 * (-(-len(chosen) // 3)) + 0.5)
    panels = drawn.subplots(-(-len(chosen) // 3), 3, squeeze=False).ravel()
    image = None
    for axes in panels:
        axes.set_axis_off()
    for axes, method in zip(panels, chosen, strict=False):
        phase = decoded(catalogue, method, see(encoded(catalogue, method), scene, Conditions(snr=25)))
        off = (phase.phase_rad.astype(float) - phase.initial_phase_rad) * phase.period_px / (2 * np.pi) - scene.column
        if phase.kind == "wrapped":
            off -= phase.period_px * np.rint(off / phase.period_px)
        if phase.kind == "relative":
            off -= phase.period_px * np.rint(np.nanmedian(off) / phase.period_px)
        axes.set_facecolor("#30363d")
        shown = np.ma.masked_invalid(off)
        axes.set_axis_on()
        axes.set_xticks([])
        axes.set_yticks([])
        image = axes.imshow(shown, cmap="RdBu_r", vmin=-0.6, vmax=0.6, interpolation="nearest")
        titled(axes, f"{method.label}: {phase.kind}", simulated=False)
    if image is not None:
        bar = drawn.colorbar(image, ax=list(panels), fraction=0.02, pad=0.01, extend="both")
        bar.set_label("error / projector px", fontsize=9, color=INK)
    save(drawn, PICTURES / "comparison-maps.png")


def main() -> None:
    catalogue = load_plugins()
    found = tables(catalogue, available(catalogue))
    draw_noise(found)
    draw_gamma(found)
    draw_maps(catalogue)


if __name__ == "__main__":
    main()
