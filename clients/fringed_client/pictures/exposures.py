"""A picture of how bright a scene is, and of the exposures that show it.

Owns how the document of `suggest-exposures` is drawn; computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fringed_client.pictures.figures import ACCENT, FAINT, figure, labelled, save, titled


def draw_exposures(path: Path, found: Mapping[str, Any], simulated: bool) -> Path:
    """Draw the pixels by the exposure that brings them to full scale, with the exposures that are suggested."""
    drawn = figure(7.6, 3.6)
    axes = drawn.add_subplot()
    edges = np.array(found["histogram"]["edges_us"])
    pixels = np.array(found["histogram"]["pixels"], float)
    axes.bar(edges[:-1], pixels / max(pixels.sum(), 1), np.diff(edges), align="edge", color="#7f9fb5", linewidth=0)
    axes.set_xscale("log")
    axes.set_ylim(0, 1.22 * max(pixels.max() / max(pixels.sum(), 1), 1e-9))
    top = axes.get_ylim()[1]
    for index, exposure_us in enumerate(found["exposures_us"]):
        axes.axvline(exposure_us, color=ACCENT, linewidth=1.4, label="suggested" if index == 0 else None)
        axes.annotate(f" {exposure_us:g}", (exposure_us, 0.94 * top), fontsize=8, color=ACCENT)
    for index, exposure_us in enumerate(found["measured_us"]):
        axes.axvline(
            exposure_us, color=FAINT, linewidth=0.8, linestyle=":", label="measured with" if index == 0 else None
        )
    axes.legend(fontsize=8, frameon=False, loc="upper left")
    titled(axes, f"which exposure fills the sensor: {found['served']:.1%} of the pixels served", simulated)
    labelled(axes, "exposure that brings the pixel to full scale / µs", "share of the pixels with fringes")
    return save(drawn, path)
