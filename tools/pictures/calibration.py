"""Draw docs/pictures/calibration.png: a pose, what perspective does to centres, the expected and the true error.

python tools/pictures/calibration.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "bench"), str(ROOT / "tools" / "pictures")]

from bench_accuracy import along_ray_mm, take  # noqa: E402
from bench_calibration import OBJECTS, centre_errors, numbers, phase_of, poses, rig_of, run, sigmas, view_of  # noqa: E402
from shrink import shrink  # noqa: E402

from fringed.data import Calibration  # noqa: E402
from fringed_client.pictures.figures import ACCENT, FAINT, INK, colour_bar, figure, labelled, save, titled  # noqa: E402
from fringed_plugins.calibrators.calibrate import Calibrate  # noqa: E402

PICTURE = ROOT / "docs" / "pictures" / "calibration.png"
BLUE = "#2e6f95"


def draw_pose(axes: Any, view: Any) -> None:
    width, height = view.camera_size_px
    axes.imshow(view.picture, cmap="gray", extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.plot(*view.camera_px.T, "+", color="#3fa7d6", markersize=5)
    titled(axes, f"one of 12 poses: {len(view.index)} circles", True, narrow=True)
    axes.set_axis_off()


def draw_centres(axes: Any, taken: list[Any], camera: Any) -> None:
    """Show the errors of all centres, with the perspective's bias and without."""
    errors, biases, _ = zip(*(centre_errors(one, camera) for one in taken), strict=True)
    every, bias = np.concatenate(errors) * 1e3, np.concatenate(biases) * 1e3
    axes.plot(*(every + bias).T, ".", color=FAINT, markersize=2.5, label="centres of the ellipses")
    axes.plot(*every.T, ".", color=BLUE, markersize=2.5, label="with the perspective's bias undone")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize=8, loc="upper left", markerscale=3)
    titled(axes, "errors of the circles' centres", True)
    labelled(axes, "x / thousandths of a pixel", "y / thousandths of a pixel")


def draw_numbers(axes: Any, found: Calibration, exact: Calibration) -> None:
    ours, true, known = numbers(found), numbers(exact), sigmas(found)
    off = [(ours[name] - true[name]) / known[name] for name in ours]
    axes.axvspan(-1, 1, color=FAINT, alpha=0.25, linewidth=0)
    axes.axvline(0, color=INK, linewidth=0.6)
    axes.plot(off, range(len(off)), "o", color=ACCENT, markersize=5)
    axes.set_yticks(range(len(off)), list(ours), fontsize=8)
    axes.set_xlim(-3.6, 3.6)
    axes.invert_yaxis()
    titled(axes, "parameters against the truth", True)
    labelled(axes, "error / its stated standard deviation", "")


def draw_error(drawn: Any, axes: Any, found: Calibration) -> None:
    rig = rig_of(1, False, 0.0, OBJECTS["face"])
    view = view_of(phase_of(take(rig)), found)
    truth = rig.truth()
    error = np.where((view.rejected == 0) & (truth.is_object > 0), along_ray_mm(view, truth) * 1e3, np.nan)
    rows, columns = np.flatnonzero(np.isfinite(error).any(axis=1)), np.flatnonzero(np.isfinite(error).any(axis=0))
    shown = axes.imshow(
        error[rows[0] : rows[-1], columns[0] : columns[-1]][::3, ::3], cmap="RdBu_r", vmin=-20, vmax=20,
        interpolation="nearest",
    )  # fmt: skip
    titled(axes, "a face: error along the ray, without noise", True, narrow=True)
    axes.set_axis_off()
    colour_bar(drawn, shown, axes, "micrometres", extend="both")


def main() -> None:
    rig = rig_of(1, True, 0.0, {"object": "plane"})
    taken, _ = poses(rig)
    found: Calibration = run(Calibrate, {"views": [one.view for one in taken]})
    drawn = figure(11.0, 8.2)
    axes = drawn.subplots(2, 2)
    draw_pose(axes[0, 0], taken[4].view)
    draw_centres(axes[0, 1], taken, rig.calibration().camera)
    draw_numbers(axes[1, 0], found, rig.calibration())
    draw_error(drawn, axes[1, 1], found)
    print(shrink(save(drawn, PICTURE)))


if __name__ == "__main__":
    main()
