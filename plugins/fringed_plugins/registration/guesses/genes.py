"""Guesses by a genetic algorithm: motions that breed, those with the most overlap more often.

Owns the population, its operators and its end. Deterministic by its generator.

References
----------
Brunnstrom, Stoddart: Genetic algorithms for free-form surface matching, ICPR 1996; Robertson, Fisher: Parallel
evolutionary registration of range data, CVIU 2002; Chow, Tsui, Lee: Surface registration using a dynamic genetic
algorithm, Pattern Recognition 2004 (genes, mutation that shrinks); Silva, Bellon, Boyer: Precision range image
registration using a robust surface interpenetration measure and enhanced genetic algorithms, PAMI 2005 (a robust
measure instead of a mean error, elite, diversity).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fringed_plugins.registration.guesses.common import (
    Guess,
    Thinned,
    agreeing,
    frames,
    net_overlaps,
    ranked,
    thinned,
    thinned_by,
)
from fringed_plugins.registration.guesses.pairs import facing
from fringed_plugins.registration.result import Report, silent
from fringed_plugins.registration.surface import Level
from fringed_plugins.registration.transforms import FloatArray

NAME = "genetic"
PORTION = 400  # founders between two reports
FOUNDING = 0.2  # of the work
WHOLE = 0.7  # of the children keep the place of their rotation


@dataclass(frozen=True)
class Genetic:
    """Population, generations, and how far a mutation turns (rad) and moves (parts of the radius) at first and last.

    `scored` model points give a motion its fitness; fewer make it a matter of luck. `tolerance` of the overlap, in
    sides of the thinned cubes, falls from the first to the last generation as well: a wide one has slopes to climb, a
    narrow one tells right from wrong. `newcomers` replace the worst of a generation.
    """

    points: int = 900
    scored: int = 250
    population: int = 240
    founders: int = 4000
    generations: int = 30
    elite: int = 24
    newcomers: int = 24
    mutation: tuple[float, float] = (0.3, 0.04)
    tolerance: tuple[float, float] = (1.0, 0.4)


def genetic(
    reference: Level,
    model: Level,
    options: Genetic | None,
    rng: np.random.Generator,
    threads: int,
    *,
    report: Report = silent,
) -> list[Guess]:
    """Return the distinct motions of `model` to `reference` of the last generation, most net overlap first.

    A gene is a rotation about the model's middle and where that goes. Founders bring a random model point to a random
    reference point, normals together: motions without any contact would waste generations.

    Parameters
    ----------
    reference, model
        levels of about 1,500 to 7,000 points.
    rng
        every random choice; the same state gives the same guesses.
    report
        hears every generation and may raise to stop.

    Returns
    -------
    list
        at most 20 guesses, their scores the net overlap (`common.net_overlaps`); empty where none is above 0.

    Raises
    ------
    ValueError
        a view without 50 points with normals, or with points that are not finite.

    References
    ----------
    Brunnstrom, Stoddart 1996; Robertson, Fisher 2002; Chow, Tsui, Lee 2004; Silva, Bellon, Boyer 2005.
    """
    how = options or Genetic()
    p = thinned(reference, how.points)
    q = thinned_by(model, p.side)
    some = rng.choice(len(q.points), min(how.scored, len(q.points)), replace=False)
    few = Thinned(q.points[some], q.normals[some], q.side)

    def fitness(T: FloatArray, part: float) -> FloatArray:
        return net_overlaps(reference, few, T, _between(how.tolerance, part) * p.side, threads)

    founded, scores = [], []
    for begin in range(0, how.founders, PORTION):
        report(FOUNDING * begin / how.founders, "genetic: founders")
        founded.append(_founders(p, q, min(PORTION, how.founders - begin), rng))
        scores.append(fitness(founded[-1], 0.0))
    T = np.concatenate(founded)[np.argsort(-np.concatenate(scores), kind="stable")[: how.population]]
    for generation in range(how.generations):
        part = generation / how.generations
        score = fitness(T, part)
        report(FOUNDING + (0.9 - FOUNDING) * part, f"genetic: generation {generation + 1}, overlap {score.max():.2f}")
        T = _next(T, score, (p, q), how, part, rng)
    report(0.9, "genetic: overlaps")
    best = _distinct(T, fitness(T, 1.0), q)
    return ranked(T[best], net_overlaps(reference, q, T[best], how.tolerance[1] * p.side, threads), NAME)


def _between(values: tuple[float, float], part: float) -> float:
    """Return what lies geometrically between the first and the last value."""
    return float(values[0] * (values[1] / values[0]) ** part)


def _next(
    T: FloatArray,
    score: FloatArray,
    views: tuple[Thinned, Thinned],
    how: Genetic,
    part: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the next generation: the best and the means of those alike, their children, and newcomers."""
    p, q = views
    best = T[np.argsort(-score, kind="stable")[: how.elite]]
    means, _ = agreeing(T, np.maximum(score, 0) + 1e-9, q, how.elite)
    elite = np.concatenate([best, means])
    born = how.population - len(elite) - how.newcomers
    gene = (*q.size(), _between(how.mutation, part))
    return np.concatenate([elite, children(T, score, born, gene, rng), _founders(p, q, how.newcomers, rng)])


def _founders(p: Thinned, q: Thinned, count: int, rng: np.random.Generator) -> FloatArray:
    i, j = rng.integers(len(p.points), size=count), rng.integers(len(q.points), size=count)
    turn = rng.uniform(0.0, 2 * np.pi, count)
    return facing(p.points[i], frames(p.normals[i]), q.points[j], frames(q.normals[j]), turn)


def children(
    T: FloatArray, score: FloatArray, count: int, gene: tuple[FloatArray, float, float], rng: np.random.Generator
) -> FloatArray:
    """Return children of parents that won a tournament of three, mutated.

    A child has the rotation of one parent and its place, or now and then the mean of both parents' places: a rotation
    with another one's place is rarely any good. `gene` is the model's middle, its radius, and the mutation's size.
    """
    middle, radius, size = gene
    drawn = rng.integers(len(T), size=(2, 3, count))
    parents = np.take_along_axis(drawn, score[drawn].argmax(axis=1)[:, None], axis=1)[:, 0]
    places = T[parents, :3, :3] @ middle + T[parents, :3, 3]
    whole = rng.random((count, 1)) < WHOLE
    place = np.where(whole, places[0], places.mean(0))
    wild = rng.standard_exponential((count, 1)) * size  # some far, most near
    turned = Rotation.from_rotvec(rng.normal(size=(count, 3)) * wild).as_matrix() @ T[parents[0], :3, :3]
    place = place + rng.normal(size=(count, 3)) * wild * radius
    out = np.tile(np.eye(4), (count, 1, 1))
    out[:, :3, :3] = turned
    out[:, :3, 3] = place - turned @ middle
    return out


def _distinct(T: FloatArray, score: FloatArray, model: Thinned) -> list[int]:
    """Return the indices of the best of every neighbourhood, best first."""
    middle, radius = model.size()
    place = T[:, :3, :3] @ middle + T[:, :3, 3]
    kept: list[int] = []
    for i in np.argsort(-score, kind="stable"):
        if score[i] <= 0 or len(kept) == 40:
            break
        near = np.linalg.norm(place[kept] - place[i], axis=1) < 0.2 * radius
        cosine = 0.5 * (np.einsum("kij,ij->k", T[kept, :3, :3], T[i, :3, :3]) - 1)
        if not (near & (cosine > np.cos(0.2))).any():
            kept.append(int(i))
    return kept
