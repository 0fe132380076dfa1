"""Draw docs/pictures/nonlinearity.png and nonlinearity-face.png: what gamma does to a phase, and to a face.

Run from the repository's root; the second picture simulates the bench's rig (half the camera's resolution, no noise,
patterns of 8 bits, the tone curve measured on a plane).

    .venv/bin/python tools/pictures/nonlinearity.py
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

import bench_gamma  # noqa: E402

from fringed.data import PhaseMap  # noqa: E402
from fringed_client.pictures.figures import INK, PAPER, colour_bar, figure, labelled, save, titled  # noqa: E402
from fringed_plugins.phase.nonlinear.harmonics import blurred, phase_error, tone_harmonics  # noqa: E402
from fringed_plugins.triangulation_plugin import Triangulate  # noqa: E402

FOLDER = ROOT / "docs" / "pictures"
PART = (slice(190, 330), slice(270, 400))  # eyes, nose and mouth
COLOURS = {3: "#b3541e", 4: "#2e6f95", 5: "#4c8c5a", 6: "#7d5ba6", 8: "#a68a2d"}
SCALES = {3: 1, 4: 20, 5: 150, 6: 600, 8: 5000}  # so that all of them can be seen in one chart
GAMMA = (np.arange(256) / 255) ** 2.2


def draw_errors(path: Path) -> Path:
    """Draw the phase error against the phase, and its RMS against the blur."""
    drawn = figure(10.4, 4.0)
    left, right = drawn.subplots(1, 2)
    phase = np.linspace(-np.pi, np.pi, 721)
    ratios = tone_harmonics(GAMMA)
    for steps, colour in COLOURS.items():
        error = phase_error(ratios, steps, phase)
        scale = SCALES[steps]
        label = f"{steps} steps" + (f" ({scale} times)" if scale > 1 else "")
        left.plot(phase, scale * error, color=colour, linewidth=1.5, label=label)
        blur = np.linspace(0, 0.2, 41)
        rms = [np.sqrt(np.mean(phase_error(blurred(ratios, b), steps, phase) ** 2)) for b in blur]
        right.semilogy(blur, rms, color=colour, linewidth=1.5, label=f"{steps} steps")
    left.set_xticks([-np.pi, 0, np.pi], ["-π", "0", "π"])
    left.legend(fontsize=8, frameon=False, labelcolor=INK, ncols=2, loc="upper center")
    left.set_ylim(-0.36, 0.5)
    right.set_ylim(1e-6, 1)
    right.legend(fontsize=8, frameon=False, labelcolor=INK, loc="lower left")
    titled(left, "gamma 2.2, no blur: error against phase", False)
    titled(right, "its RMS against the projector's blur", False)
    labelled(left, "true phase / rad", "phase error / rad")
    labelled(right, "blur (standard deviation) / period", "RMS phase error / rad")
    for axes in (left, right):
        axes.grid(True, linewidth=0.3, color="#d9d9d4")
    return save(drawn, path)


def error_um(rig: bench_gamma.SimulatedRig, phase: PhaseMap) -> np.ndarray:
    """Return the error along the ray in micrometres, NaN where nothing was measured."""
    truth = rig.truth()
    view = bench_gamma.run(Triangulate, {"phase": phase, "calibration": rig.calibration()})
    error = bench_gamma.along_ray_mm(view, truth) * 1000
    error[(view.rejected > 0) | (truth.is_object == 0)] = np.nan
    return error


def draw_face(path: Path) -> Path:
    """Draw the depth error of a face: three steps, uncompensated and with each compensation."""
    asked = argparse.Namespace(half=True, s_curve=0.0)
    known = bench_gamma.measured(asked)
    rig = bench_gamma.rig_of({"object": "face"}, False, asked)
    maps = bench_gamma.methods(rig, known, 3)
    shown = {
        "none": "uncompensated", "(b) table": "table measured on a plane", "(c) harmonics": "the scan's own harmonics",
        "(a) ramp, quiet rounding": "ramp measured on a plane",
    }  # fmt: skip
    drawn = figure(10.4, 3.5)
    for axes, (method, title) in zip(drawn.subplots(1, 4), shown.items(), strict=True):
        error = error_um(rig, maps[method])
        rms = np.sqrt(np.nanmean(np.where(np.abs(error) < 5000, error, np.nan) ** 2))
        error = error[PART]
        top = 1000 if method == "none" else 300 if method.startswith("(b)") else 30 if method.startswith("(c)") else 5
        axes.set_facecolor(PAPER)
        image = axes.imshow(error, cmap="RdBu_r", vmin=-top, vmax=top, interpolation="nearest")
        axes.set_xticks([])
        axes.set_yticks([])
        titled(axes, title, False)
        axes.set_xlabel(f"whole face: {rms:.3g} µm RMS", fontsize=9, color=INK)
        colour_bar(drawn, image, axes, "error / µm", "both")
    save(drawn, path)
    Image.open(path).convert("RGB").quantize(128).save(path, optimize=True)
    return path


if __name__ == "__main__":
    print(draw_errors(FOLDER / "nonlinearity.png"))
    print(draw_face(FOLDER / "nonlinearity-face.png"))
