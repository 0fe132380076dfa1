"""Guesses by votes of pairs of oriented points: which point of the reference this is, and turned by how much.

Owns the method; its arithmetic is in `pair_kernels`. Two oriented points say where the other view stands, up to the
four numbers that both have to share: their distance and three angles. All pairs of the reference lie in a table by
those numbers; pairs of the model look themselves up and vote. Needs no descriptor and no salient point: a smooth relief
as a whole decides.

References
----------
Drost, Ulrich, Navab, Ilic: Model globally, match locally: efficient and robust 3D object recognition, CVPR 2010.
Changed: a pair's one vote is shared by all that look alike, which does for common pairs what weights by rarity do for
words (Sparck Jones 1972); motions are ranked by votes times overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringed_plugins.registration.guesses.common import (
    Guess,
    Thinned,
    agreeing,
    frames,
    overlaps,
    ranked,
    thinned,
    thinned_by,
)
from fringed_plugins.registration.guesses.pair_kernels import tabulate, vote
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray

NAME = "oriented-pairs"
MOST_STEPS = 100  # of distance
PORTION = 20  # of the chosen points between two reports


@dataclass(frozen=True)
class PairVoting:
    """How many points take part, and how finely pairs are told apart.

    `partners` are model points that each of the `chosen` ones makes pairs with; a cell of the table with more than
    `common` pairs says nothing; `tolerance` of the overlap is in sides of the thinned reference's cubes.
    """

    reference_points: int = 900
    partners: int = 450
    chosen: int = 200
    angle_deg: float = 10.0
    turns: int = 36
    peaks: int = 3
    common: int = 600
    motions: int = 40
    tolerance: float = 1.5


def oriented_pairs(
    reference: Level,
    model: Level,
    options: PairVoting | None,
    rng: np.random.Generator,
    threads: int,
    *,
    report: Report = silent,
) -> list[Guess]:
    """Return the motions of `model` to `reference` that most pairs of oriented points vote for, best first.

    Parameters
    ----------
    reference, model
        levels of about 1,500 to 7,000 points; of them `options.reference_points` and fewer take part.
    rng
        chooses nothing here: the method is deterministic.

    Returns
    -------
    list
        at most 20 guesses, their scores votes times overlap; empty where no pair is distinct (a sphere). What slides on
        itself (a plane) may give guesses that lay it on itself: it is for a verification to refuse them.

    References
    ----------
    Drost, Ulrich, Navab, Ilic, CVPR 2010.
    """
    how = options or PairVoting()
    p = thinned(reference, how.reference_points)
    q = thinned_by(model, p.side * float(np.sqrt(how.reference_points / how.partners)))
    T, votes = _voted(p, q, how, report)
    T, votes = agreeing(T, votes, q, how.motions)
    if not len(T):
        return []
    report(0.9, "pairs: overlaps")
    overlap = overlaps(reference, thinned_by(model, p.side), T, how.tolerance * p.side, threads)
    return ranked(T, votes * overlap, NAME)


def _voted(p: Thinned, q: Thinned, how: PairVoting, report: Report) -> tuple[FloatArray, FloatArray]:
    """Return the motions (k, 4, 4) of the chosen points' best votes, and the votes (k,)."""
    report(0.0, "pairs: the reference's")
    far = min(p.extent(), q.extent())
    steps = (max(p.side, far / MOST_STEPS), float(np.radians(how.angle_deg)))
    counts = (int(far / steps[0]) + 1, int(np.pi / steps[1]) + 1)
    on_p, on_q = frames(p.normals), frames(q.normals)
    table = tabulate(p.points, p.normals, on_p, steps, counts)
    chosen = np.unique(np.linspace(0, len(q.points) - 1, how.chosen).round().astype(np.int64))
    size, found = (len(p.points), how.turns, how.peaks, how.common), []
    for begin in range(0, len(chosen), PORTION):
        report(0.3 + 0.6 * begin / len(chosen), "pairs: votes")
        some = chosen[begin : begin + PORTION]
        found.append(vote((q.points, q.normals, on_q), some, table, steps, counts, size))
    peaks = np.concatenate(found).reshape(-1, 3)
    at_p, at_q = peaks[:, 0].astype(np.intp), np.repeat(chosen, how.peaks)
    return facing(p.points[at_p], on_p[at_p], q.points[at_q], on_q[at_q], peaks[:, 1]), peaks[:, 2]


def facing(p: FloatArray, on_p: FloatArray, q: FloatArray, on_q: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """Return the motions (k, 4, 4) that bring points q with their frames to points p, turned about the normals.

    `p`, `q` (k, 3); `on_p`, `on_q` (k, 3, 3) rows u, v, normal; `turn_rad` (k,).
    """
    about = np.zeros((len(turn_rad), 3, 3))
    about[:, 0, 0] = about[:, 1, 1] = np.cos(turn_rad)
    about[:, 1, 0] = np.sin(turn_rad)
    about[:, 0, 1] = -about[:, 1, 0]
    about[:, 2, 2] = 1.0
    T = np.tile(np.eye(4), (len(turn_rad), 1, 1))
    T[:, :3, :3] = np.swapaxes(on_p, 1, 2) @ about @ on_q
    T[:, :3, 3] = p - np.einsum("kij,kj->ki", T[:, :3, :3], q)
    return T
