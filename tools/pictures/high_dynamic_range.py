"""Draw docs/pictures/high-dynamic-range.png: a shiny dome of several albedos with three exposures, and fused.

python tools/pictures/high_dynamic_range.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "bench"), str(ROOT / "tools" / "pictures")]

from bench_hdr import EXPOSURE_US, FACTORS, decoded, fuse, rig_of, take  # noqa: E402
from shrink import shrink  # noqa: E402

from fringed.data import FrameSet, PhaseMap, Reject  # noqa: E402
from fringed_client.pictures.figures import INK, colour_bar, figure, save, titled  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "high-dynamic-range.png"
WORST_MRAD = 100.0
SATURATED, DARK = "#cc79a7", "#22222c"


def bounds(wanted: Any, margin: int = 10) -> tuple[slice, slice]:
    """Return the rows and columns that hold the object."""
    rows, columns = np.flatnonzero(wanted.any(axis=1)), np.flatnonzero(wanted.any(axis=0))
    return slice(max(rows[0] - margin, 0), rows[-1] + margin), slice(max(columns[0] - margin, 0), columns[-1] + margin)


def draw_light(axes: Any, frame_set: FrameSet, where: Any, title: str) -> None:
    """Show the brightest grey level of each pixel; saturated ones in colour."""
    peak = frame_set.frames.max(axis=0)[where]
    image = np.repeat(peak[..., None], 3, axis=2) / 255.0
    image[peak >= 255] = [int(SATURATED[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    axes.imshow(image, interpolation="nearest")
    titled(axes, title, False)


def draw_sigma(axes: Any, phase: PhaseMap, where: Any, title: str) -> Any:
    """Show the deviation of the phase; where there is none, why."""
    assert phase.sigma_rad is not None
    axes.set_facecolor(DARK)
    saturated = (phase.rejected[where] & int(Reject.SATURATED)) > 0
    axes.imshow(np.where(saturated[..., None], [0.8, 0.475, 0.655, 1.0], [0, 0, 0, 0.0]), interpolation="nearest")
    kept = np.where(phase.rejected[where] == 0, phase.sigma_rad[where] * 1e3, np.nan)
    shown = axes.imshow(kept, cmap="viridis_r", vmin=0, vmax=WORST_MRAD, interpolation="nearest")
    titled(axes, title, False)
    return shown


def main() -> None:
    rig = rig_of(696, 520)
    sets = [take(rig, EXPOSURE_US * factor) for factor in FACTORS]
    maps = [decoded(one) for one in sets]
    fused = fuse(maps)[0]
    truth = rig.truth()
    wanted = (truth.is_object > 0) & (truth.visible > 0) & (truth.lit > 0)
    where = bounds(wanted)
    drawn = figure(10.4, 5.3)
    axes = drawn.subplots(2, 4)
    for column, (frame_set, phase, factor) in enumerate(zip(sets, maps, FACTORS, strict=True)):
        draw_light(axes[0, column], frame_set, where, f"{EXPOSURE_US * factor / 1000:.3g} ms")
        kept = ((phase.rejected == 0) & wanted).sum() / wanted.sum()
        shown = draw_sigma(axes[1, column], phase, where, f"{kept:.0%} of the points")
    kept = ((fused.rejected == 0) & wanted).sum() / wanted.sum()
    draw_sigma(axes[1, 3], fused, where, f"fused: {kept:.1%}")
    axes[0, 3].axis("off")
    text = (
        "Above: the brightest grey level\nof each pixel, saturated ones in\npink.\n\nBelow: the standard deviation of\n"
        "the phase, 64 periods; black where\nthere are no fringes to see, pink\nwhere they are saturated."
    )
    axes[0, 3].text(0.0, 0.95, text, fontsize=9, color=INK, va="top", transform=axes[0, 3].transAxes)
    axes[0, 3].text(0.0, 0.02, "SIMULATED", fontsize=8, color="#b3541e", weight="bold", transform=axes[0, 3].transAxes)
    for one in axes.ravel():
        one.set_xticks([])
        one.set_yticks([])
    colour_bar(drawn, shown, axes[1, 3], "sigma / mrad", "max")
    shrink(save(drawn, PICTURE))


if __name__ == "__main__":
    main()
