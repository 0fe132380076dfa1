"""Draw docs/pictures/heads.png: twelve of the heads of the face database, from the front and from 60 degrees aside.

.venv/bin/python tools/pictures/heads.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

from bench_accuracy import simulated  # noqa: E402
from shrink import LARGEST_BYTES  # noqa: E402

from fringed_client.pictures.figures import INK, PAPER, figure, save, titled  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "heads.png"
HEADS, COLUMNS = 12, 4
ANGLES_DEG = (0.0, 60.0)
SENSOR = {"width_px": 696, "height_px": 520}
SHOWN = (slice(24, 504), (slice(196, 500), slice(178, 536)))  # rows, and columns at each angle
LIGHT = (0.45, -0.5, -0.74)  # from above at the right, towards the head
FAR_MM = 6.0  # neighbours farther apart are two surfaces
SMALLER = 2


def shaded(variant: int, angle_deg: float) -> Any:
    """Return a head as matt plaster, (rows, columns, 3) 0 to 1, on paper; smaller by averaging."""
    scene = {"object": "face", "options": {"variant": variant}, "rotation_deg": (0.0, angle_deg, 0.0)}
    truth = simulated(scene, 1, SENSOR).truth()
    seen = truth.is_object[..., None] > 0
    xyz = np.where(seen, truth.xyz_mm, np.nan).astype(np.float64)
    right, down = (clear(np.diff(xyz, axis=axis, append=np.nan)) for axis in (1, 0))
    normal = np.cross(right, down)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    light = np.array(LIGHT) / np.linalg.norm(LIGHT)
    lit = 0.12 + 0.86 * np.nan_to_num(np.clip(-normal @ light, 0, 1))
    paper = np.array([int(PAPER[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    plaster = np.where(seen, lit[..., None] * [1.0, 0.98, 0.95], paper)
    part = plaster[SHOWN[0], SHOWN[1][ANGLES_DEG.index(angle_deg)]]
    rows, columns = (size // SMALLER for size in part.shape[:2])
    return part.reshape(rows, SMALLER, columns, SMALLER, 3).mean(axis=(1, 3))


def clear(step: Any) -> Any:
    """Return steps between neighbours of one surface; NaN across its edges."""
    return np.where(np.linalg.norm(step, axis=2, keepdims=True) < FAR_MM, step, np.nan)


def main() -> None:
    sheets = [np.hstack([shaded(variant, angle) for angle in ANGLES_DEG]) for variant in range(1, HEADS + 1)]
    rows = HEADS // COLUMNS
    drawn = figure(12.6, 8.3)
    axes = drawn.subplots(rows, COLUMNS)
    for number, (sheet, panel) in enumerate(zip(sheets, axes.flat, strict=True), 1):
        panel.imshow(sheet, interpolation="antialiased")
        titled(panel, f"variant {number}", simulated=number == COLUMNS)
        panel.set_axis_off()
    drawn.suptitle("heads of the face database, from the front and turned by 60°", fontsize=12, color=INK)
    save(drawn, PICTURE)
    picture = Image.open(PICTURE).convert("RGB")
    picture.thumbnail((940, 2000), Image.Resampling.LANCZOS)
    # By maximum coverage: the median cut of `shrink` makes steps in the shade, and has no orange left for the mark.
    picture.quantize(160, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(PICTURE, optimize=True)
    if PICTURE.stat().st_size > LARGEST_BYTES:
        raise ValueError(f"{PICTURE} has {PICTURE.stat().st_size} bytes; draw it smaller")
    print(PICTURE, PICTURE.stat().st_size)


if __name__ == "__main__":
    main()
