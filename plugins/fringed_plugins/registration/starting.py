"""Where a registration may start: as the views stand, or as told; then guesses, in the order of what they cost.

Owns that order and the points that guesses are made of. How a guess is made is in `invariant`, `describing`, `starts`
and `guesses`; whether it is right is for `verify` to say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from fringed_plugins.registration.clouds import CloudSurface
from fringed_plugins.registration.coarse import ROUNDS, SHORT, Round, tournament
from fringed_plugins.registration.describing import Search, guesses
from fringed_plugins.registration.guesses import GUESSERS
from fringed_plugins.registration.invariant import Curved, curved, draw_near
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.starts import principal_axes, turns
from fringed_plugins.registration.surface import Scan, Surface
from fringed_plugins.registration.transforms import FloatArray

GUESS_POINTS = 2500
SHAPE_POINTS = 4000
MORE_POINTS = 6000
SHAPES = 12
COARSE_POINTS = 2500
COARSE_ITERATIONS = 25
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
    for number, (guess, rounds) in enumerate(((_by_shape, SHORT), (_by_axes, ROUNDS), (_by_shape_again, ROUNDS))):
        report(0.2 + 0.1 * number, "first guesses")
        yield from _best(reference, model, guess, report, threads, rounds)


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


def _by_shape(reference: Scan, model: Scan) -> list[FloatArray]:
    """Return what local shapes agree on, whatever the turn between the views."""
    return guesses(reference.level(SHAPE_POINTS), model.level(SHAPE_POINTS), SHAPES)


def _by_axes(reference: Scan, model: Scan) -> list[FloatArray]:
    """Return turns about the image's axes and the alignments of principal axes: what has no shapes, may have these."""
    p, q = reference.level(GUESS_POINTS).points, model.level(GUESS_POINTS).points
    return turns(p, q, model.origin - reference.origin) + principal_axes(p, q)


def _by_shape_again(reference: Scan, model: Scan) -> list[FloatArray]:
    """Return what local shapes agree on, more of them and of smaller surroundings."""
    levels = reference.level(MORE_POINTS), model.level(MORE_POINTS)
    return guesses(*levels, SHAPES, Search(radius=4.0, described=2500, correspondences=1500))
