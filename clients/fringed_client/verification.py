"""What a verification says in words and rows, what it was made of, and how it stands to the one before.

Owns the words of the traffic light and when a figure has changed; measures nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fringed.data import Array, RangeImage, Verification
from fringed.errors import FringedError

if TYPE_CHECKING:
    from fringed_client.station import Station

WORDS = {
    "green": "holds",
    "yellow": "at its limit",
    "red": "does NOT hold",
}
COLOURS = {"green": "#3f7d4e", "yellow": "#c98a1b", "red": "#b3261e"}
NAMES = {
    "flatness_error": "flatness measurement error",
    "probing_error_form": "probing error, form",
    "probing_error_size": "probing error, size (diameter)",
    "sphere_spacing_error": "sphere-spacing error",
    "step_error": "worst error of a step",
}
_CHANGED = 2.0  # standard uncertainties of a difference
_NEAR = 10.0  # RMS of the points: farther ones are not the artefact's


def rows(found: Verification) -> list[tuple[str, str, str, str, str]]:
    """Return name, measured, standard uncertainty, limit (mm) and verdict of each figure that has a limit."""
    return [
        (
            NAMES.get(name, name.replace("_", " ")),
            f"{found.figures[name]:+.4f}" if "error_form" not in name and "flat" not in name else
            f"{found.figures[name]:.4f}",
            f"{found.figures.get(f'{name}_u', 0.0):.4f}",
            f"{limit:.4f}",
            found.verdicts[name],
        )
        for name, limit in found.limits.items()
    ]  # fmt: skip


def measured(found: Verification) -> str:
    """Return the sizes that were measured, beside the nominal ones."""
    parts = []
    for name, nominal in found.nominal.items():
        names = {"radius": ("radius", "radius_1", "radius_2"), "spacing": ("spacing",)}.get(name, (f"{name}_height",))
        values = " and ".join(f"{found.figures[n]:.4f}" for n in names if n in found.figures)
        parts.append(f"{name.replace('_', ' ')} {values} mm ({nominal:g} nominal)")
    return "\n".join(parts)


def summary(found: Verification) -> dict[str, str]:
    """Return a verification as names and values for a person."""
    near, far = found.depth_mm
    told = {
        "calibration": f"{found.calibration or 'unknown'}  {WORDS[found.verdict]}",
        "artefact": f"{found.artefact}, {found.points:,} points at {near:.0f} to {far:.0f} mm",
    }
    told |= {"measured": measured(found)} if found.nominal else {}
    told |= {"temperature": f"{found.temperature_c:g} °C"} if found.temperature_c is not None else {}
    return told | ({"notes": "\n".join(found.notes)} if found.notes else {})


def document(found: Verification) -> dict[str, Any]:
    """Return everything of a verification as JSON can hold it."""
    return {
        "verification": found.id, "artefact": found.artefact, "verdict": found.verdict,
        "calibration": found.calibration, "rig": found.rig, "figures": dict(found.figures),
        "limits": dict(found.limits), "verdicts": dict(found.verdicts), "nominal": dict(found.nominal),
        "depth_mm": list(found.depth_mm), "points": found.points, "temperature_c": found.temperature_c,
        "notes": list(found.notes), "date": when(found), "simulated": found.provenance.simulated,
    }  # fmt: skip


def when(found: Verification) -> str:
    """Return day and time (UTC) of an id."""
    stamp = found.id
    return f"{stamp[:4]}-{stamp[4:6]}-{stamp[6:8]} {stamp[9:11]}:{stamp[11:13]}" if len(stamp) > 13 else ""


def worst(found: Verification) -> str:
    """Return the figure that is nearest to its limit, or farthest beyond."""
    name = max(found.limits, key=lambda one: abs(found.figures[one]) / found.limits[one])
    return f"{NAMES.get(name, name)} {found.figures[name]:+.4f} of {found.limits[name]:.4f} mm"


def previous(of: Verification, among: Sequence[Verification]) -> Verification | None:
    """Return the newest older verification of the same artefact and rig."""
    older = [one for one in among if one.id < of.id and _alike(one, of)]
    return max(older, key=lambda one: one.id, default=None)


def earlier(station: Station, than: Verification | None = None, limit: int = 100) -> list[Verification]:
    """Return recorded verifications, newest first; with `than` only older ones of the same artefact of that rig."""
    before = than.id if than is not None else None
    listed = station.list(kind="Verification", limit=limit, before=before or None)
    found = [station.get(item["id"]) for item in listed]
    if than is None:
        return found
    return [one for one in found if _alike(one, than)]


def _alike(a: Verification, b: Verification) -> bool:
    same = a.artefact == b.artefact and a.rig == b.rig and set(a.nominal) == set(b.nominal)
    return same and all(abs(a.nominal[name] - b.nominal[name]) < 0.01 * b.nominal[name] for name in b.nominal)


def drift(now: Verification, then: Verification) -> list[str]:
    """Return a line for each limited figure that both have: by how much it changed, and whether that is noise."""
    lines = []
    for name in now.limits:
        if name not in then.figures:
            continue
        change = now.figures[name] - then.figures[name]
        doubt = float(np.hypot(now.figures.get(f"{name}_u", 0.0), then.figures.get(f"{name}_u", 0.0)))
        what = "CHANGED" if abs(change) > _CHANGED * doubt else "unchanged within its uncertainty"
        lines.append(f"{NAMES.get(name, name)} {change:+.4f} mm since {then.id[:8]}: {what}")
    if now.calibration != then.calibration:
        lines.append(f"with another calibration: {then.calibration} then")
    return lines


def range_of(station: Station, found: Verification) -> RangeImage | None:
    """Return the range image that a verification was made of, None where it is not at hand."""
    for item in found.provenance.inputs:
        try:
            content = station.get(item)
        except FringedError:
            continue
        if isinstance(content, RangeImage):
            return content
    return None


def deviations_mm(found: Verification, image: RangeImage) -> Array:
    """Return the signed distances (height, width) of the artefact's points, outwards; NaN elsewhere."""
    xyz = image.xyz_mm.astype(np.float64)
    xyz[image.rejected != 0] = np.nan
    near = _NEAR * max((value for key, value in found.figures.items() if key.startswith("raw_rms")), default=0.1)
    away = np.full(xyz.shape[:2], np.nan)
    with np.errstate(invalid="ignore"):
        for one in _surfaces(found, xyz):
            away = np.where(np.abs(one) <= near, one, away)
    return away


def _surfaces(found: Verification, xyz: Array) -> list[Array]:
    """Return the signed distance of all points from each surface of the artefact."""
    figures = found.figures
    if "normal_x" in figures:
        normal = np.array([figures[f"normal_{axis}"] for axis in "xyz"])
        heights = [
            0.0,
            *(value for key, value in figures.items() if key.startswith("step_") and key.endswith("_height")),
        ]
        along = xyz @ normal - figures["offset"]
        return [along - height for height in heights]
    ends = [key.removeprefix("radius") for key in figures if key.startswith("radius") and not key.endswith("_u")]
    surfaces = []
    for end in ends:
        centre = np.array([figures[f"centre_{axis}{end}"] for axis in "xyz"])
        surfaces.append(np.linalg.norm(xyz - centre, axis=-1) - figures[f"radius{end}"])
    return surfaces
