"""How a capture folder is processed: a pipeline of the station, or stages that suit its family.

Owns this choice; pure.
"""

from __future__ import annotations

from typing import Any

from fringed_client.capture import WRAPPED, CaptureDescription


def pipeline_of(described: CaptureDescription, calibrated: bool) -> dict[str, Any]:
    """Return the parameters of `process` that suit the sets: a pipeline, or only its phase without a calibration.

    Fringes along both directions give a phase map for each; the range image is that of the columns.
    """
    family, roles, orientations = described.capture.family, set(described.sets), described.orientations()
    if described.capture.pipeline:
        return {"pipeline": described.capture.pipeline}
    if {"reference", "object"} <= roles:
        return {"pipeline": "thesis"} if calibrated else {"stages": difference_stages(family)}
    if family == "multi-frequency" and calibrated and len(orientations) == 1:
        return {"pipeline": "hierarchical"}
    role = next(iter(described.sets))
    if len(orientations) == 1:
        stages = [stage("phase", family, {"frames": role})]
    else:
        stages = [stage(f"phase-{o}", family, {"frames": role}, orientation=o) for o in orientations]
    if calibrated and family not in WRAPPED:
        stages.append(stage("range", "triangulate", {"phase": stages[0]["name"]}))
    return {"stages": stages}


def difference_stages(family: str) -> list[dict[str, Any]]:
    """Return the stages that end with the phase difference of object and reference."""
    return [
        stage("wrapped-reference", family, {"frames": "reference"}),
        stage("wrapped-object", family, {"frames": "object"}),
        stage("phase", "unwrap-difference", {"reference": "wrapped-reference", "object": "wrapped-object"}),
    ]


def stage(name: str, plugin: str, inputs: dict[str, str], **params: Any) -> dict[str, Any]:
    """Return one stage of `process`."""
    return {"name": name, "kind": "processor", "plugin": plugin, "inputs": inputs} | (
        {"params": params} if params else {}
    )
