"""Draw docs/pictures/unknown-shifts.png: what wrong shifts do to a phase, and how well they are found again.

    python tools/pictures/unknown_shifts.py

Frames are made from their definition, with a background and a modulation that vary over the picture.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fringed_client.pictures.figures import INK, figure, labelled, save, titled
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import transform
from fringed_plugins.phase.unknown.unknown_shifts import estimated_shifts

PICTURES = Path(__file__).resolve().parents[2] / "docs" / "pictures"
HEIGHT, WIDTH = 240, 320
X, Y = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
PHASE = 2 * np.pi * X / 13.7 + 4 * np.exp(-((X - 160) ** 2 + (Y - 120) ** 2) / (2 * 50.0**2))
LIGHT = 110 + 50 * (X / WIDTH - 0.5) + 20 * np.sin(Y / 70)
MODULATION = 0.5 * LIGHT
COLOURS = {3: "#0072b2", 4: "#d55e00", 5: "#009e73", 8: "#cc79a7"}


def frames(shifts: Any, noise: float, seed: int) -> Any:
    """Return frames with these shifts and this noise."""
    rng = np.random.default_rng(seed)
    return np.stack([LIGHT + MODULATION * np.cos(PHASE + s) + rng.normal(0, noise, PHASE.shape) for s in shifts])


def even(count: int) -> Any:
    """Return evenly spaced shifts."""
    return 2 * np.pi * np.arange(count) / count


def off(phase: Any) -> Any:
    """Return the phase's error, the common offset taken off."""
    error = np.angle(np.exp(1j * (phase - PHASE)))
    return np.angle(np.exp(1j * (error - np.angle(np.mean(np.exp(1j * error))))))


def phase_of(stack: Any, shifts: Any) -> Any:
    """Return the least-squares phase for these shifts."""
    cosine, sine = transform(shifts)[1:3] @ stack.reshape(len(stack), -1)
    return np.arctan2(sine, cosine).reshape(PHASE.shape)


def bound(true: Any, noise: float) -> float:
    """Return the Cramer-Rao bound of the shifts, background and modulation of each pixel being free."""
    model = np.stack([np.ones_like(true), np.cos(true), np.sin(true)], axis=1)
    rest = np.eye(len(true)) - model @ np.linalg.pinv(model)
    fisher = PHASE.size * np.mean(MODULATION**2) / (2 * noise**2) * np.cos(true[:, None] - true) * rest
    keep = np.eye(len(true)) - 1 / len(true)
    return float(np.sqrt(np.mean(np.diag(keep @ np.linalg.pinv(fisher) @ keep))))


def ripple(axes: Any) -> None:
    """Draw the phase error over the phase, with the asked and with the estimated shifts."""
    true = even(5) + np.array([0.3, -0.2, 0.35, -0.4, 0.1])
    stack = frames(true, 2.0, 1)
    found = estimated_shifts(stack, even(5), NoiseModel(4.0, 0.0))
    turns = np.angle(np.exp(1j * PHASE)).ravel()
    edges = np.linspace(-np.pi, np.pi, 61)
    for shifts, label, colour in (
        (even(5), "shifts as asked for", "#d55e00"),
        (found.shifts_rad, "as estimated", "#0072b2"),
    ):
        error = off(phase_of(stack, shifts)).ravel()
        means = [error[(turns >= a) & (turns < b)].mean() for a, b in pairwise(edges)]
        rms = float(np.sqrt(np.mean(error**2)))
        axes.plot((edges[1:] + edges[:-1]) / 2, means, color=colour, label=f"{label}: {rms:.3f} rad rms")
    axes.legend(fontsize=7.5, frameon=False, loc="upper left")
    axes.set_ylim(-0.28, 0.4)
    axes.grid(alpha=0.3)
    titled(axes, "5 frames, each shift wrong by about 0.3 rad", simulated=False)
    labelled(axes, "phase (rad)", "mean error (rad)")


def against_noise(axes: Any) -> None:
    """Draw the error of the shifts against noise, with the bound."""
    levels = np.array([0.5, 1, 2, 4, 8, 16])
    for count, colour in COLOURS.items():
        true = even(count) + np.random.default_rng(count).normal(0, 0.3, count)
        errors = []
        for noise in levels:
            wrong = []
            for seed in range(12):
                model = NoiseModel(float(noise**2), 0.0)
                found = (
                    np.array(
                        estimated_shifts(frames(true, noise, seed + round(100 * noise)), even(count), model).shifts_rad
                    )
                    - true
                )
                wrong.append(np.mean((found - found.mean()) ** 2))
            errors.append(float(np.sqrt(np.mean(wrong))))
        axes.loglog(levels / 55, errors, "o-", color=colour, markersize=4, label=f"{count} frames")
        if count >= 5:
            limits = [bound(true, float(noise)) for noise in levels]
            axes.loglog(levels / 55, limits, "--", color=colour, linewidth=1)
    axes.plot([], [], "--", color=INK, linewidth=1, label="Cramer-Rao bound")
    axes.legend(fontsize=7.5, frameon=False)
    axes.grid(alpha=0.3)
    titled(axes, "error of the estimated shifts", simulated=False)
    labelled(axes, "noise of a frame over the modulation", "rms error (rad)")


def against_error(axes: Any) -> None:
    """Draw what the phase is worth against how wrong the shifts are."""
    sizes = np.array([0.003, 0.01, 0.03, 0.1, 0.3])
    for count in (4, 8):
        colour = COLOURS[count]
        for known, style in ((False, "--"), (True, "-")):
            errors = []
            for size in sizes:
                true = even(count) + size * np.random.default_rng(7).normal(0, 1, count)
                stack = frames(true, 1.0, 3)
                shifts = estimated_shifts(stack, even(count), NoiseModel(1.0, 0.0)).shifts_rad if known else even(count)
                errors.append(float(np.sqrt(np.mean(off(phase_of(stack, shifts)) ** 2))))
            what = "estimated" if known else "as asked for"
            axes.loglog(sizes, errors, style, marker="o", markersize=4, color=colour, label=f"{count} frames, {what}")
    axes.legend(fontsize=7.5, frameon=False)
    axes.grid(alpha=0.3)
    titled(axes, "error of the phase", simulated=False)
    labelled(axes, "size of the shifts' errors (rad)", "rms error (rad)")


def main() -> None:
    """Draw the picture."""
    drawn = figure(12.0, 3.7)
    axes = drawn.subplots(1, 3)
    ripple(axes[0])
    against_noise(axes[1])
    against_error(axes[2])
    save(drawn, PICTURES / "unknown-shifts.png")


if __name__ == "__main__":
    main()
