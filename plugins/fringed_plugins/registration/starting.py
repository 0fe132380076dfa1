"""Where a registration may start: as the views stand, or as told; then guesses, in the order of what they cost.

Owns that order and the points that guesses are made of. How a guess is made is in `invariant`, `starts` and
`guesses`; whether it is right is for `verify` to say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from fringed_plugins.registration.clouds import CloudSurface
from fringed_plugins.registration.coarse import ROUNDS, SHORT, Round, tournament
from fringed_plugins.registration.guesses import GUESSERS
from fringed_plugins.registration.invariant import Curved, curved, draw_near
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.scan import Scan
from fringed_plugins.registration.starts import principal_axes, turns
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray

GUESS_POINTS = 2500
COARSE_POINTS = 2500
COARSE_ITERATIONS = 25
TURNS = "turns"
ORDER = (("point-signatures", SHORT), ("oriented-pairs", SHORT), (TURNS, ROUNDS), ("spin-images", ROUNDS))
SEED = 20020507  # guesses by chance are the same ones for the same views

Guesses = Callable[[Scan, Scan], list[FloatArray]]


def starts(
    reference: Scan, model: Scan, first: FloatArray, search: str, threads: int, report: Report
) -> Iterator[FloatArray]:
    """Give `first`, then the guesses that a tournament leaves: those of `search`, or all in turn; "" for none.

    All are motions between the scans' origins.
    """
    yield first
    if not search:
        return
    if search != "auto":
        yield from _best(reference, model, _by_name(search, report, threads), report, threads)
        return
    report(0.1, "coarse: curvatures")
    try:
        pair = _curved(reference), _curved(model)
    except ValueError:  # too torn for whole windows; guesses need none
        pass
    else:
        yield draw_near(*pair, first, COARSE_ITERATIONS, lambda made: report(0.1, f"coarse: {made.pairs} pairs"))
    for number, (name, rounds) in enumerate(ORDER):
        report(0.2 + 0.05 * number, f"first guesses: {name}")
        guess = _by_turns if name == TURNS else _by_name(name, report, threads)
        try:
            yield from _best(reference, model, guess, report, threads, rounds)
        except ValueError:  # too few points for this one; verification judges what others find
            continue


def _best(
    reference: Scan, model: Scan, guess: Guesses, report: Report, threads: int, rounds: tuple[Round, ...] = ROUNDS
) -> Iterator[FloatArray]:
    found = guess(reference, model)
    if found:
        for one in tournament(reference, model, found, lambda _, text: report(0.3, text), threads, rounds):
            yield one.T_reference_model


def _by_name(name: str, report: Report, threads: int) -> Guesses:
    """Return one of the methods of the literature."""

    def found(reference: Scan, model: Scan) -> list[FloatArray]:
        levels = reference.level(GUESS_POINTS), model.level(GUESS_POINTS)
        rng = np.random.default_rng(SEED)
        made = GUESSERS[name](*levels, None, rng, threads, report=lambda _, text: report(0.2, text))
        return [one.T_reference_model for one in made]

    return found


def _curved(scan: Scan) -> Curved:
    if isinstance(scan, CloudSurface):
        return scan.curved(COARSE_POINTS)
    assert isinstance(scan, Surface)  # there are no other scans
    return curved(scan, COARSE_POINTS)


def _by_turns(reference: Scan, model: Scan) -> list[FloatArray]:
    """Return turns about the image's axes and the alignments of principal axes: what has no shapes, may have these."""
    p, q = reference.level(GUESS_POINTS).points, model.level(GUESS_POINTS).points
    return turns(p, q, model.origin - reference.origin) + principal_axes(p, q)
