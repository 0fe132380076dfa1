"""The face database: frontal view and a view from 60 degrees aside, 30 heads, both sides, registered with no guess.

Default settings. Errors are those of the rotation, and RMS over the model's points of where the motion takes them;
right is what is below both limits. A result that says it has converged and is not right is a wrong one.

    python tests/bench/bench_heads.py [--folder FOLDER] [--count 30] [--resolution 0.5] [--worst PICTURE.png]
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from heads import Array, HeadView, arguments, heads, say
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.register import Options, register
from fringed_plugins.registration.result import Alignment
from fringed_plugins.registration.surface import Surface, prepare

DEGREES, MM, RATE = 0.2, 0.2, 0.95


class Outcome(NamedTuple):
    """One pair, registered: `T_true` takes model points to the frame of the reference."""

    reference: HeadView
    model: HeadView
    found: Alignment
    T_true: Array
    degrees: float
    mm: float
    seconds: float

    @property
    def right(self) -> bool:
        return self.degrees < DEGREES and self.mm < MM

    @property
    def name(self) -> str:
        return f"head {self.model.variant:2d} {self.model.angle_deg:+d}"


def prepared(view: HeadView, name: str) -> Surface:
    return prepare(view.xyz_mm, view.rejected, view.sigma_mm, name)


def pair(reference: HeadView, model: HeadView) -> Outcome:
    """Register one pair from raw arrays; measured points stand for true ones: a motion's error is smooth."""
    started = time.perf_counter()
    found = register(prepared(reference, "reference"), prepared(model, "model"), Options(threads=2))
    seconds = time.perf_counter() - started
    T_true = reference.T_camera_object @ np.linalg.inv(model.T_camera_object)
    points = model.xyz_mm[model.rejected == 0].astype(np.float64)
    T = found.T_reference_model
    off = points @ (T - T_true)[:3, :3].T + (T - T_true)[:3, 3]
    turn = Rotation.from_matrix((np.linalg.inv(T_true) @ T)[:3, :3]).magnitude()
    return Outcome(
        reference, model, found, T_true, float(np.degrees(turn)), float(np.sqrt((off**2).sum(1).mean())), seconds
    )


def line(one: Outcome) -> str:
    verdict = "right" if one.right else "WRONG"
    believed = "converged" if one.found.converged else f"not converged: {one.found.reason}"
    return (
        f"INFO    {one.name}: {verdict} {one.degrees:8.4f} deg {one.mm:8.4f} mm, overlap {one.found.overlap:.2f}, "
        f"{one.seconds:.2f} s, {believed}"
    )


def summary(outcomes: list[Outcome]) -> None:
    """Print what is asked for beside what came out, then what went wrong."""
    good = [one for one in outcomes if one.right and one.found.converged]
    wrong = [one for one in outcomes if one.found.converged and not one.right]
    rate = len(good) / len(outcomes)
    said = f"{len(good)} of {len(outcomes)} pairs right, {rate:.1%} (over {RATE:.0%}; {DEGREES:g} deg, {MM:g} mm)"
    print(f"{'PASS' if rate > RATE else 'MISS'}  heads, 60 deg, no guess: {said}")
    print(f"{'MISS' if wrong else 'PASS'}  wrong ones reported as converged: {len(wrong)} (0)")
    for what, ones in (("of those right", good), ("of all", outcomes)):
        if ones:
            figures = np.array([(one.degrees, one.mm, one.seconds) for one in ones])
            middle, most = (
                f"{degrees:.4f} deg, {mm:.4f} mm, {seconds:.2f} s"
                for degrees, mm, seconds in (np.median(figures, axis=0), figures.max(axis=0))
            )
            print(f"INFO  {what}: median {middle}; worst {most}")
    modest = sum(one.right and not one.found.converged for one in outcomes)
    print(f"INFO  right, yet reported as not converged: {modest}")
    reasons = Counter(one.found.reason for one in outcomes if not one.found.converged)
    for reason, count in reasons.most_common():
        print(f"INFO    {count} x {reason}")


def draw(path: Path, one: Outcome) -> None:
    """Draw a pair from above and from the side, as it should be and as it was found."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 10), layout="constrained")
    rng = np.random.default_rng(0)
    clouds = [view.xyz_mm[view.rejected == 0] for view in (one.reference, one.model)]
    fixed, moving = (rng.permutation(cloud)[:15000] for cloud in clouds)
    motions = (
        (one.T_true, "true"),
        (one.found.T_reference_model, f"found: {one.degrees:.3f} deg, {one.mm:.3f} mm off"),
    )
    for row, (T, title) in zip(axes, motions, strict=True):
        moved = moving @ T[:3, :3].T + T[:3, 3]
        for axis, (a, b, seen) in zip(row, ((0, 2, "from above"), (2, 1, "from the side")), strict=True):
            for cloud, colour in ((fixed, "#3b6ea5"), (moved, "#c8553d")):
                axis.plot(cloud[:, a], cloud[:, b], ",", color=colour)
            axis.set(title=f"{title}, {seen}", aspect="equal", xlabel=f"{'xyz'[a]} (mm)", ylabel=f"{'xyz'[b]} (mm)")
            axis.invert_yaxis()
    figure.suptitle(f"{one.name}: {one.found.reason}")
    figure.savefig(path, dpi=90)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--worst", type=Path, help="draw the pair with the largest error here")
    asked = parser.parse_args()
    views = heads(asked.folder, asked.count, asked.resolution)
    sides = [(front, side) for front, *both in zip(views[::3], views[1::3], views[2::3], strict=True) for side in both]
    pair(*sides[0])  # compiles
    outcomes = []
    for number, (reference, model) in enumerate(sides, 1):
        outcomes.append(pair(reference, model))
        print(line(outcomes[-1]), flush=True)
        say(f"registered {number} of {len(sides)}")
    summary(outcomes)
    if asked.worst:
        draw(asked.worst, max(outcomes, key=lambda one: one.mm))
        print(f"INFO  the worst pair is drawn in {asked.worst}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
