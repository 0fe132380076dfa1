"""The projector's tone curve and how well it is known.

Owns how a curve is shown; computes none.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fringed.data import Calibration
from fringed_client.pictures.figures import ACCENT, FAINT, INK, figure, labelled, save, titled


def draw_tone(path: Path, calibration: Calibration, simulated: bool) -> Path:
    """Draw the light of each grey level beside the straight line, and what the calibration says of it.

    Raises
    ------
    ValueError
        the calibration has no tone curve.
    """
    curve = calibration.tone_curve
    if curve is None:
        raise ValueError("the calibration has no tone curve")
    drawn = figure(6.4, 4.4)
    axes = drawn.add_subplot()
    grey = np.arange(len(curve))
    known = calibration.residuals.get("tone_deviation", 0.0)
    axes.plot((0, 255), (0, 1), color=FAINT, linewidth=0.8, label="a linear projector")
    axes.fill_between(grey, curve - 5 * known, curve + 5 * known, color=ACCENT, alpha=0.25, linewidth=0)
    label = f"measured, ± {known:.2%} (band: five times that)" if known else "as the calibration has it"
    axes.plot(grey, curve, color=ACCENT, linewidth=1.6, label=label)
    axes.legend(fontsize=8, frameon=False, loc="upper left", labelcolor=INK)
    axes.set_xlim(0, 255)
    axes.set_ylim(-0.02, 1.02)
    axes.grid(True, linewidth=0.3, color="#d9d9d4")
    titled(axes, "light of each grey level", simulated)
    labelled(axes, "grey level", "light over that of white")
    return save(drawn, path)
