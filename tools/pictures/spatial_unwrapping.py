"""Draw docs/pictures/spatial-unwrapping.png: three methods on a noisy map with a shadow, and where they are wrong.

    python tools/pictures/spatial_unwrapping.py

The surface is a face's relief in phase, with a box on the forehead that is 1.3 periods high.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from numpy.typing import NDArray
from PIL import Image

from fringed_client.pictures.figures import FAINT, INK, figure, save, titled
from fringed_plugins.unwrap.branch_cut import unwrap_branch_cut
from fringed_plugins.unwrap.least_squares import unwrap_least_squares
from fringed_plugins.unwrap.spatial import unwrap

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "spatial-unwrapping.png"
HEIGHT, WIDTH, NOISE_RAD = 400, 360, 0.6
TURNS = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
COLOURS = ("#0072b2", "#56b4e9", "#e9e7e0", "#e69f00", "#d55e00")
Array = NDArray[Any]


def scene() -> tuple[Array, Array, Array]:
    """Return the phase with its noise, the modulation, and what is background."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    u, v = (x - WIDTH / 2) / (0.46 * WIDTH), (y - HEIGHT / 2) / (0.47 * HEIGHT)
    head = 24 * np.sqrt(np.clip(1 - u**2 - v**2, 0, None))
    nose = 9 * np.exp(-((u / 0.14) ** 2 + ((v - 0.05) / 0.25) ** 2))
    eyes = -4 * np.exp(-(((np.abs(u) - 0.35) / 0.16) ** 2 + ((v + 0.2) / 0.1) ** 2))
    box = 1.3 * 2 * np.pi * ((np.abs(u + 0.05) < 0.2) & (np.abs(v + 0.58) < 0.1))
    shadow = ((u - 0.28) / 0.12) ** 2 + ((v - 0.12) / 0.22) ** 2 < 1
    truth = head + nose + eyes + box + rng.normal(0, NOISE_RAD, x.shape)
    outside = u**2 + v**2 > 0.96
    dark = shadow | outside
    truth = np.where(dark, rng.uniform(-np.pi, np.pi, x.shape), truth)
    return truth, np.where(dark, 3.0, 60.0), outside


def off_by(phase: Array, truth: Array, lit: Array) -> Array:
    """Return by how many turns each pixel is wrong, those of most being right; NaN where unknown."""
    turns = np.rint((phase - truth) / (2 * np.pi))
    most = float(np.median(turns[lit & np.isfinite(turns)]))
    return np.asarray(np.where(lit, np.clip(turns - most, -2, 2), np.nan))


def main() -> None:
    truth, modulation, outside = scene()
    wrapped = np.angle(np.exp(1j * truth))
    lit = ~outside & (modulation > 10)
    results: dict[str, Array] = {
        "quality-guided": unwrap(wrapped, modulation).phase_rad,
        "branch-cut": unwrap_branch_cut(wrapped).phase_rad,
        "least-squares, plain": unwrap_least_squares(wrapped).phase_rad,
        "np.unwrap twice": np.unwrap(np.unwrap(wrapped, axis=1), axis=0),
    }
    drawn = figure(11.2, 5.6)
    panels = drawn.subplots(2, 5)
    panels[1, 0].set_axis_off()
    first = panels[0, 0].imshow(wrapped, cmap="twilight", vmin=-np.pi, vmax=np.pi, interpolation="nearest")
    titled(panels[0, 0], "wrapped phase", simulated=False)
    bar = drawn.colorbar(first, ax=panels[1, 0], location="top", fraction=0.08, aspect=14, ticks=[-np.pi, 0, np.pi])
    bar.ax.set_xticklabels(["-π", "0", "π rad"], fontsize=8, color=INK)
    panels[1, 0].text(
        0.0, 0.72,
        f"noise {NOISE_RAD} rad\nshadow beside the nose and\nbackdrop: dark, not masked\n"
        "box on the forehead,\n1.3 periods high\n\n"
        "above: unwrapped phase\nbelow: turns off, where lit",
        transform=panels[1, 0].transAxes, fontsize=9, color=INK, va="top",
    )  # fmt: skip
    colours, norm = ListedColormap(COLOURS), BoundaryNorm(TURNS, len(COLOURS))
    image = None
    for column, (name, phase) in enumerate(results.items(), start=1):
        off = off_by(phase, truth, lit)
        share = 100 * float(np.mean(off[np.isfinite(off)] != 0))
        above = panels[0, column]
        above.imshow(phase - np.nanmedian(phase[lit]), cmap="viridis", vmin=-16, vmax=16, interpolation="nearest")
        titled(panels[0, column], name, simulated=False)
        image = panels[1, column].imshow(off, cmap=colours, norm=norm, interpolation="nearest")
        titled(panels[1, column], f"{share:.2f} % wrong", simulated=False)
    for axes in panels.ravel():
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor(FAINT)
    assert image is not None
    turns = drawn.colorbar(image, ax=list(panels[1, 1:]), location="bottom", fraction=0.06, aspect=50, pad=0.03)
    turns.set_ticks([-2, -1, 0, 1, 2], labels=["-2 or less", "-1", "right", "+1", "+2 turns or more"], fontsize=8)
    save(drawn, PICTURE)
    Image.open(PICTURE).convert("RGB").quantize(150, dither=Image.Dither.NONE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
