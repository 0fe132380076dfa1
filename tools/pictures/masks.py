"""Draw docs/pictures/masks.png: why pixels of the simulated face are dropped, and a board on which all masks are on.

python tools/pictures/masks.py
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from scipy.ndimage import binary_dilation

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from bench_accuracy import simulated, take  # noqa: E402
from shrink import shrink  # noqa: E402

from fringed.data import FrameSet, PhaseMap, Reject  # noqa: E402
from fringed.testing import RecordingContext  # noqa: E402
from fringed_client.pictures.figures import figure, save, titled  # noqa: E402
from fringed_plugins.decoders.sinusoidal import MultiFrequencyDecoder  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "masks.png"
REASONS = {
    Reject.HOT_PIXEL: ("hot pixel", "#000000"),
    Reject.SATURATED: ("saturated", "#cc79a7"),
    Reject.SHADOW: ("shadow: light without fringes", "#0072b2"),
    Reject.RESIDUAL: ("residual: no sinusoid", "#009e73"),
    Reject.LOW_MODULATION: ("low modulation: dark", "#3a3a4a"),
    Reject.FRINGE_ORDER: ("fringe order in doubt", "#56b4e9"),
    Reject.DISCONTINUITY: ("discontinuity: mixed, or glow", "#d55e00"),
    Reject.ISOLATED: ("isolated", "#e69f00"),
    Reject.REPEATED: ("repeats a projector pixel", "#f0e442"),
    Reject.OUT_OF_RANGE: ("not on the projector", "#999999"),
}
GREY = 0.78


def first_reason(rejected: Any) -> Any:
    """Return the number of the first reason of the list that holds for each pixel; 0 where it is kept."""
    shown = np.zeros(rejected.shape, np.uint8)
    for number, reason in reversed(list(enumerate(REASONS, 1))):
        shown[(rejected & int(reason)) > 0] = number
    return shown


def spoiled(frames: FrameSet) -> FrameSet:
    """Return the frames with what a rig may do to them: hot pixels, a lamp's reflection, something that moved."""
    images = frames.frames.astype(float)
    rng = np.random.default_rng(4)
    for y, x in zip(rng.integers(300, 800, 40), rng.integers(450, 950, 40), strict=True):
        images[:, y - 1 : y + 1, x - 1 : x + 1][:, 1, 1] += 90
    y, x = np.mgrid[: images.shape[1], : images.shape[2]]
    images[:, (x - 600) ** 2 + (y - 420) ** 2 < 30**2] += 220
    moved = (x - 760) ** 2 + (y - 760) ** 2 < 34**2
    images[6, moved] = images[6, moved] * 0.45
    return replace(frames, frames=np.clip(np.rint(images), 0, 255).astype(np.uint8))


def decode(frames: FrameSet, **params: Any) -> PhaseMap:
    decoder = MultiFrequencyDecoder()
    phase: PhaseMap = decoder.run({"frames": frames}, decoder.Params(**params), RecordingContext())
    return phase


def draw(axes: Any, phase: PhaseMap, title: str, window: tuple[slice, slice]) -> set[int]:
    shown = first_reason(phase.rejected)[window]
    hot = binary_dilation(shown == 1, iterations=2)  # single pixels would not be seen
    shown = np.where(hot, np.uint8(1), shown)
    light = phase.background[window]
    picture = np.repeat((GREY + (1 - GREY) * np.clip(light / max(light.max(), 1), 0, 1))[..., None], 3, axis=2)
    colours = ListedColormap([colour for _, colour in REASONS.values()])
    picture[shown > 0] = colours(shown[shown > 0] - 1)[:, :3]
    axes.imshow(picture, interpolation="nearest")
    titled(axes, title, simulated=True)
    axes.set_xticks([])
    axes.set_yticks([])
    return set(np.unique(shown[shown > 0]).tolist())


def main() -> None:
    frames = take(simulated({"object": "face"}, 1))
    everything = {"hot_pixel_spread": 1.0, "min_contrast": 0.1, "dark_level_dn": 1.0, "min_region_px": 60}
    broken = spoiled(frames)
    views = (
        (decode(frames), "default parameters", (slice(None), slice(None))),
        (decode(broken, **everything), "frames spoiled on purpose; all masks on", (slice(230, 830), slice(350, 1150))),
        (decode(frames, drop_repeated=True), "drop_repeated, 60 x 45 px",
         (slice(480, 525), slice(640, 700))),
    )  # fmt: skip
    drawn = figure(12.5, 4.3)
    panels = drawn.subplots(1, 3)
    used: set[int] = set()
    for axes, (phase, title, window) in zip(panels, views, strict=True):
        used |= draw(axes, phase, title, window)
    patches = [Patch(color=colour, label=label) for n, (label, colour) in enumerate(REASONS.values(), 1) if n in used]
    patches.append(Patch(facecolor=str(GREY + 0.1), edgecolor="#888888", label="kept"))
    drawn.legend(handles=patches, loc="outside lower center", ncol=6, fontsize=8, frameon=False)
    shrink(save(drawn, PICTURE))


if __name__ == "__main__":
    main()
