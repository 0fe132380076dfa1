"""One pair of views by a method of the literature, judged as the default method is.

Owns the start, the levels from coarse to fine, and the verdict; the loop is `method`'s.
"""

from __future__ import annotations

import numpy as np

from fringed_plugins.registration.clouds import CloudSurface, without_grid
from fringed_plugins.registration.family.frames import Frame, frame_of, frame_of_cloud
from fringed_plugins.registration.family.method import Method, Outcome, align
from fringed_plugins.registration.matching import ClosestPoint
from fringed_plugins.registration.register import Options, require_same_units
from fringed_plugins.registration.result import Alignment, Iteration, Report, silent
from fringed_plugins.registration.scan import Scan
from fringed_plugins.registration.starts import principal_axes
from fringed_plugins.registration.surface import Surface
from fringed_plugins.registration.transforms import FloatArray, apply, checked, translation
from fringed_plugins.registration.verify import Verdict, in_frame, still_to_go, verify

TRIM = 0.5  # of the points, the nearer ones, by whose distance a start is judged
JUDGED_BY = 500
RIGID = 1e-3
OFF = 0.1  # of the resolution: how far a method's own least error may stand from where the surfaces meet


def register_by(
    method: Method,
    reference: Scan,
    model: Scan,
    options: Options | None = None,
    iterations: int | None = None,
    report: Report = silent,
) -> Alignment:
    """Return the motion of `model` to the frame of `reference` by one method, verified like any other.

    The start is `options.T_reference_model`, or what the method says: as the views stand, or the best of the four
    alignments of principal axes and that.

    Raises
    ------
    ValueError
        surfaces of different units, a start that is no rigid transform, a grid too torn for the method.
    """
    options = options or Options()
    require_same_units(reference, model)
    reference, model = _alike(reference, model, options.threads)
    T = _start(method, reference, model, options)
    history: list[Iteration] = []
    outcome: Outcome | None = None
    for number, most in enumerate(method.levels):
        report(0.05 + 0.8 * number / len(method.levels), f"{method.name}: preparing level {number + 1}")
        fixed, moving = _frame(reference, most), _frame(model, most)

        def tell(part: float, text: str, number: int = number) -> None:
            report(0.05 + 0.8 * (number + part) / len(method.levels), text)

        outcome = align(method, fixed, moving, T, iterations=iterations, threads=options.threads, report=tell)
        T = outcome.T_reference_model
        history.extend(outcome.history)
    assert outcome is not None  # a method has a level
    report(0.9, "verifying")
    found = _judged(reference, model, outcome, options, tuple(history))
    report(1.0, "registered" if found.converged else "not registered")
    return found


def _frame(scan: Scan, most: int | None) -> Frame:
    if isinstance(scan, CloudSurface):
        return frame_of_cloud(scan, most)
    assert isinstance(scan, Surface)  # there are no other scans
    return frame_of(scan, most)


def _alike(reference: Scan, model: Scan, threads: int) -> tuple[Scan, Scan]:
    """Return both as clouds where one of them is none: features compare within a kind only."""
    if isinstance(reference, Surface) and isinstance(model, Surface):
        return reference, model
    fixed, moving = (without_grid(one, threads) if isinstance(one, Surface) else one for one in (reference, model))
    return fixed, moving


def _start(method: Method, reference: Scan, model: Scan, options: Options) -> FloatArray:
    """Return the motion between origins that the method starts from."""
    if options.T_reference_model is not None:
        return translation(-reference.origin) @ checked(options.T_reference_model) @ translation(model.origin)
    as_is = translation(model.origin - reference.origin)
    if method.start == "as-is":
        return as_is
    p, q = reference.level(options.medium_points), model.level(options.medium_points)
    few = q.points[:: max(1, len(q.points) // JUDGED_BY)]

    def trimmed(T: FloatArray) -> float:
        distance = np.sort(p.tree.query(apply(T, few))[0])
        return float((distance[: max(1, int(TRIM * len(distance)))] ** 2).mean())

    return min([*principal_axes(p.points, q.points), as_is], key=trimmed)


def _judged(
    reference: Scan, model: Scan, outcome: Outcome, options: Options, history: tuple[Iteration, ...]
) -> Alignment:
    """Return the alignment with the verdict on a level of both surfaces."""
    p, q = reference.level(options.medium_points), model.level(options.medium_points)
    T = outcome.T_reference_model
    scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
    full = translation(reference.origin) @ T @ translation(-model.origin)
    if abs(scale - 1) > RIGID:
        reason = f"the model is {scale:.4g} times as large as the reference: no rigid motion brings them together"
        return Alignment(full, False, reason, float("nan"), 0.0, None, history)
    diagonal = min(reference.diagonal_mm, model.diagonal_mm)
    verdict: Verdict = verify(p, q, T, options.limits, ClosestPoint(p, options.threads), diagonal)
    fault = verdict.fault or ("" if outcome.settled else f"stopped after {outcome.stopped}")
    off = still_to_go(p, q, T, ClosestPoint(p, options.threads))
    if not fault and off > OFF * max(reference.spacing_mm, model.spacing_mm):
        fault = f"{outcome.stopped}, but the surfaces meet {off:.2g} from there"
    covariance = None if verdict.covariance is None else in_frame(verdict.covariance, reference.origin)
    return Alignment(full, not fault, fault or outcome.stopped, verdict.rms_mm, verdict.overlap, covariance, history)
