"""Draw docs/pictures/real-data.png: somebody else's fringes, from a frame to the absolute phase, along both directions.

    python tools/pictures/real_data.py [--images FOLDER]

The images are those of https://github.com/kamino410/phase-shifting; where they are missing nothing is drawn.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from bench_real_data import IMAGES, capture, decode, display_px, with_period  # noqa: E402
from shrink import shrink  # noqa: E402

from fringed.data import FrameSet, Reject  # noqa: E402
from fringed_client.pictures.figures import INK, figure, save, thinned, titled  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "real-data.png"
MASK = (
    ("kept", "#e9e7e0", 0),
    ("dark, or in the shadow", "#30363d", int(Reject.LOW_MODULATION)),
    ("order contradicts itself", "#e69f00", int(Reject.FRINGE_ORDER)),
    ("alone, or an edge", "#56b4e9", int(Reject.ISOLATED | Reject.DISCONTINUITY | Reject.OUT_OF_RANGE)),
)
BANDS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")  # Okabe and Ito's, in turn
SHOWN_PX = 480


def mask_of(rejected: Any) -> Any:
    """Return which of `MASK` each pixel is: the first reason that it has."""
    code = np.zeros(rejected.shape, int)
    for number in (3, 2, 1):
        code[(rejected & MASK[number][2]) > 0] = number
    return code


def draw_row(drawn: Any, panels: Any, frames: FrameSet, orientation: str) -> None:
    """Draw one direction."""
    one = with_period(frames, orientation, None)
    phase = decode("gray-phase-shift", one, keep_wrapped=True)
    finest = next(i for i, frame in enumerate(one.sequence.frames) if frame.period_px < 70)
    column = display_px(phase)
    assert phase.wrapped_rad is not None
    kept = phase.rejected == 0
    order = np.where(kept, np.rint((phase.phase_rad - phase.wrapped_rad) / (2 * np.pi)), np.nan)
    size = phase.projector_px
    light = one.frames[finest].astype(float) ** 0.6  # the scene is dark: as an eye would see it
    shown = (
        (light, f"frame 1 of {len(one.frames)}", "gray", (0, np.percentile(light, 99.5)), ""),
        (phase.wrapped_rad, f"wrapped phase, {phase.period_px:.1f} px", "twilight", (-np.pi, np.pi), "rad"),
        (np.mod(order, 6), f"fringe order, 0 to {np.nanmax(order):.0f}", ListedColormap(BANDS), (-0.5, 5.5), ""),
        (column, f"{orientation[:-1]} of the display", "viridis", (0, size), "px"),
    )
    for axes, (values, title, colours, (low, high), unit) in zip(panels, shown, strict=False):
        image = axes.imshow(thinned(values, SHOWN_PX), cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        titled(axes, title, simulated=False)
        if unit:
            bar = drawn.colorbar(image, ax=axes, fraction=0.03, pad=0.02)
            bar.set_ticks([-np.pi, 0, np.pi] if unit == "rad" else [0, size // 2, size])
            if unit == "rad":
                bar.ax.set_yticklabels(["-π", "0", "π"])
            bar.ax.tick_params(labelsize=8, colors=INK, length=2)
    axes = panels[4]
    norm = BoundaryNorm(np.arange(len(MASK) + 1) - 0.5, len(MASK))
    colours = ListedColormap([colour for _, colour, _ in MASK])
    axes.imshow(thinned(mask_of(phase.rejected), SHOWN_PX), cmap=colours, norm=norm, interpolation="nearest")
    titled(axes, f"mask: {kept.mean():.0%} kept", simulated=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, default=IMAGES)
    images: Path = parser.parse_args().images
    if not images.is_dir():
        print(f"{images} is not there: nothing drawn")
        return
    frames = capture(images.resolve())
    drawn = figure(14.2, 4.6)
    panels = drawn.subplots(2, 5)
    for row, orientation in zip(panels, ("columns", "rows"), strict=True):
        draw_row(drawn, row, frames, orientation)
    for axes in panels.ravel():
        axes.set_xticks([])
        axes.set_yticks([])
    handles = [panels[1, 4].plot([], [], "s", color=colour, label=name, markeredgecolor=INK, markeredgewidth=0.4)[0]
               for name, colour, _ in MASK]  # fmt: skip
    panels[1, 4].legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.03), fontsize=7.5, frameon=False,
                        ncols=1, handletextpad=0.2)  # fmt: skip
    print(shrink(save(drawn, PICTURE)))


if __name__ == "__main__":
    main()
