"""What a session has reached, in figures and words: coverage of the picture, tilts, accuracy.

Owns these words; draws nothing, asks no station.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fringed.data import Array, BoardView, Calibration

COLUMNS, ROWS = 4, 3
_PLACES = {
    (0, 0): "upper left", (1, 0): "top", (2, 0): "top", (3, 0): "upper right",
    (0, 1): "left side", (1, 1): "middle", (2, 1): "middle", (3, 1): "right side",
    (0, 2): "lower left", (1, 2): "bottom", (2, 2): "bottom", (3, 2): "lower right",
}  # fmt: skip
_FEW = 3  # points that make a cell covered


def cells(views: Sequence[BoardView]) -> Array:
    """Return how many points lie in each cell (3, 4) of the camera's picture."""
    counts = np.zeros((ROWS, COLUMNS), int)
    for view in views:
        width, height = view.camera_size_px
        column = np.clip((view.camera_px[:, 0] + 0.5) / width * COLUMNS, 0, COLUMNS - 1).astype(int)
        row = np.clip((view.camera_px[:, 1] + 0.5) / height * ROWS, 0, ROWS - 1).astype(int)
        np.add.at(counts, (row, column), 1)
    return counts


def coverage_words(views: Sequence[BoardView]) -> str:
    """Return how much of the picture the views cover, and what not."""
    counts = cells(views)
    missing = [_PLACES[int(column), int(row)] for row, column in np.argwhere(counts < _FEW)]
    share = float(np.mean(counts >= _FEW))
    lacks = f"; no points yet at the {', '.join(dict.fromkeys(missing))}" if missing else ""
    return f"{share:.0%} of the picture covered{lacks}"


def view_words(view: BoardView) -> str:
    """Return what one pose has brought, or why it has not."""
    if not view.found:
        return f"board NOT found: {view.reason}"
    tilt = f", tilted {view.quality['tilt_deg']:.0f} degrees" if "tilt_deg" in view.quality else ""
    known = int(np.isfinite(view.projector_px).all(axis=1).sum())
    text = f"{len(view.index)} points, {known} of them with projector coordinates{tilt}"
    return "; ".join([text, *view.problems])


def view_row(view: BoardView) -> dict[str, Any]:
    """Return one pose as plain values."""
    return {
        "name": view.name, "id": view.id, "found": view.found, "reason": view.reason, "points": len(view.index),
        "problems": list(view.problems), "quality": dict(view.quality),
    }  # fmt: skip


def accuracy_rows(found: Calibration) -> dict[str, str]:
    """Return what a calibration is worth, line by line."""
    figures = found.residuals
    rows = {"calibration": f"{found.id or found.hash}, hash {found.hash}", "rig": found.rig or "unnamed"}
    if "camera_rms_px" in figures:
        rows["reprojection"] = (
            f"camera {figures['camera_rms_px']:.3f} px RMS, projector {figures.get('projector_rms_px', np.nan):.3f} px"
        )
    used = [view for view in found.views if not view.note]
    if found.views:
        rows["views"] = f"{len(used)} used of {len(found.views)}"
        left = [f"{view.name or view.view} left out: {view.note}" for view in found.views if view.note]
        rows["views"] = "\n".join([rows["views"], *left])
    if "trueness_rms_mm" in figures:
        largest = figures.get("trueness_max_mm", np.nan)
        rows["expected trueness"] = f"{figures['trueness_rms_mm'] * 1000:.0f} um RMS, {largest * 1000:.0f} um at most"
    rows |= {f"{name}": text for name, text in lens_rows(found).items()}
    if found.notes:
        rows["notes"] = "\n".join(found.notes)
    return rows


def lens_rows(found: Calibration) -> dict[str, str]:
    """Return focal lengths, principal points and baseline with their standard deviations."""
    known = sigmas(found)
    rows = {}
    for name, lens in (("camera", found.camera), ("projector", found.projector)):
        fx, fy, cx, cy = lens.matrix[0, 0], lens.matrix[1, 1], lens.matrix[0, 2], lens.matrix[1, 2]
        parts = zip(("fx", "fy", "cx", "cy"), (fx, fy, cx, cy), strict=True)
        rows[name] = ", ".join(f"{key} {number(value, known.get(f'{name}.{key}'))}" for key, value in parts) + " px"
    rows["baseline"] = f"{baseline_mm(found):.3f} mm"
    return rows


def baseline_mm(found: Calibration) -> float:
    """Return the distance of the projector's centre from the camera's."""
    return float(np.linalg.norm(found.T_projector_camera[:3, 3]))


def sigmas(found: Calibration) -> dict[str, float]:
    """Return each parameter's standard deviation by its name; empty where the covariance is unknown."""
    if found.covariance is None:
        return {}
    return dict(zip(found.parameters, np.sqrt(np.maximum(np.diag(found.covariance), 0)).tolist(), strict=True))


def number(value: float, sigma: float | None) -> str:
    """Return a value with its standard deviation in digits that mean something.

    >>> number(3480.1234, 0.21), number(0.08, None)
    ('3480.12 ± 0.21', '0.08')
    """
    if not sigma:
        return f"{value:.6g}"
    digits = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"
