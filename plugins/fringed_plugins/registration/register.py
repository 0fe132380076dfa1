"""One pair of views: from nothing known, or a given start, to a verified motion.

Owns the order coarse -> medium -> fine -> verification. Never returns an identity for bad input: what
cannot be meant raises, what did not succeed says `converged=False` and why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fringed_plugins.registration.clouds import CloudSurface
from fringed_plugins.registration.icp import Settings, iterate
from fringed_plugins.registration.matching import ClosestPoint
from fringed_plugins.registration.projective import refine
from fringed_plugins.registration.result import Alignment, Iteration, Report, silent
from fringed_plugins.registration.scan import Scan
from fringed_plugins.registration.starting import starts
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, checked, translation
from fringed_plugins.registration.verify import Limits, Verdict, in_frame, verify

UNITS_RATIO = 20.0
ONE_SIDED = 0.9
GUESS_POINTS = 2500
FEW_POINTS = 1800
FEW_ITERATIONS = 15
FEW_SLACK = 3.0  # few points miss the surface between them
EXACT = 1e-4  # of the resolution
FEW_STILL = 1e-2  # of the resolution: more points go on from there


@dataclass(frozen=True)
class Options:
    """How to register.

    `T_reference_model` (4, 4) is a start if one is known; where it is refuted, or none is given, guesses are tried:
    `search` names one method of `guesses.GUESSERS`, "auto" tries several in turn, "" none. `fine_points` is how many
    points the last stage takes to come near; it ends with all of them.
    """

    T_reference_model: FloatArray | None = None
    search: str = "auto"
    medium_points: int = 6000
    fine_points: int = 40000
    fine_iterations: int = 20
    medium: Settings = field(default_factory=lambda: Settings(iterations=40, still=3e-3, stage="medium"))
    limits: Limits = field(default_factory=Limits)
    threads: int = 1


def register(reference: Scan, model: Scan, options: Options | None = None, report: Report = silent) -> Alignment:
    """Return the motion of `model` to the frame of `reference`, verified.

    A few thousand points are aligned from where the views stand (or the given start). Where that is refuted, the
    best of many guesses is. All points are then brought foot to foot.

    Parameters
    ----------
    reference, model
        prepared surfaces (`surface.prepare`) or clouds (`clouds.prepare_cloud`), in any unit.
    options
        points, limits and a start.
    report
        hears (fraction, text) several times a second and may raise to stop the work.

    Raises
    ------
    ValueError
        surfaces of different units, or a start that is no rigid transform.
    """
    options = options or Options()
    require_same_units(reference, model)
    pairs = _sides(reference, model)
    if len(pairs) == 1 or not options.search:
        found = _first(pairs, options, report)
    else:  # as they stand from both sides first: inside out, a guess may fit what is not there
        found = _first(pairs, replace(options, search=""), report)
        found = found if found.converged else _first(pairs, options, report)
    report(1.0, "registered" if found.converged else "not registered")
    return found


def _first(pairs: Sequence[tuple[Scan, Scan]], options: Options, report: Report) -> Alignment:
    """Return the first alignment that converges, else that of the first pair."""
    best: Alignment | None = None
    for reference, model in pairs:
        found = _registered(reference, model, options, report)
        if found.converged:
            return found
        best = best or found
    assert best is not None  # there is a pair at least
    return best


def _sides(reference: Scan, model: Scan) -> list[tuple[Scan, Scan]]:
    """Return the pair, and with its other side outside where nobody knows which it is."""
    for scan in (model, reference):
        if isinstance(scan, CloudSurface) and not scan.sided:
            other = scan.flipped()
            return [(reference, model), (reference, other) if scan is model else (other, model)]
    return [(reference, model)]


def _registered(reference: Scan, model: Scan, options: Options, report: Report) -> Alignment:
    medium = _Medium(reference, model, options, report)
    best: _Reached | None = None
    start = translation(model.origin - reference.origin)
    if options.T_reference_model is not None:
        start = translation(-reference.origin) @ checked(options.T_reference_model) @ translation(model.origin)
    for guess in starts(reference, model, start, options.search, options.threads, report):
        reached = medium.run(guess)
        if best is None or (not reached.verdict.fault, reached.verdict.overlap) > (False, best.verdict.overlap):
            best = reached
        if not reached.verdict.fault:
            break
        report(0.5, f"a guess was refuted: {reached.verdict.fault}")
    assert best is not None  # there is a start at least
    return _alignment(reference, model, medium.refined(best))


@dataclass(frozen=True)
class _Reached:
    """Where a stage ended: the motion between the surfaces' origins, what `verify` says, why it stopped."""

    T_reference_model: FloatArray
    verdict: Verdict
    stopped: str
    settled: bool
    history: tuple[Iteration, ...]


@dataclass(frozen=True)
class _Medium:
    """The loop and its verification on one level of both surfaces, and the last stage on all points."""

    reference: Scan
    model: Scan
    options: Options
    report: Report

    def run(self, T: FloatArray) -> _Reached:
        """Return where a start leads: on few points at first, on more of them unless those refute it."""
        wish = self.options
        few = replace(wish.medium, iterations=min(FEW_ITERATIONS, wish.medium.iterations), still=FEW_STILL)
        loose = replace(wish.limits, slack=FEW_SLACK)
        reached = self._on(min(FEW_POINTS, wish.medium_points), T, few, loose)
        if reached.verdict.fault and wish.medium_points > FEW_POINTS:
            return reached
        more = self._on(wish.medium_points, reached.T_reference_model, wish.medium, wish.limits)
        return replace(more, history=reached.history + more.history)

    def _on(self, points: int, T: FloatArray, settings: Settings, limits: Limits) -> _Reached:
        p, q = self.reference.level(points), self.model.level(points)
        outcome = iterate(p, q, T, ClosestPoint(p, self.options.threads), settings, self._tell)
        self.report(0.8, "medium: verifying")
        verdict = self._verdict(outcome.T_reference_model, points, limits)
        return _Reached(outcome.T_reference_model, verdict, outcome.stopped, outcome.settled, outcome.history)

    def refined(self, reached: _Reached) -> _Reached:
        """Return what all points make of it; what was refuted, or is not held on all sides, stays as it is."""
        if reached.verdict.fault:
            return reached
        wish = self.options
        if not (isinstance(self.reference, Surface) and isinstance(self.model, Surface)):
            self.report(0.85, "fine: closest points")
            closest = replace(wish.medium, iterations=wish.fine_iterations, still=EXACT, stage="fine")
            dense = self._on(wish.fine_points, reached.T_reference_model, closest, wish.limits)
            return replace(dense, history=reached.history + dense.history)
        self.report(0.85, "fine: patches")
        fixed = self.reference.sharp
        self.report(0.9, "fine: patches")
        moving = self.model.sharp
        start = reached.T_reference_model
        fine = refine(fixed, moving, start, self._tell, wish.fine_points, wish.fine_iterations)
        history = reached.history + fine.history
        if not fine.settled:
            return replace(reached, settled=False, stopped=fine.stopped, history=history)
        verdict = self._verdict(fine.T_reference_model, wish.medium_points, wish.limits)
        if not verdict.fault:
            verdict = replace(verdict, covariance=fine.covariance)
        return _Reached(fine.T_reference_model, verdict, fine.stopped, True, history)

    def _verdict(self, T: FloatArray, points: int, limits: Limits) -> Verdict:
        p, q = self.reference.level(points), self.model.level(points)
        diagonal = min(self.reference.diagonal_mm, self.model.diagonal_mm)
        return verify(p, q, T, limits, ClosestPoint(p, self.options.threads), diagonal)

    def _tell(self, made: Iteration) -> None:
        self.report(0.7, f"{made.stage}: {made.rms_mm:.4g} RMS over {made.pairs} pairs")


def _alignment(reference: Scan, model: Scan, reached: _Reached) -> Alignment:
    verdict = reached.verdict
    fault = verdict.fault or ("" if reached.settled else f"stopped after {reached.stopped}")
    covariance = None if verdict.covariance is None else in_frame(verdict.covariance, reference.origin)
    full = translation(reference.origin) @ reached.T_reference_model @ translation(-model.origin)
    reason = fault or reached.stopped
    if fault and isinstance(reference, Surface) and isinstance(model, Surface):
        reason += _mirrored(reference, model)
    return Alignment(full, not fault, reason, verdict.rms_mm, verdict.overlap, covariance, reached.history)


def _mirrored(reference: Surface, model: Surface) -> str:
    """Return what to say where one view's normals face the sensor and the other's face away from it."""
    sides = []
    for surface in (reference, model):
        points, normals, _ = surface.level(GUESS_POINTS).inner()
        sides.append(float(np.sign(np.einsum("ij,ij->i", points + surface.origin, normals)).mean()))
    if min(map(abs, sides)) < ONE_SIDED or sides[0] * sides[1] > 0:
        return ""
    away = max((reference, model), key=lambda surface: sides[0] if surface is reference else sides[1])
    return (
        f"; the normals of the {away.name} face away from the sensor: it is mirrored, or its rows run upwards or its "
        "columns to the left"
    )


def require_same_units(reference: Scan, model: Scan) -> None:
    """Raise ValueError where extent or resolution say that the surfaces are in different units."""
    extent = reference.diagonal_mm / model.diagonal_mm
    resolution = reference.spacing_mm / model.spacing_mm
    if min(extent, resolution) > UNITS_RATIO or max(extent, resolution) < 1 / UNITS_RATIO:
        raise ValueError(
            f"the {reference.name} spans {reference.diagonal_mm:.4g} at {reference.spacing_mm:.3g} a point, the "
            f"{model.name} {model.diagonal_mm:.4g} at {model.spacing_mm:.3g}: are they in different units? "
            "Bring both to one"
        )
