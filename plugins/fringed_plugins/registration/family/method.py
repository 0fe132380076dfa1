"""The loop that all iterative closest point methods share, and what one of them is made of.

Owns the order describe -> select -> match -> reject -> weigh -> minimise -> accelerate -> stop, and the history.
Knows no policy by name; `presets` does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fringed_plugins.registration.family.acceleration import Acceleration, Memory, Plain
from fringed_plugins.registration.family.describing import AsGiven, Describing
from fringed_plugins.registration.family.frames import Frame, Index
from fringed_plugins.registration.family.matching import Closest, Finder, Matching, Query
from fringed_plugins.registration.family.minimising import Minimising, PointToPoint
from fringed_plugins.registration.family.rejection import Pairs, Rejection
from fringed_plugins.registration.family.selection import Everything, Selection
from fringed_plugins.registration.family.weighting import Alike, Weighting
from fringed_plugins.registration.result import Iteration, Report, silent
from fringed_plugins.registration.transforms import FloatArray, apply, orthonormal, rotation_angle, translation, turned

LEAST_PAIRS = 6
WORSE = 1.02  # an accelerated step may raise the error by this factor before it is taken back
_GAIN = 1e-3
_NO_ERROR = 1e-14  # of the extent squared: rounding


@dataclass(frozen=True)
class Stop:
    """When the loop ends: most iterations; change of the RMS, relative; motion, in resolutions.

    Pairs that change for ever keep an error from settling: it has settled too when `patience` iterations have not
    made it less by a thousandth.
    """

    iterations: int = 100
    change: float = 1e-6
    still: float = 1e-5
    patience: int = 10


@dataclass(frozen=True)
class Method:
    """One iterative closest point method: its policies, and where it comes from.

    `levels` are the most points of the frames from coarse to fine, None all; `start` is "as-is" or "principal-axes".
    """

    name: str
    title: str
    source: str
    describe: Describing = field(default_factory=AsGiven)
    select: Selection = field(default_factory=Everything)
    match: Matching = field(default_factory=Closest)
    reject: tuple[Rejection, ...] = ()
    weigh: Weighting = field(default_factory=Alike)
    minimise: Minimising = field(default_factory=PointToPoint)
    accelerate: Acceleration = field(default_factory=Plain)
    stop: Stop = field(default_factory=Stop)
    levels: tuple[int | None, ...] = (None,)
    start: str = "as-is"


@dataclass(frozen=True)
class Outcome:
    """Where a method ended: the motion between the frames' origins, why it stopped, and every iterate.

    `T_reference_model` is a similarity where the method estimates scale. `poses` (n, 4, 4) belong to `history`.
    """

    T_reference_model: FloatArray
    settled: bool
    stopped: str
    history: tuple[Iteration, ...]
    poses: FloatArray

    def between(self, reference: Frame, model: Frame) -> FloatArray:
        """Return the motion between the frames' own coordinates."""
        return translation(reference.origin) @ self.T_reference_model @ translation(-model.origin)


@dataclass(frozen=True)
class _Run:
    """What does not change while the loop runs."""

    method: Method
    reference: Frame
    model: Frame
    finder: Finder
    rng: np.random.Generator

    def pairs(self, T: FloatArray, chosen: Index, alpha: float) -> tuple[Pairs, float]:
        """Return what is left of the pairs at a pose, and the last limit of their distance."""
        reference, model = self.reference, self.model
        scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
        moved, normals = apply(T, model.points[chosen]), turned(T[:3, :3] / scale, model.normals[chosen])
        index = self.finder(Query(moved, normals, model.features[chosen], alpha))
        met = index >= 0
        rim = reference.rim if self.method.match.by_features else reference.boundary
        variance = _along(reference, index, reference.normals[index]) + _along(model, chosen, model.normals[chosen])
        pairs = Pairs(
            moved, reference.points[index], normals, reference.normals[index], index, chosen, rim[index], variance,
            max(reference.resolution, 1e-300),
        )  # fmt: skip
        pairs, limit = pairs.at(met), float("inf")
        for rejection in self.method.reject:
            if not len(pairs):
                break
            keep, within = rejection(pairs, self.rng)
            pairs, limit = pairs.at(keep), min(limit, within)
        return pairs, limit


def _along(frame: Frame, index: Index, normals: FloatArray) -> FloatArray:
    """Return the variance of points along their normals, along the ray where there is none."""
    cosine = np.einsum("ij,ij->i", frame.rays[index], normals)
    cosine = np.where(cosine == 0, 1.0, cosine)
    variance: FloatArray = (frame.sigma[index] * cosine) ** 2
    return variance


def align(
    method: Method,
    reference: Frame,
    model: Frame,
    T: FloatArray | None = None,
    *,
    iterations: int | None = None,
    seed: int = 0,
    threads: int = 1,
    report: Report = silent,
) -> Outcome:
    """Return where a method brings the model, from `T` (4, 4) between the frames' origins on.

    Parameters
    ----------
    method
        what it is made of; `presets.METHODS` has those of the literature.
    T
        the start; None leaves the frames where their coordinates put them.
    iterations
        overrides the method's most iterations.
    seed
        of whatever the method does at random.
    report
        hears of every iteration and may raise to stop.

    Raises
    ------
    ValueError
        the method needs what the frames lack (a grid, features, complete neighbourhoods).
    """
    reference, model = method.describe(reference, model, threads, report)
    _check(method, reference, model)
    T = translation(model.origin - reference.origin) if T is None else np.array(T, np.float64)
    run = _Run(method, reference, model, method.match.prepare(reference, threads), np.random.default_rng(seed))
    loop = _Loop(run, method.accelerate.begin(reference.extent), report, T)
    return loop.until(iterations or method.stop.iterations, _first_alpha(run, T))


def _check(method: Method, reference: Frame, model: Frame) -> None:
    if method.match.by_features and not (reference.whole.any() and model.whole.any()):
        raise ValueError(f"{method.name} compares invariants; neither frame may be without any whole window")
    if method.match.by_features and reference.features.shape[1] != model.features.shape[1]:
        raise ValueError(
            f"the frames have {reference.features.shape[1]} and {model.features.shape[1]} invariants a point; give "
            "both the same ones"
        )


def _first_alpha(run: _Run, T: FloatArray) -> float:
    """Return the first weight of invariants: the error of closest points stands for that of the pose."""
    if not run.method.match.by_features:
        return 0.0
    chosen = run.method.select(run.model, run.rng)
    distance = run.reference.tree.query(apply(T, run.model.points[chosen]))[0]
    return float(np.sqrt((distance**2).mean() / 3))


@dataclass
class _Loop:
    """The loop's state: the pose, the last error, what has been recorded."""

    run: _Run
    memory: Memory
    report: Report
    T: FloatArray
    history: list[Iteration] = field(default_factory=list)
    poses: list[FloatArray] = field(default_factory=list)

    def until(self, iterations: int, alpha: float) -> Outcome:
        """Iterate to the end."""
        stop, run = self.run.method.stop, self.run
        chosen = run.method.select(run.model, run.rng)
        last, plain = float("inf"), self.T
        stopped, settled = f"{iterations} iterations without standing still", False
        for number in range(iterations):
            if run.method.select.anew and number:
                chosen = run.method.select(run.model, run.rng)
            pairs, limit = run.pairs(self.T, chosen, alpha)
            try:
                after, error = self._moved(pairs)
            except ValueError as problem:
                stopped = str(problem)
                break
            if error > WORSE * last and plain is not self.T:
                self.T, last = plain, float("inf")
                self.memory.forget()
                continue
            went = self._record(pairs, limit, alpha, after, error)
            self.report(min(0.99, number / iterations), f"{run.method.name}: {error:.4g} RMS of {len(pairs)} pairs")
            if run.method.match.by_features:
                alpha = min(alpha, float(np.sqrt(error**2 / 3)))  # features that mislead must not gain weight by it
            plain, before = after, self.T
            self.T = self.memory(before, after, error)
            lately = [made.rms_mm for made in self.history[-stop.patience :]]
            earlier = min((made.rms_mm for made in self.history[: -stop.patience]), default=float("inf"))
            steady = abs(last - error) <= stop.change * error and not run.method.select.anew
            steady |= min(lately) > (1 - _GAIN) * earlier
            if error**2 < _NO_ERROR * run.reference.extent**2 or steady or went < stop.still * pairs.resolution:
                self.T, settled = after, True
                stopped = "the error no longer changed" if steady else "the motion stood still"
                break
            last = error
        else:
            self.T = plain
        return Outcome(self.T, settled, stopped, tuple(self.history), np.array(self.poses).reshape(-1, 4, 4))

    def _moved(self, pairs: Pairs) -> tuple[FloatArray, float]:
        """Return the pose after the pairs' motion, and the RMS distance that is left of them."""
        if len(pairs) < LEAST_PAIRS:
            raise ValueError(f"{len(pairs)} pairs are left; a motion needs {LEAST_PAIRS}")
        small = self.run.method.minimise(pairs, self.run.method.weigh(pairs))
        after = small @ self.T
        if abs(np.linalg.det(after[:3, :3]) - 1) < 1e-6:
            after = orthonormal(after)
        left = apply(small, pairs.model) - pairs.reference
        return after, float(np.sqrt((left**2).sum(1).mean()))

    def _record(self, pairs: Pairs, limit: float, alpha: float, after: FloatArray, error: float) -> float:
        """Write down an iteration and return how far it moved the points."""
        small = after @ np.linalg.inv(self.T)
        middle = pairs.model.mean(0)
        shift = float(np.linalg.norm(apply(small, middle) - middle))
        angle = rotation_angle(small)
        threshold = limit if np.isfinite(limit) else float(pairs.distance.max())
        self.history.append(Iteration(error, len(pairs), threshold, angle, shift, self.run.method.name, alpha))
        self.poses.append(after)
        return shift + angle * self.run.reference.extent
