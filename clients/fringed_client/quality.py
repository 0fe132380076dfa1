"""What a scan or job is worth in a few figures, and what a person should be warned of.

Owns the figures' names and the limits of the warnings; draws nothing, prints nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from fringed.data import FrameSet, Model, PhaseMap, RangeImage, Registration

if TYPE_CHECKING:
    from fringed_client.results import ScanResult

WARN_KEPT_FRACTION = 0.01
"""A range image that keeps less of its pixels is warned of."""
FAIL_KEPT_FRACTION = 0.001
"""A processed capture folder that keeps less of its pixels does not pass the quality gate."""

_JUDGED = ("RangeImage", "Registration", "Model")


def quality_of(result: ScanResult) -> list[dict[str, Any]]:
    """Return the figures of every range image, registration and model; of the phase map where there is none."""
    products = result.state.products
    judged = [p for p in products if p.get("kind") in _JUDGED] or [p for p in products if p.get("kind") == "PhaseMap"]
    return [
        {"kind": p["kind"], "id": p["id"], "stage": p.get("stage") or "", **figures(result.fetch(str(p["id"])))}
        for p in judged
    ]


def figures(content: Any) -> dict[str, Any]:
    """Return the figures of one product; nothing for what has none."""
    if isinstance(content, (RangeImage, PhaseMap)):
        kept = content.rejected == 0
        count = int(np.count_nonzero(kept))
        found: dict[str, Any] = {"kept": count, "pixels": kept.size, "kept_fraction": count / kept.size}
        if isinstance(content, RangeImage):
            found["median_sigma_um"] = _median_um(content, kept)
        return found
    if isinstance(content, Registration):
        return _registration(content)
    if isinstance(content, Model):
        rows = [{"view": number, **_registration(r)} for number, r in enumerate(content.registrations, 2)]
        return {"points": len(content.points_mm), "views": len(content.views), "registrations": rows}
    return {}


def _median_um(image: RangeImage, kept: Any) -> float | None:
    if image.sigma_mm is None or not np.isfinite(image.sigma_mm[kept]).any():
        return None
    return float(np.nanmedian(image.sigma_mm[kept])) * 1000


def _registration(found: Registration) -> dict[str, Any]:
    T = np.asarray(found.T_reference_model, np.float64)
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    C = found.covariance
    return {
        "rms_mm": found.rms_mm, "overlap": found.overlap, "converged": found.converged, "reason": found.reason,
        "T_reference_model": T.tolist(), "rotation_deg": float(np.degrees(np.linalg.norm(turn))),
        "axis": (turn / max(float(np.linalg.norm(turn)), 1e-300)).tolist(),
        "sigma_rotation_deg": None if C is None else float(np.degrees(np.sqrt(np.trace(C[:3, :3])))),
    }  # fmt: skip


def lines(row: Mapping[str, Any]) -> list[str]:
    """Return the figures of one row of `quality_of` as text."""
    if "kept" in row:
        sigma = row.get("median_sigma_um")
        text = f"{row['kept']:,} of {row['pixels']:,} pixels kept ({row['kept_fraction']:.1%})"
        return [text + (f", median sigma {sigma:.0f} um" if sigma is not None else "")]
    if "registrations" in row:
        head = f"{row['points']:,} points from {row['views']} views"
        return [head, *(f"view {r['view']} to 1: {_ended(r)}" for r in row["registrations"])]
    return [_ended(row), _moved(row), *_matrix(row)] if "rms_mm" in row else []


def _ended(row: Mapping[str, Any]) -> str:
    end = "converged" if row["converged"] else f"NOT converged ({row['reason']})"
    rms = f", RMS {row['rms_mm'] * 1000:.3g} um" if np.isfinite(row["rms_mm"]) else ""
    return f"{end}{rms}, overlap {row['overlap']:.0%}"


def _moved(row: Mapping[str, Any]) -> str:
    """Return a registration's motion in words: model to reference."""
    sigma = row["sigma_rotation_deg"]
    turn = f"{row['rotation_deg']:.4f} deg" + (f" (sigma {sigma:.1g})" if sigma else "")
    axis = ", ".join(f"{x:.3f}" for x in row["axis"])
    shift = ", ".join(f"{line[3]:.3f}" for line in row["T_reference_model"][:3])
    return f"model to reference: turned {turn} about ({axis}), moved by ({shift}) mm, about the frame's origin"


def _matrix(row: Mapping[str, Any]) -> list[str]:
    """Return the rows of T_reference_model."""
    return ["  ".join(f"{value:14.9f}" for value in line) for line in row["T_reference_model"]]


def warnings_of(rows: Sequence[Mapping[str, Any]], sets: Mapping[str, FrameSet]) -> list[str]:
    """Return what a person should be told: hardly any pixel, no convergence, findings of the sets' own check."""
    found = []
    for row in rows:
        if "kept" in row and row["kept_fraction"] < WARN_KEPT_FRACTION:
            found.append(
                f"only {row['kept']:,} of {row['pixels']:,} pixels kept: "
                "frames in the wrong order, or another pattern family?"
            )
        ends = row.get("registrations") or ([row] if "rms_mm" in row else [])
        found += [f"{row['kind']} {row['id']}: {_ended(end)}" for end in ends if not end["converged"]]
    for role, frames in sets.items():
        if frames.check is not None:
            found += [f"set {role}: {finding.fault}: {finding.detail}" for finding in frames.check.findings]
    return found


def gate(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Tell whether enough is left of every measured product for it to be a measurement."""
    return all(row.get("kept_fraction", 1.0) >= FAIL_KEPT_FRACTION for row in rows)
