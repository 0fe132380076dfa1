"""Charts: convergence of a registration, errors against the truth with their distribution.

Owns how errors are shown; computes none.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from fringed.data import Array, Registration
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

_COLOURS = ("#2e6f95", "#b3541e", "#4c8c5a", "#7d5ba6", "#a68a2d")


def draw_convergence(path: Path, registrations: Sequence[Registration], simulated: bool) -> Path:
    """Draw the RMS distance of each iteration, one line for each registration, and how each one ended."""
    drawn = figure(7.6, 4.2)
    axes = drawn.add_subplot()
    for number, registration in enumerate(registrations):
        rms = [record.rms_mm for record in registration.history]
        end = "converged" if registration.converged else "NOT converged"
        label = (
            f"view {number + 2} → 1: {end}; at the end {registration.overlap:.0%} overlap, "
            f"{registration.rms_mm:.3f} mm RMS over all of it"
        )
        colour = _COLOURS[number % len(_COLOURS)]
        axes.plot(range(1, len(rms) + 1), rms, marker="o", markersize=3.5, linewidth=1.4, color=colour, label=label)
        _mark_stages(axes, registration, colour)
    every = [record.rms_mm for registration in registrations for record in registration.history]
    if every and max(every) > 5 * max(min(every), 1e-9):
        axes.set_yscale("log")
    axes.grid(True, which="both", linewidth=0.3, color="#d9d9d4")
    axes.legend(fontsize=8, frameon=False)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    titled(axes, "convergence of the registration", simulated)
    labelled(axes, "iteration", "RMS distance of the iteration's pairs / mm")
    return save(drawn, path)


def _mark_stages(axes: Any, registration: Registration, colour: str) -> None:
    previous = ""
    for index, record in enumerate(registration.history):
        if record.stage and record.stage != previous:
            axes.annotate(
                record.stage, (index + 1, record.rms_mm), textcoords="offset points", xytext=(4, 5), fontsize=7,
                color=colour,
            )  # fmt: skip
            previous = record.stage


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
