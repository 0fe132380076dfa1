"""Draw docs/pictures/colour.png: one exposure of three colours, what unmixing and balance do, and motion.

    python tools/pictures/colour.py

Scenes are made from their definition: light through a crosstalk matrix, 1.5 grey levels of noise, 8 bits.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from single_frame import small

from fringed_client.pictures.figures import INK, figure, labelled, save, titled
from fringed_plugins.phase.colours.colour import Colours, balance, three_steps, unmix
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel

PICTURES = Path(__file__).resolve().parents[2] / "docs" / "pictures"
MIX = np.array([[0.90, 0.08, 0.02], [0.07, 0.85, 0.08], [0.01, 0.09, 0.90]])
HEIGHT, WIDTH, PERIOD = 300, 400, 16.0
X, Y = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
STEPS = tuple(2 * np.pi * np.arange(3) / 3)
NOISE = NoiseModel(1.5**2 + 1 / 12, 0.0)
RELIEF = 2 * np.pi * X / PERIOD + 4 * np.exp(-((X - 200) ** 2 + (Y - 150) ** 2) / (2 * 60.0**2))
SURFACES = {
    "grey": np.ones((3, 1, 1)),
    "mildly coloured\n(1, 0.8, 0.65)": np.reshape((1.0, 0.8, 0.65), (3, 1, 1)),
    "stained\n(+-19 %, smooth)": np.stack([0.8 + 0.15 * np.sin(X / 60 + k) * np.cos(Y / 45 + 2 * k) for k in range(3)]),
}
WAYS = (
    ("as the camera gives it", "raw", "none", "#999999"),
    ("unmixed", "unmixed", "none", "#d55e00"),
    ("unmixed, global balance", "unmixed", "global", "#56b4e9"),
    ("unmixed, local balance", "unmixed", "local", "#0072b2"),
    ("unmixed, white frame", "unmixed", "white", "#009e73"),
)


def shoot(light: Any, surface: Any, seed: int = 0) -> Any:
    """Return the three channels of one exposure, uint8."""
    clean = 2 + 200 * np.einsum("cj,jhw->chw", MIX, surface * light)
    return np.clip(np.rint(clean + np.random.default_rng(seed).normal(0, 1.5, clean.shape)), 0, 255).astype(np.uint8)


def fringes(phase: Any) -> Any:
    """Return the light of three steps."""
    return np.stack([(1 + np.cos(phase + s)) / 2 for s in STEPS])


def error(seen: Any, phase: Any, how: str, method: Any, white: Any = None) -> tuple[Any, float]:
    """Return the wrapped error of the decoded phase, and the stated noise."""
    colours = Colours(MIX if how == "unmixed" else np.eye(3), (2.0, 2.0, 2.0))
    light = None if white is None else unmix(white, colours)
    gains = balance(unmix(seen, colours), method, white=light, period_px=PERIOD)
    used = white if method == "white" else None
    found = three_steps(seen, STEPS, colours, NOISE, Thresholds(saturation_dn=255.0), gains=gains, white=used)
    return np.angle(np.exp(1j * (found.phase_rad - phase))), float(np.nanmedian(found.sigma_rad))


def bars(axes: Any) -> None:
    """Draw the error of each way on each surface."""
    for place, surface in enumerate(SURFACES.values()):
        full = np.ones((3, HEIGHT, WIDTH))
        seen, white = shoot(fringes(RELIEF), surface * full), shoot(full, surface, 9)
        for number, (label, how, method, colour) in enumerate(WAYS):
            off, sigma = error(seen, RELIEF, how, method, white)
            rms = float(np.sqrt(np.nanmean(off**2)))
            at = place + 0.17 * (number - 2)
            axes.bar(at, rms, 0.16, color=colour, label=label if place == 0 else None)
            axes.plot([at - 0.08, at + 0.08], [sigma, sigma], color=INK, linewidth=1.5)
            axes.text(at, rms * 1.06, f"{rms:.3f}"[1:], ha="center", fontsize=6.5, color=INK)
    axes.plot([], [], color=INK, linewidth=1.5, label="stated noise")
    axes.set_yscale("log")
    axes.set_ylim(0.008, 1.2)
    axes.set_xticks(range(len(SURFACES)), SURFACES, fontsize=8)
    axes.legend(fontsize=7, frameon=False, ncol=2, loc="upper left")
    titled(axes, "one-shot phase, rms error", simulated=False)
    axes.set_ylabel("rad", fontsize=9, color=INK)


def sphere(time: float) -> tuple[Any, Any]:
    """Return the phase of a sphere that moves, at a time in exposures; and its height."""
    inside = 90.0**2 - (X - 190 - 3.0 * time) ** 2 - (Y - 150) ** 2
    height = np.sqrt(np.maximum(inside, 0)) + 3.0 * time
    return 2 * np.pi * (X + 0.4 * height) / PERIOD, height


def motion(axes: Any) -> None:
    """Draw a section through the moving sphere, from three exposures and from one."""
    phase, height = sphere(1)
    grey = np.ones((3, 1, 1))
    once, _ = error(shoot(fringes(phase), grey), phase, "unmixed", "none")
    light = np.stack([fringes(sphere(t)[0])[t] for t in range(3)])
    separate = 2 + 200 * light
    separate = np.clip(np.rint(separate + np.random.default_rng(4).normal(0, 1.5, light.shape)), 0, 255).astype(
        np.uint8
    )
    black = Colours(np.eye(3), (2.0, 2.0, 2.0))
    thrice = three_steps(separate, STEPS, black, NOISE, Thresholds(saturation_dn=255.0)).phase_rad
    thrice = np.angle(np.exp(1j * (thrice - phase)))
    span = slice(120, 266)
    per_rad = PERIOD / (2 * np.pi * 0.4)
    true = height[150, span]
    for off, label, colour, lift in (
        (thrice, "three exposures", "#d55e00", 0.0),
        (once, "one exposure of three colours", "#0072b2", 40.0),
    ):
        shown = off[150, span] - np.nanmedian(off[150, span])
        rms = float(np.sqrt(np.nanmean(shown**2)) * per_rad)
        axes.plot(
            X[span], true + shown * per_rad + lift, color=colour, linewidth=1.1, label=f"{label}: {rms:.2f} px rms"
        )
        axes.plot(X[span], true + lift, color=INK, linewidth=0.7, linestyle=":")
    axes.legend(fontsize=7.5, frameon=False, loc="lower center")
    axes.set_ylim(0, 145)
    titled(axes, "sphere moving 3 px an exposure, a section", simulated=False)
    labelled(axes, "column (px)", "height (px; the upper one lifted by 40)")


def main() -> None:
    """Draw the picture."""
    drawn = figure(12.0, 4.0)
    axes = drawn.subplots(1, 3, width_ratios=(0.9, 1.25, 1.1))
    seen = shoot(fringes(RELIEF), SURFACES["mildly coloured\n(1, 0.8, 0.65)"])
    axes[0].imshow(seen.transpose(1, 2, 0)[60:240, 100:300], interpolation="nearest")
    axes[0].set_xticks([])
    axes[0].set_yticks([])
    titled(axes[0], "one exposure, three steps", simulated=False)
    bars(axes[1])
    motion(axes[2])
    small(save(drawn, PICTURES / "colour.png"), 256)


if __name__ == "__main__":
    main()
