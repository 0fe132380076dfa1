"""What speaks against a set of views, before and after it is estimated: each with its figure, its limit and what to do.

Owns the tests that need no estimation, and the words.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.solve.observations import Observation, Rig

Float64Array = npt.NDArray[np.float64]

PARALLEL_DEG, FLAT_DEG = 8.0, 20.0  # spread of the boards' normals: refused below, told below
VAGUE, OPEN = 0.003, 0.03  # deviation of a focal length: told above, refused above
_CELLS = (4, 3)
_COVERED = 0.75
_SAME_MM, _SAME_DEG = 8.0, 1.5


class Finding(NamedTuple):
    """One thing: about `view` ("" for all), `fatal` where no calibration can come of it."""

    view: str
    text: str
    fatal: bool = False


def handedness(seen: Sequence[Observation]) -> list[Finding]:
    """Say where the projector's picture is a mirror image of what it should be: swapped or flipped axes.

    A board that is seen from its front is turned alike in the camera's and in the projector's picture.
    """
    slopes = [slope for o in seen if (slope := _affine(o)) is not None]
    wrong = [slope for slope in slopes if np.linalg.det(slope) < 0]
    if not slopes or len(wrong) * 2 <= len(slopes):
        return [
            Finding(o.name, "its projector pixels are mirrored, those of other views are not: another projection?")
            for o in seen
            if (slope := _affine(o)) is not None and np.linalg.det(slope) < 0
        ]
    middle = np.median(wrong, axis=0)
    if abs(middle[0, 1]) + abs(middle[1, 0]) > abs(middle[0, 0]) + abs(middle[1, 1]):
        what = "the projector's columns and rows are swapped"
    else:
        what = f"the projector's {'columns' if middle[0, 0] < 0 else 'rows'} run backwards"
    return [
        Finding(
            "",
            f"{what}, in {len(wrong)} of {len(slopes)} views: set the projector's mirroring (rear, ceiling) to normal, "
            "or name the sets by the direction that they count",
            True,
        )
    ]


def _affine(observed: Observation) -> Float64Array | None:
    """Return the projector's pixel by the camera's (2, 2), None where too little is known."""
    lit = observed.lit
    if lit.sum() < 6:
        return None
    camera = np.column_stack([observed.camera_px[lit], np.ones(lit.sum())])
    solution, *_ = np.linalg.lstsq(camera, observed.projector_px[lit], rcond=None)
    return np.asarray(solution[:2].T)


def tilt_spread_deg(poses: Float64Array) -> float:
    """Return the largest angle between the normals of the boards (v, 4, 4)."""
    normals = poses[:, :3, 2]
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1).min())))


def tilts(poses: Float64Array) -> list[Finding]:
    """Say where the boards face too much alike: focal length and depth are then one and the same."""
    spread = tilt_spread_deg(poses)
    if spread < PARALLEL_DEG:
        return [
            Finding(
                "",
                f"all boards face the same way within {spread:.1f} degrees, at least {PARALLEL_DEG:.0f} are needed: "
                "the focal lengths cannot be told from the distance; tilt the board by 20 to 40 degrees, each time "
                "another way",
                True,
            )
        ]
    if spread < FLAT_DEG:
        return [Finding("", f"the boards differ by {spread:.0f} degrees of tilt at most; 30 and more make it surer")]
    return []


def duplicates(seen: Sequence[Observation], poses: Float64Array) -> list[Finding]:
    """Say which views show the board where another one does: they count twice and tell nothing."""
    found = []
    for j in range(1, len(poses)):
        for i in range(j):
            turn = poses[i, :3, :3].T @ poses[j, :3, :3]
            angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
            if angle < _SAME_DEG and np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3]) < _SAME_MM:
                found.append(Finding(seen[j].name, f"the board stands where it stood in {seen[i].name}; move it"))
                break
    return found


def coverage(seen: Sequence[Observation], size: tuple[int, int]) -> tuple[float, list[Finding]]:
    """Return the share of the picture's cells that points of some view lie in, and what is missing."""
    points = np.concatenate([o.camera_px for o in seen]) + 0.5
    cells = np.minimum((points / size * _CELLS).astype(int), np.array(_CELLS) - 1)
    held = np.zeros(_CELLS, bool)
    held[cells[:, 0], cells[:, 1]] = True
    share = float(held.mean())
    if share >= _COVERED:
        return share, []
    empty = ", ".join(sorted({_where(x, y) for x, y in np.argwhere(~held)}))
    text = f"{share:.0%} of the picture was covered by boards, {_COVERED:.0%} should be: none was seen at the {empty}"
    return share, [Finding("", f"{text}; the distortion there is a guess")]


def _where(x: int, y: int) -> str:
    across = ("left", "", "", "right")[x]
    down = ("top", "", "bottom")[y]
    return f"{down} {across}".strip() or "middle"


def lenses(rig: Rig, covariance: Float64Array) -> list[Finding]:
    """Say what no lens is like, and which focal length the views leave open; `covariance` (24, 24) is of `NUMBERS`.

    A pixel that is not square, or a centre far outside of the picture's, is told; so is a focal length that is known
    to less than 0.3 %, and one to less than 3 % is refused.
    """
    found = []
    sides = (("camera", rig.camera, 0, 0.005, 0.25), ("projector", rig.projector, 9, 0.02, 0.8))
    for name, lens, place, square, reach in sides:
        ratio = lens.matrix[1, 1] / lens.matrix[0, 0]
        if abs(ratio - 1) > square:
            text = f"the {name}'s pixels come out {abs(ratio - 1):.1%} {'higher' if ratio < 1 else 'wider'} than square"
            found.append(Finding("", f"{text}: is the picture scaled, or the board's print stretched?"))
        size = np.array([lens.width_px, lens.height_px])
        if (abs(lens.matrix[:2, 2] - (size - 1) / 2) > reach * size).any():
            at = f"({lens.matrix[0, 2]:.0f}, {lens.matrix[1, 2]:.0f})"
            found.append(Finding("", f"the {name}'s principal point {at} is far from the middle of its picture"))
        open_ = max(np.sqrt(covariance[place + k, place + k]) / lens.matrix[k, k] for k in (0, 1))
        if open_ > VAGUE:
            text = f"the {name}'s focal length is known to {open_:.1%} only, {VAGUE:.1%} is good and {OPEN:.0%} needed"
            found.append(Finding("", f"{text}: tilt the board more, and let it fill the picture", bool(open_ > OPEN)))
    return found
