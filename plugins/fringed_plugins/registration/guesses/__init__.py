"""Motions between two views that nobody has told anything about: one module for each method.

    pairs        votes of pairs of oriented points, whatever the turn
    features     local feature histograms (FPFH) and correspondences that agree
    spin         spin images and geometric consistency
    signatures   point signatures: heights around a circle; the fastest
    darces       RANSAC-DARCES: random triangles, found again exhaustively
    genes        a genetic algorithm
    axes         principal axes with their four signs

    consistent   groups of correspondences that one motion can have made
    common       what they share: evenly thinned points, motions that agree, the overlap that a motion makes

Each is `method(reference, model, options, rng, threads, report=...) -> list[Guess]`, best first, empty where nothing
agrees. `reference` and `model` are levels; `options` is the method's own dataclass or None. `report` hears (fraction,
text) and may raise to stop the work. Which are tried, and in what order, is in `starting`; whether a guess is
right is for a tournament and a verification to say. Knows
nothing of files, devices or fine registration.
"""

from __future__ import annotations

from collections.abc import Callable

from fringed_plugins.registration.guesses.axes import NAME as AXES
from fringed_plugins.registration.guesses.axes import principal_axes
from fringed_plugins.registration.guesses.common import Guess
from fringed_plugins.registration.guesses.darces import NAME as DARCES
from fringed_plugins.registration.guesses.darces import ransac_darces
from fringed_plugins.registration.guesses.features import NAME as FEATURES
from fringed_plugins.registration.guesses.features import local_features
from fringed_plugins.registration.guesses.genes import NAME as GENES
from fringed_plugins.registration.guesses.genes import genetic
from fringed_plugins.registration.guesses.pairs import NAME as PAIRS
from fringed_plugins.registration.guesses.pairs import oriented_pairs
from fringed_plugins.registration.guesses.signatures import NAME as SIGNATURES
from fringed_plugins.registration.guesses.signatures import point_signatures
from fringed_plugins.registration.guesses.spin import NAME as SPIN
from fringed_plugins.registration.guesses.spin import spin_images

Guesser = Callable[..., list[Guess]]

GUESSERS: dict[str, Guesser] = {
    PAIRS: oriented_pairs,
    FEATURES: local_features,
    SPIN: spin_images,
    SIGNATURES: point_signatures,
    DARCES: ransac_darces,
    GENES: genetic,
    AXES: principal_axes,
}
