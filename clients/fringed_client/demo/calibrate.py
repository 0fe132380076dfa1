"""The demonstration's first act: the simulated rig is calibrated from images, and scored against what it really is.

Owns the figures against the truth; the exact calibration serves for nothing else.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fringed.data import BoardView, Calibration
from fringed_client.calibration.figures import baseline_mm, sigmas
from fringed_client.calibration.poses import plan
from fringed_client.calibration.report import write_report
from fringed_client.calibration.session import Session, Wish
from fringed_client.calibration.tables import baseline_sigma
from fringed_client.calibration.taking import Progress, simulated_poses, simulated_ramp
from fringed_client.calibration_file import calibration_of

if TYPE_CHECKING:
    from fringed_client.station import Station


def calibrate(station: Station, folder: Path, progress: Progress) -> dict[str, Any]:
    """Take the poses, estimate, put the result in force, and return its figures; the report lies in `folder` then.

    Raises
    ------
    FringedError
        a pose or the estimation failed.
    """
    began = time.perf_counter()
    exact = calibration_of(station)
    session = Session(station, Wish())
    views: list[BoardView] = list(simulated_poses(session, plan(), progress))
    taken_s = time.perf_counter() - began
    good = [view for view in views if view.found]
    found, warnings = session.solve(good, progress.scan("calibration"))
    # Without the projector's tone curve, dark parts of an object fit no sinusoid: it is measured on a plain surface.
    found, more = session.with_tone(found, simulated_ramp(session, progress), progress.scan("tone curve"))
    solved_s = time.perf_counter() - began
    station.request("calibration.use", timeout_s=60.0, id=found.id)
    report = write_report(station, found, views, folder)[0]
    return {
        "id": found.id, "hash": found.hash, "poses": len(views), "found": len(good), "warnings": [*warnings, *more],
        "residuals": dict(found.residuals), "parameters": parameter_errors(found, exact),
        "against_truth": _displacement(station, found, exact), "report": str(report.relative_to(folder.parent)),
        "seconds": {"poses": taken_s, "estimation": solved_s - taken_s, "all": time.perf_counter() - began},
    }  # fmt: skip


def parameter_errors(found: Calibration, exact: Calibration) -> list[dict[str, Any]]:
    """Return name, true value, error, and error over the own standard deviation, of what is scored."""
    known = sigmas(found)
    rows = []
    for name in ("camera", "projector"):
        one, true = (getattr(of, name).matrix for of in (found, exact))
        for key, place in (("fx", (0, 0)), ("fy", (1, 1)), ("cx", (0, 2)), ("cy", (1, 2))):
            error = float(one[place] - true[place])
            rows.append(_error(f"{name} {key}", float(true[place]), error, known.get(f"{name}.{key}")))
    true_mm = baseline_mm(exact)
    rows.append(_error("baseline / mm", true_mm, baseline_mm(found) - true_mm, baseline_sigma(found)))
    return rows


def _error(name: str, true: float, error: float, sigma: float | None) -> dict[str, Any]:
    own = error / sigma if sigma else float("nan")
    return {"name": name, "true": true, "error": error, "relative": error / true, "sigmas": own}


def _displacement(station: Station, found: Calibration, exact: Calibration) -> dict[str, Any]:
    """Return how far the calibration puts points from where the exact one does, at equal pixels and phases."""
    stages = [{"name": "comparison", "plugin": "compare-calibrations"}]
    made = station.process({"a": exact, "b": found}, stages=stages).last("Artifact")
    return dict(json.loads(made.content.tobytes()))
