"""Charts: errors against the truth with their distribution.

Owns how errors are shown; computes none.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fringed.data import Array
from fringed_client.pictures.figures import (
    ACCENT,
    FAINT,
    INK,
    PAPER,
    colour_bar,
    figure,
    labelled,
    save,
    thinned,
    titled,
)


def draw_error_map(path: Path, error_mm: Array, sigma_mm: Array | None, title: str, simulated: bool) -> Path:
    """Draw signed errors over camera pixels, and their distribution against the predicted one."""
    kept = np.isfinite(error_mm)
    top = float(np.percentile(np.abs(error_mm[kept]), 98)) if kept.any() else 1.0
    height, width = error_mm.shape
    drawn = figure(10.2, 7.0 * 0.80 * height / width + 0.75)
    left, right = drawn.subplots(1, 2, width_ratios=(2.5, 1))
    left.set_facecolor(PAPER)
    shown = left.imshow(
        thinned(error_mm * 1000), cmap="RdBu_r", vmin=-top * 1000, vmax=top * 1000,
        extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="nearest",
    )  # fmt: skip
    titled(left, title, simulated)
    labelled(left, "column / px", "row / px")
    colour_bar(drawn, shown, left, "error along the ray / µm", "both")
    _distribution(right, error_mm[kept], None if sigma_mm is None else sigma_mm[kept])
    return save(drawn, path)


def _distribution(axes: Any, error_mm: Array, sigma_mm: Array | None) -> None:

    bins = np.linspace(-4, 4, 81)
    scale = sigma_mm if sigma_mm is not None else max(float(np.std(error_mm)), 1e-9) if error_mm.size else 1.0
    axes.hist(error_mm / scale, bins, density=True, color="#7f9fb5", label="measured")
    normal = np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(bins, normal, color=ACCENT, linewidth=1.3, label="predicted")
    axes.axvline(0, color=FAINT, linewidth=0.6)
    axes.set_yticks([])
    axes.legend(fontsize=7.5, frameon=False, loc="upper left", labelcolor=INK)
    titled(axes, "distribution", False)
    labelled(axes, "error / predicted σ" if sigma_mm is not None else "error / its σ", "")
