"""Draw docs/pictures/phase-shifting.png: phase noise and the error that a projector's gamma leaves, for 3 to 16 steps.

    python tools/pictures/phase_shifting.py

Both are measured with the decoder on frames made from the definition: a background of 110 grey levels, a camera of
51 electrons for each of them and 12 electrons of read noise.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringed_client.pictures.figures import ACCENT, FAINT, INK, figure, labelled, save, titled
from fringed_plugins.phase.decode import decode
from fringed_plugins.phase.decoded import Thresholds
from fringed_plugins.phase.noise import NoiseModel
from fringed_plugins.phase.shifts import Group
from fringed_plugins.phase.weighting import weigh

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "phase-shifting.png"
SENSOR = NoiseModel((12 / 51) ** 2, 1 / 51)
OPEN = Thresholds(modulation_dn=0.0, modulation_snr=0.0, residual=10.0, similar_neighbours=0, border_glow=0.0)
STEPS = np.arange(3, 17)
PHASES = np.linspace(-np.pi, np.pi, 240, endpoint=False)
BACKGROUND, ROWS = 110.0, 2000
GAMMAS = {1.2: "#56b4e9", 1.8: "#0072b2", 2.2: ACCENT}
NOISE_FREE = NoiseModel(1e-9, 0.0)
Array = NDArray[Any]


def group(steps: int) -> Group:
    """Return a group of equal steps."""
    return Group(tuple(range(steps)), tuple(2 * np.pi * np.arange(steps) / steps), 16.0)


def rms(phase: Array) -> float:
    """Return the root mean square of what a phase is off."""
    return float(np.sqrt(np.mean(np.angle(np.exp(1j * (phase.astype(float) - PHASES))) ** 2)))


def scatter(steps: int, modulation: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return the phase noise with equal weights, with weights by noise, and the Cramer-Rao bound, rad."""
    fringes = group(steps)
    angle = PHASES + np.array(fringes.shifts_rad)[:, None]
    light = BACKGROUND + modulation * np.cos(angle)
    variance = SENSOR.constant_dn2 + SENSOR.slope_dn * light
    gradient = np.stack([np.ones_like(angle), np.cos(angle), -modulation * np.sin(angle)], axis=-1)
    information = np.einsum("kxi,kxj,kx->xij", gradient, gradient, 1 / variance)
    bound = float(np.sqrt(np.linalg.inv(information)[:, 2, 2].mean()))
    noise = np.sqrt(variance)[:, None, :] * rng.normal(size=(steps, ROWS, PHASES.size))
    frames = (light[:, None, :] + noise).astype(np.float32)
    found = decode(frames, [fringes], SENSOR, OPEN)
    equal = rms(found.phase_rad)
    weigh(found.phase_rad, found.sigma_rad, frames, fringes, SENSOR)
    return equal, rms(found.phase_rad), bound


def harmonics(steps: int, gamma: float) -> float:
    """Return the error of a noise-free phase whose projector has this gamma, rad."""
    fringes = group(steps)
    relative = (1 + np.cos(PHASES + np.array(fringes.shifts_rad)[:, None])) / 2
    frames = (200 * relative**gamma)[:, None, :].astype(np.float32)
    return rms(decode(frames, [fringes], NOISE_FREE, OPEN).phase_rad)


def main() -> None:
    rng = np.random.default_rng(0)
    drawn = figure(10.4, 4.2)
    left, right = drawn.subplots(1, 2)
    for modulation, colour in ((50.0, "#0072b2"), (105.0, ACCENT)):
        equal, weighed, bound = (
            1e3 * np.array(v) for v in zip(*(scatter(n, modulation, rng) for n in STEPS), strict=True)
        )
        left.plot(STEPS, bound, color=colour, linewidth=1.2, label=f"bound, modulation {modulation:g}")
        left.plot(STEPS, equal, "s", color=colour, markersize=4.5, fillstyle="none", label="equal weights")
        left.plot(STEPS, weighed, "o", color=colour, markersize=3.5, label="weights by noise")
    titled(left, f"phase noise, background {BACKGROUND:g} grey levels", simulated=False)
    labelled(left, "steps N", "RMS error, mrad")
    for gamma, colour in GAMMAS.items():
        error = np.array([1e3 * harmonics(n, gamma) for n in STEPS])
        right.semilogy(STEPS, error, "o-", color=colour, markersize=3.5, linewidth=1.0, label=f"gamma {gamma:g}")
    right.axhline(1e3 / (16 / (2 * np.pi)) * 0.05, color=FAINT, linewidth=0.8, linestyle="--")
    right.text(
        16, 1e3 / (16 / (2 * np.pi)) * 0.05 * 1.2, "1/20 projector pixel at 16 px", fontsize=8, color=INK, ha="right"
    )
    titled(right, "error of an uncompensated gamma, no noise, no blur", simulated=False)
    labelled(right, "steps N", "RMS error, mrad")
    right.set_ylim(1e-4, 3e2)
    for axes in (left, right):
        axes.set_xticks(STEPS[::1])
        axes.grid(color=FAINT, alpha=0.25, linewidth=0.5)
        axes.legend(fontsize=8, frameon=False, labelcolor=INK)
    left.set_ylim(bottom=0)
    print(save(drawn, PICTURE), f"{PICTURE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
