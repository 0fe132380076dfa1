"""Figures with axes, units and a mark where the rig was simulated.

Owns the look that all pictures share; imports matplotlib, and only when a picture is drawn. No pyplot: figures
may be drawn in several threads.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fringed.data import Array

DPI = 100
INK = "#2b2b2b"
ACCENT = "#b3541e"
FAINT = "#8a8a86"
PAPER = "#fafaf8"
# Okabe & Ito (2008), without yellow: lines that a colour-blind person tells apart.
APART = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#2b2b2b")


def figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure on paper."""
    drawn = Figure(figsize=(width_in, height_in), dpi=DPI, facecolor=PAPER, layout="compressed")
    FigureCanvasAgg(drawn)
    engine = drawn.get_layout_engine()
    if engine is not None:
        engine.set(w_pad=0.1, h_pad=0.08)  # type: ignore[call-arg]
    return drawn


def titled(axes: Any, title: str, simulated: bool, narrow: bool = False) -> None:
    """Put the title at the left and, where it applies, SIMULATED at the right (below, if narrow)."""
    axes.set_title(title, loc="left", fontsize=10.5, color=INK, pad=18 if simulated and narrow else 7)
    if simulated and narrow:
        axes.annotate("SIMULATED", (0, 1), xycoords="axes fraction", xytext=(0, 5), textcoords="offset points",
                      fontsize=8, color=ACCENT, fontweight="bold")  # fmt: skip
    elif simulated:
        axes.set_title("SIMULATED", loc="right", fontsize=8, color=ACCENT, fontweight="bold", pad=7)
    axes.tick_params(labelsize=8, colors=INK, length=3)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
        spine.set_color(FAINT)


def labelled(axes: Any, x: str, y: str) -> None:
    """Name both axes."""
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)


def colour_bar(drawn: Figure, image: Any, axes: Any, label: str, extend: str = "neither") -> Any:
    """Put a colour bar beside the axes."""
    bar = drawn.colorbar(image, ax=axes, fraction=0.046, pad=0.02, extend=extend)
    bar.set_label(label, fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, colors=INK, length=3)
    bar.outline.set_linewidth(0.4)
    return bar


def save(drawn: Figure, path: Path, colours: int | None = None, rare: bool = False) -> Path:
    """Write the figure as PNG (or what the name's ending says) and return its path.

    A PNG of at most 256 `colours` is a third as large. They suit what fills the picture, and shade has no steps;
    `rare` keeps those that few pixels have, such as the ends of a colour bar.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if colours is not None and path.suffix == ".png":
        from PIL import Image

        drawn.canvas.draw()
        picture = Image.fromarray(np.asarray(drawn.canvas.buffer_rgba())).convert("RGB")  # type: ignore[attr-defined]
        method = Image.Quantize.MAXCOVERAGE if rare else Image.Quantize.MEDIANCUT
        picture.quantize(colours, method, dither=Image.Dither.NONE).save(path, compress_level=6)
        drawn.clear()
        return path
    drawn.savefig(path, dpi=DPI, pil_kwargs={"compress_level": 3} if path.suffix == ".png" else None)
    drawn.clear()
    return path


def thinned(values: Array, most_px: int = 720) -> Array:
    """Return every n-th row and column, so that no picture draws more pixels than it shows."""
    step = max(1, -(-max(values.shape[:2]) // most_px))
    return values[::step, ::step]


def limits(values: Array, low: float = 1.0, high: float = 99.0) -> tuple[float, float]:
    """Return the given percentiles of what is finite, (0, 1) where nothing is."""
    kept = values[np.isfinite(values)]
    if not kept.size:
        return 0.0, 1.0
    bottom, top = np.percentile(kept[:: max(1, kept.size // 200_000)], (low, high))
    return float(bottom), float(max(top, bottom + 1e-9))
