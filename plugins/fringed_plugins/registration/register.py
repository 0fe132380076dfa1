"""One pair of views: from nothing known, or a given start, to a verified motion.

Owns the order coarse -> medium -> fine -> verification. Never returns an identity for bad input: what
cannot be meant raises, what did not succeed says `converged=False` and why.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from fringed_plugins.registration.coarse import Candidate, tournament
from fringed_plugins.registration.icp import Settings, iterate
from fringed_plugins.registration.matching import ClosestPoint
from fringed_plugins.registration.result import Alignment, Iteration, Report, silent
from fringed_plugins.registration.starts import principal_axes, turns
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, checked, translation
from fringed_plugins.registration.verify import Limits, Verdict, in_frame, verify

UNITS_RATIO = 20.0
GUESS_POINTS = 2500


@dataclass(frozen=True)
class Options:
    """How to register. `T_reference_model` (4, 4) is a start if known; otherwise guesses are tried."""

    T_reference_model: FloatArray | None = None
    medium_points: int = 6000
    fine_points: int = 25000
    medium: Settings = field(default_factory=lambda: Settings(iterations=40, still=3e-3, stage="medium"))
    fine: Settings = field(default_factory=lambda: Settings(iterations=40))
    limits: Limits = field(default_factory=Limits)
    threads: int = 1


def register(reference: Surface, model: Surface, options: Options | None = None, report: Report = silent) -> Alignment:
    """Return the motion of `model` to the frame of `reference`, verified.

    Parameters
    ----------
    reference, model
        prepared surfaces (`surface.prepare`).
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
    _require_same_units(reference, model)
    stage = _Stage(reference, model, options.medium, options.medium_points, options, report)
    best: _Reached | None = None
    for candidate in _candidates(reference, model, options, report):
        reached = stage.run(candidate.T_reference_model, ())
        if best is None or (not reached.verdict.fault, reached.verdict.overlap) > (False, best.verdict.overlap):
            best = reached
        if not reached.verdict.fault:
            break
        report(0.5, f"a guess was refuted: {reached.verdict.fault}")
    assert best is not None  # a tournament has a winner
    fine = replace(stage, settings=options.fine, points=options.fine_points)
    best = fine.run(best.T_reference_model, best.history)
    found = _alignment(reference, model, best)
    report(1.0, "registered" if found.converged else "not registered")
    return found


def _candidates(reference: Surface, model: Surface, options: Options, report: Report) -> list[Candidate]:
    between = model.origin - reference.origin
    if options.T_reference_model is not None:
        start = checked(options.T_reference_model)
        return [Candidate(translation(-reference.origin) @ start @ translation(model.origin), 0.0)]
    report(0.0, "first guesses")
    p, q = reference.level(GUESS_POINTS).points, model.level(GUESS_POINTS).points
    guesses = turns(p, q, between) + principal_axes(p, q)
    return tournament(reference, model, guesses, lambda part, text: report(0.4 * part, text), options.threads)


@dataclass(frozen=True)
class _Reached:
    """Where a stage ended: the motion between the surfaces' origins, what `verify` says, why it stopped."""

    T_reference_model: FloatArray
    verdict: Verdict
    stopped: str
    settled: bool
    history: tuple[Iteration, ...]


@dataclass(frozen=True)
class _Stage:
    """The loop and its verification on one level of both surfaces."""

    reference: Surface
    model: Surface
    settings: Settings
    points: int
    options: Options
    report: Report

    def run(self, T: FloatArray, before: tuple[Iteration, ...]) -> _Reached:
        p, q = self.reference.level(self.points), self.model.level(self.points)
        matcher = ClosestPoint(p, self.options.threads)
        outcome = iterate(p, q, T, matcher, self.settings, self._tell)
        self.report(0.9, f"{self.settings.stage}: verifying")
        diagonal = min(self.reference.diagonal_mm, self.model.diagonal_mm)
        verdict = verify(p, q, outcome.T_reference_model, self.options.limits, matcher, diagonal)
        history = before + outcome.history
        return _Reached(outcome.T_reference_model, verdict, outcome.stopped, outcome.settled, history)

    def _tell(self, made: Iteration) -> None:
        self.report(0.7, f"{made.stage}: {made.rms_mm:.4f} mm RMS over {made.pairs} pairs")


def _alignment(reference: Surface, model: Surface, reached: _Reached) -> Alignment:
    verdict = reached.verdict
    fault = verdict.fault or ("" if reached.settled else f"stopped after {reached.stopped}")
    covariance = None if verdict.covariance is None else in_frame(verdict.covariance, reference.origin)
    full = translation(reference.origin) @ reached.T_reference_model @ translation(-model.origin)
    reason = fault or reached.stopped
    return Alignment(full, not fault, reason, verdict.rms_mm, verdict.overlap, covariance, reached.history)


def _require_same_units(reference: Surface, model: Surface) -> None:
    extent = reference.diagonal_mm / model.diagonal_mm
    resolution = reference.spacing_mm / model.spacing_mm
    if min(extent, resolution) > UNITS_RATIO or max(extent, resolution) < 1 / UNITS_RATIO:
        raise ValueError(
            f"the {reference.name} spans {reference.diagonal_mm:.4g} mm at {reference.spacing_mm:.3g} mm a point, the "
            f"{model.name} {model.diagonal_mm:.4g} mm at {model.spacing_mm:.3g} mm: are they in different units? "
            "Bring both to millimetres"
        )
