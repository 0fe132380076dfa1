"""The face database: heads of different people, each scanned from the front and from 60 degrees to both sides.

The rig is the simulated one with its default noise, lenses and light, at half its resolution in both directions (696 x
520 px, some 0.6 mm a pixel); 12 frames a view are decoded and triangulated by the built-in processors with the rig's
exact calibration. Scans are kept, one file a view, and taken again where the simulator or the decoders have changed.

    python tests/bench/heads.py [--folder FOLDER] [--count 30] [--resolution 0.5]
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from bench_accuracy import measured, simulated, take

import fringed.simulation
import fringed_plugins.decoders

ANGLES_DEG = (0, 60, -60)
COUNT = 30
RESOLUTION = 0.5
MARGIN_PX = 4
FULL_PX = (1392, 1040)
FOLDER = Path(tempfile.gettempdir()) / "fringed-heads"

Array = np.ndarray[Any, Any]


class HeadView(NamedTuple):
    """One range image, cut to the head.

    `xyz_mm` (h, w, 3) float32 in the camera's frame, NaN where nothing was measured; `rejected` (h, w) uint8, zero
    where a point counts; `sigma_mm` (h, w) float32 along the ray; `intensity` (h, w) uint8; `T_camera_object` (4, 4),
    exact.
    """

    variant: int
    angle_deg: int
    xyz_mm: Array
    rejected: Array
    sigma_mm: Array
    intensity: Array
    T_camera_object: Array


def heads(folder: Path = FOLDER, count: int = COUNT, resolution: float = RESOLUTION) -> list[HeadView]:
    """Return the views of variants 1 to `count`, frontal, +60 and -60 degrees; scan those that `folder` lacks.

    Raises
    ------
    ValueError
        no head, or a resolution that is not above 0 and at most 1.
    """
    if count < 1 or not 0 < resolution <= 1:
        raise ValueError(f"{count} heads at {resolution:g} of the resolution; allowed are 1 or more, above 0 to 1")
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [(variant, angle) for variant in range(1, count + 1) for angle in ANGLES_DEG]
    started, views = time.perf_counter(), []
    for number, (variant, angle) in enumerate(wanted, 1):
        name = f"head-{variant:03d}{angle:+03d}-{resolution:g}"
        path = folder / f"{name}-{fingerprint()}.npz"
        if not path.exists():
            for stale in folder.glob(f"{name}-*.npz"):
                stale.unlink()
            keep(path, scan(variant, angle, resolution))
            say(f"scanned {number} of {len(wanted)}, {time.perf_counter() - started:.0f} s")
        views.append(load(path))
    return views


def scan(variant: int, angle_deg: int, resolution: float = RESOLUTION) -> HeadView:
    """Return one view; its noise depends on the view alone, so that an interrupted run ends like a whole one."""
    scene = {"object": "face", "options": {"variant": variant}, "rotation_deg": (0.0, float(angle_deg), 0.0)}
    width, height = (round(resolution * size) for size in FULL_PX)
    seed = len(ANGLES_DEG) * variant + ANGLES_DEG.index(angle_deg)
    rig = simulated(scene, seed, {"width_px": width, "height_px": height})
    view = measured(rig, take(rig))
    assert view.sigma_mm is not None
    part = around(view.rejected == 0)
    arrays = (np.ascontiguousarray(a[part]) for a in (view.xyz_mm, view.rejected, view.sigma_mm, view.intensity))
    return HeadView(variant, angle_deg, *arrays, rig.truth().T_camera_object)


def around(kept: Array) -> tuple[slice, slice]:
    """Return the rows and columns that hold all of `kept`, with a margin."""
    spans = [np.flatnonzero(kept.any(axis=axis)) for axis in (1, 0)]
    rows, columns = (slice(max(int(s[0]) - MARGIN_PX, 0), int(s[-1]) + MARGIN_PX + 1) for s in spans)
    return rows, columns


def keep(path: Path, view: HeadView) -> None:
    """Write a view; what is killed while it writes leaves no file of this name."""
    aside = path.with_name(f".{path.stem}.{os.getpid()}.npz")
    np.savez_compressed(aside, **view._asdict())
    aside.replace(path)


def load(path: Path) -> HeadView:
    with np.load(path) as file:
        arrays = {name: file[name] for name in HeadView._fields}
    return HeadView(**arrays | {name: int(arrays[name]) for name in ("variant", "angle_deg")})


@cache
def fingerprint() -> str:
    """Return a name that is another one when the simulator, the decoders or the triangulation has changed."""
    plugins = Path(next(iter(fringed_plugins.decoders.__path__)))
    sources = [*plugins.rglob("*.py"), *plugins.parent.glob("triangulation*.py")]
    sources += [path for root in fringed.simulation.__path__ for path in Path(root).rglob("*.py")]
    digest = hashlib.sha256()
    for path in sorted(sources):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def say(text: str) -> None:
    """Show progress on one line of a terminal, or on lines of a log."""
    end = "\r" if sys.stderr.isatty() else "\n"
    print(f"heads: {text}", end=end, file=sys.stderr, flush=True)


def arguments(about: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=FOLDER, help=f"where scans are kept ({FOLDER})")
    parser.add_argument("--count", type=int, default=COUNT, help=f"number of heads ({COUNT})")
    parser.add_argument("--resolution", type=float, default=RESOLUTION, help=f"part of the rig's ({RESOLUTION})")
    return parser


def main() -> None:
    asked = arguments(__doc__).parse_args()
    started = time.perf_counter()
    views = heads(asked.folder, asked.count, asked.resolution)
    points = np.mean([(view.rejected == 0).sum() for view in views])
    print(f"{len(views)} views of {points:,.0f} points, {time.perf_counter() - started:.0f} s, in {asked.folder}")


if __name__ == "__main__":
    main()
