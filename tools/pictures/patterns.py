"""Draw docs/pictures/patterns.png: styles, their spectra before and after blur, phase errors, what dithering does.

    python tools/pictures/patterns.py

What is drawn comes from `tests/bench/bench_patterns.py`: an ideal camera, a Gaussian blur, plain least squares.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from bench_patterns import (  # noqa: E402
    BLURS,
    DITHERS,
    LINEAR,
    STYLES,
    TARGET,
    dither_errors,
    encode,
    lights,
    style_errors,
)

from fringed_client.pictures.figures import FAINT, INK, figure, labelled, save, titled  # noqa: E402

COLOURS = ("#000000", "#0072b2", "#56b4e9", "#cc79a7", "#d55e00", "#e69f00", "#009e73")  # Okabe and Ito's
MARKS = ("o", "s", "^", "v", "D", "P", "X")
PERIOD_PX = 36.0
SHOWN = ("binary", "binary-pulse-width", "triangular", "sawtooth")
DITHER_BLURS_PX = (0.5, 0.8, 1.2, 2.0, 3.0, 4.0)


def draw_swatches(cells: Any) -> None:
    """Show three periods of each style, and the grey levels along its middle line."""
    for axes, style in zip(cells, STYLES, strict=True):
        pattern = encode(style=style, period_px=PERIOD_PX, steps=4).patterns[0][..., 0]
        wide = np.broadcast_to(pattern, (TARGET.height_px, TARGET.width_px))[:72, : int(3 * PERIOD_PX)]
        axes.imshow(wide, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        titled(axes, style, simulated=False)
        axes.set_title(style, loc="left", fontsize=8.5, color=INK, pad=4)
        axes.set_xticks([])
        axes.set_yticks([])


def draw_spectra(axes: Any) -> None:
    """Show each harmonic over the fundamental, in focus (hollow) and blurred by a tenth of the period (full)."""
    for number, style in enumerate(SHOWN):
        colour = COLOURS[STYLES.index(style)]
        sequence = encode(style=style, period_px=PERIOD_PX, steps=4)
        for blur, face in ((0.0, "none"), (0.1, colour)):
            line = lights(sequence, blur * PERIOD_PX, LINEAR)[0].mean(axis=0)[: int(16 * PERIOD_PX)]
            amplitude = np.abs(np.fft.rfft(line))[16::16]
            orders = np.arange(2, 12)
            share = np.maximum(amplitude[1:11] / amplitude[0], 1e-9)
            mark = MARKS[STYLES.index(style)]
            axes.scatter(orders + 0.16 * (number - 1.5), share, s=26, marker=mark, edgecolors=colour, facecolors=face)
    axes.set_yscale("log")
    axes.set_ylim(2e-5, 1.5)
    axes.set_xticks(range(2, 12))
    titled(axes, "harmonics: hollow in focus, full blurred by 0.1 periods", simulated=False)
    labelled(axes, "order", "over the fundamental")


def draw_errors(axes: Any, steps: int) -> None:
    """Show the phase error of each style against blur."""
    for number, (style, found) in enumerate(style_errors(steps, PERIOD_PX).items()):
        axes.plot(
            BLURS, [max(error, 1e-5) for error, _ in found],
            color=COLOURS[number], marker=MARKS[number], markersize=4.5, linewidth=1.3, label=style,
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set_ylim(1e-5, 1.5)
    titled(axes, f"phase error, {steps} steps, period 36 px", simulated=False)
    labelled(axes, "blur over period", "rad rms")


def draw_dithering(axes: Any, which: int) -> None:
    """Show the error of the local mean light, or of the phase, against blur, for each way to round."""
    found = {blur: dither_errors(48.0, 4, blur) for blur in DITHER_BLURS_PX}
    for number, dither in enumerate(DITHERS):
        values = [found[blur][dither][which] for blur in DITHER_BLURS_PX]
        colour = (COLOURS[0], COLOURS[4], COLOURS[1], COLOURS[6])[number]
        look = {"color": colour, "marker": MARKS[number], "markersize": 4.5, "linewidth": 1.3}
        axes.plot(DITHER_BLURS_PX, values, label=dither, **look)
    axes.set_yscale("log")
    axes.set_ylim(1.2e-5, 5e-3)
    what = "local mean light" if which == 0 else "phase, 4 steps"
    titled(axes, f"{what}: gamma 2.2 compensated, 48 px", simulated=False)
    labelled(axes, "blur (px)", "rms error, of the range" if which == 0 else "rad rms")
    axes.legend(
        fontsize=8,
        frameon=False,
        labelcolor=INK,
        title="dither",
        title_fontsize=8,
        loc=("lower left", "upper right")[which],
    )


def main() -> None:
    """Draw the figure."""
    drawn = figure(10.4, 8.3)
    drawn.set_layout_engine("none")
    left, wide, gap = 0.075, 0.41, 0.1
    swatch = (2 * wide + gap) / 7
    draw_swatches([drawn.add_axes((left + i * swatch, 0.875, swatch - 0.008, 0.09)) for i in range(7)])
    draw_spectra(drawn.add_axes((left, 0.49, wide, 0.335)))
    errors = drawn.add_axes((left + wide + gap, 0.49, wide, 0.335))
    draw_errors(errors, 4)
    errors.legend(fontsize=8, frameon=False, labelcolor=INK, loc="upper right", ncols=2)
    draw_dithering(drawn.add_axes((left, 0.075, wide, 0.315)), 0)
    draw_dithering(drawn.add_axes((left + wide + gap, 0.075, wide, 0.315)), 1)
    for axes in drawn.axes[7:]:
        axes.grid(True, color=FAINT, alpha=0.25, linewidth=0.5)
    path = save(drawn, ROOT / "docs" / "pictures" / "patterns.png")
    cv2.imwrite(str(path), cv2.imread(str(path)), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(path)


if __name__ == "__main__":
    main()
