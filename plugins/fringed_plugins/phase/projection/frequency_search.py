"""The search for sets of frequencies: which numbers of periods and steps are safe, and which of these are finest.

Owns the ways through the possible sets; what is safe is `frequency_errors`' affair.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
import numpy.typing as npt

from fringed_plugins.phase.projection import frequency_errors as errors

Float64Array = npt.NDArray[np.float64]
MIN_STEPS = 3
_WINDOW = 32
_HERMITE = {2: 1.0, 3: 2 / math.sqrt(3), 4: 2 ** (1 / 3)}  # densest lattices of 1, 2, 3 dimensions


@dataclass(frozen=True)
class Wanted:
    """What a design is for."""

    length_px: float
    frames: int
    snr: float
    min_period_px: float
    failure: float

    @property
    def most_periods(self) -> int:
        """The number of periods that the shortest one allows."""
        return int(self.length_px / self.min_period_px)


def _splits(frames: int, count: int) -> Iterator[tuple[int, ...]]:
    """Yield numbers of steps: any for the last frequency, the rest even, larger ones first or last."""
    if count == 1:
        yield (frames,)
        return
    for last in range(MIN_STEPS, frames - MIN_STEPS * (count - 1) + 1):
        each, more = divmod(frames - last, count - 1)
        even = [each + 1] * more + [each] * (count - 1 - more)
        for rest in {tuple(even), tuple(reversed(even))}:
            yield (*rest, last)


def hierarchical_sets(wanted: Wanted) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Yield the finest safe set (periods, steps) of each way to spend the frames."""
    chains = _Chains(wanted)
    for steps in _all_splits(wanted, 1):
        sigma = errors.phase_noise(steps, wanted.snr)
        levels = [(0.0, float(a), float(b)) for a, b in pairwise(sigma)]
        for chain in chains.best(levels):
            yield chain, steps


def heterodyne_sets(wanted: Wanted) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Yield the finest safe set (periods, steps) of each way to spend the frames, by beats with the finest."""
    chains = _Chains(wanted)
    for steps in _all_splits(wanted, 2):
        sigma = errors.phase_noise(steps, wanted.snr)
        beats = [*sigma[-2::-1], 0.0]  # the longest beat belongs to the frequency next to the finest
        levels = [(float(sigma[-1]), float(a), float(b)) for a, b in pairwise(beats)]
        for chain in chains.best(levels):
            yield (*(chain[-1] - n for n in chain[-2::-1]), chain[-1]), steps


def _all_splits(wanted: Wanted, fewest: int) -> Iterator[tuple[int, ...]]:
    most = min(wanted.frames // MIN_STEPS, 1 + int(math.log2(wanted.most_periods)))
    for count in range(fewest, most + 1):
        yield from _splits(wanted.frames, count)


class _Chains:
    """Chains of rising integers from 1 in which each step risks something: the longest one that is safe enough.

    Dynamic programming over the integers, exact for given steps; the risks of a level are computed once.
    """

    def __init__(self, wanted: Wanted) -> None:
        numbers = np.arange(1, wanted.most_periods + 1, dtype=np.float64)
        self._wanted = wanted
        self._ratio = numbers[None, :] / numbers[:, None]
        self._known: dict[tuple[float, float, float], Float64Array] = {}

    def best(self, levels: list[tuple[float, float, float]]) -> Iterator[tuple[int, ...]]:
        """Yield the chain with the largest end within the wanted failure, nothing where there is none.

        Each level is (noise common to both, noise of the coarse phase, noise of the fine phase) in rad.
        """
        risk = np.full(self._wanted.most_periods, np.inf)
        risk[0] = 0.0
        back = []
        for level in levels:
            through = risk[:, None] + self._risks(level)
            back.append(through.argmin(axis=0))
            risk = through.min(axis=0)
        safe = np.flatnonzero(risk <= self._wanted.failure)
        if not len(safe):
            return
        chain = [int(safe[-1])]
        for origin in reversed(back):
            chain.insert(0, int(origin[chain[0]]))
        yield tuple(n + 1 for n in chain)

    def _risks(self, level: tuple[float, float, float]) -> Float64Array:
        """Return the probability (most, most) that the row's number leads to a wrong order of the column's."""
        if level not in self._known:
            from scipy.special import erfc

            common, coarse, fine = level
            variance = ((self._ratio - 1) * common) ** 2 + (self._ratio * coarse) ** 2 + fine**2
            risks = erfc(np.pi / np.sqrt(2 * variance))
            self._known[level] = np.where(self._ratio > 1, risks, np.inf)
        return self._known[level]


def _sigmas(probability: float) -> float:
    """Return z with a Gaussian beyond +-z deviations that often."""
    from scipy.special import erfcinv

    return math.sqrt(2) * float(erfcinv(probability))


def lattice_set(wanted: Wanted, count: int) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Return the set of `count` frequencies with the most information among those that are safe, or None."""
    each, more = divmod(wanted.frames, count)
    steps = tuple([each] * (count - more) + [each + 1] * more)
    sigma = errors.phase_noise(steps, wanted.snr)
    weight = 1 / sigma**2
    best: Float64Array | None = None
    most = 0.0
    for finest in range(wanted.most_periods, count - 1, -1):
        if finest**2 * float(weight.sum()) <= most:
            break
        for block in _candidates(finest, weight, most, _largest_information(wanted, count, weight)):
            safe = errors.lattice_failures(block, sigma) <= wanted.failure
            if safe.any():
                best = block[int(np.argmax(safe))]
                most = float(best**2 @ weight)
                break
    return None if best is None else (tuple(int(n) for n in best), steps)


def _largest_information(wanted: Wanted, count: int, weight: Float64Array) -> float:
    """Return the largest sum of (n / sigma)^2 that the densest packing of turns allows."""
    need = 2 * _sigmas(2 * wanted.failure)
    cell = (need**2 / _HERMITE[count]) ** ((count - 1) / 2)
    volume = float(np.prod(2 * math.pi * np.sqrt(weight)))
    return float((volume / (2 * math.pi * cell)) ** 2)


def _candidates(finest: int, weight: Float64Array, most: float, limit: float) -> Iterator[Float64Array]:
    """Yield blocks of sets below `finest`, the most informative first, between the two bounds."""
    count = len(weight)
    lowest = max(1, finest - _WINDOW) if count > 3 else 1
    rest = np.array(list(combinations(range(lowest, finest), count - 1)), np.float64)
    if not len(rest):
        return
    sets = np.concatenate([rest, np.full((len(rest), 1), float(finest))], axis=1)
    information = sets**2 @ weight
    kept = (information > most) & (information <= limit)
    ordered = sets[kept][np.argsort(-information[kept], kind="stable")]
    for start in range(0, len(ordered), 256):
        yield ordered[start : start + 256]
