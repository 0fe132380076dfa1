"""From a lattice to a board: the turn and the place that make the numbered marks its own.

Owns the comparison with a board's own lattice. Marks of two sizes tell one turn from another, and a board from its
mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.board_spec import BoardSpec

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]
Bools = npt.NDArray[np.bool_]

_TURNS = tuple(
    np.array(m, np.int32) for m in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]])
)
_MIRROR = np.array([[-1, 0], [0, 1]], np.int32)
_LEAST_BIG = 4


@dataclass(frozen=True)
class Match:
    """Which point of the board each mark is, -1 for none; `reason` why no board was recognised."""

    index: Int32Array
    reason: str = ""
    mirrored: bool = False


def board_lattice(spec: BoardSpec) -> Int32Array:
    """Return the board's points (n, 2) as whole numbers of a square lattice."""
    place = spec.points_mm[:, :2] / spec.pitch_mm
    if spec.kind == "asymmetric-circles":  # rows half a pitch apart, shifted by half: a square lattice on its corner
        place = np.stack([place[:, 0] + place[:, 1], place[:, 1] - place[:, 0]], -1)
    lattice: Int32Array = np.rint(place - place[0]).astype(np.int32)
    return lattice


def match(lattice: Int32Array, known: Bools, big: Bools, spec: BoardSpec, px: Float64Array) -> Match:
    """Return which point of the board each known mark is.

    `lattice` (n, 2) and `known` (n,) come from the walk, `big` (n,) says which marks are large, `px` (n, 2) where
    they are: of turns that nothing tells apart, the one nearest to upright is taken.
    """
    none = np.full(len(lattice), -1, np.int32)
    if not known.any():
        return Match(none, "no marks that form a grid")
    straight = _best(lattice, known, big, spec, px)
    enough = _LEAST_BIG if spec.kind == "circles-five" else len(spec.points_mm)
    if spec.kind == "circles-five" or straight[0] < enough:
        flipped = _best(lattice @ _MIRROR, known, big, spec, px)
        if flipped[0] > straight[0] and flipped[0] >= enough:
            return Match(none, "the board is mirrored: the picture is flipped, or the board is seen in a mirror", True)
    if spec.kind == "circles-five":
        if straight[0] < enough:
            return Match(none, _few_big(big, known))
    elif straight[0] < enough:
        return Match(
            none,
            f"{int(straight[0])} of {len(spec.points_mm)} circles: a board without large circles has to be seen whole",
        )
    return Match(straight[1])


def _few_big(big: Bools, known: Bools) -> str:
    count = int((big & known).sum())
    return (
        f"{count} large circles among {int(known.sum())} of the grid do not make the five; at least {_LEAST_BIG} of "
        "them have to be seen, and the board has to be the one that is configured"
    )


def _best(lattice: Int32Array, known: Bools, big: Bools, spec: BoardSpec, px: Float64Array) -> tuple[float, Int32Array]:
    """Return the score and the points of the best turn and shift: large marks that fit, or marks that fit at all."""
    own = board_lattice(spec)
    table, low = _table(own)
    best: tuple[float, float, Int32Array] = (-1.0, 0.0, np.full(len(lattice), -1, np.int32))
    for turn in _TURNS:
        turned = lattice @ turn.T
        for shift in _shifts(turned[known], turned[known & big], own, spec):
            x, y = np.clip(turned + shift - low + 1, 0, np.array(table.shape) - 1).T
            index = np.where(known, table[x, y], np.int32(-1))
            score = _score(index, known, big, spec)
            upright = _upright(index, px, spec)
            if (score, upright) > best[:2]:
                best = (score, upright, index)
    return best[0], best[2]


def _table(own: Int32Array) -> tuple[Int32Array, Int32Array]:
    """Return which point lies at each place of the lattice, -1 for none and all around, and the lowest place."""
    low = own.min(axis=0)
    table = np.full(own.max(axis=0) - low + 3, -1, np.int32)
    table[tuple((own - low + 1).T)] = np.arange(len(own))
    return table, low


def _shifts(marks: Int32Array, large: Int32Array, own: Int32Array, spec: BoardSpec) -> list[Int32Array]:
    if spec.kind != "circles-five":
        return [own.min(axis=0) - marks.min(axis=0)]
    found = {tuple(int(v) for v in o - m) for m in large for o in own[spec.big]}
    return [np.array(shift, np.int32) for shift in sorted(found)]


def _score(index: Int32Array, known: Bools, big: Bools, spec: BoardSpec) -> float:
    inside = index >= 0
    if spec.kind != "circles-five":
        return float(inside.sum()) if inside.sum() == known.sum() else 0.0
    meant = spec.big[np.maximum(index, 0)] & inside
    return float((meant & big).sum() - (meant & ~big).sum() - (big & inside & ~meant).sum() - (known & ~inside).sum())


def _upright(index: Int32Array, px: Float64Array, spec: BoardSpec) -> float:
    """Return how much the board's x points to the right in the picture."""
    good = index >= 0
    if good.sum() < 3:
        return 0.0
    place = spec.points_mm[index[good], :2]
    place = place - place.mean(axis=0)
    seen = px[good] - px[good].mean(axis=0)
    along = place[:, 0] @ seen
    return float(along[0] / (np.linalg.norm(along) + 1e-12))
