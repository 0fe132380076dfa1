"""What a person wants to know of a recording at a glance: a line of text, and plain attributes.

Owns how each kind is summed up, from its tree and array headers; opens no file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fringed.recording.preface import Summary, clipped
from fringed.wire import Encoded

UNITS = {"_mm": "mm", "_rad": "rad", "_px": "px"}
AXES = {
    "frames": "frame, row, column",
    "xyz_mm": "row, column, (x, y, z) in the camera's frame",
    "projector_px": "row, column, (projector column, projector row)",
    "points_mm": "point, (x, y, z)",
    "normals": "point, (x, y, z)",
    "vertices_mm": "vertex, (x, y, z)",
    "faces": "face, its three vertices",
}
_IMAGES = ("phase_rad", "modulation", "background", "rejected", "sigma_rad", "wrapped_rad", "intensity", "sigma_mm")
AXES.update(dict.fromkeys(_IMAGES, "row, column"))


def summary_of(encoded: Encoded, record_id: str, size_bytes: int) -> Summary:
    """Return what a listing shows of it."""
    body = encoded.body
    provenance = body.get("provenance") or {}
    return Summary(
        id=record_id,
        kind=encoded.kind,
        created=clipped(provenance.get("created") or time_of(record_id)),
        scan=clipped(body.get("scan", "")),
        role=clipped(body.get("role", "")),
        bytes=size_bytes,
        simulated=bool(provenance.get("simulated", False)),
        replayed=bool(provenance.get("replayed", False)),
        summary=clipped(_text(encoded)),
    )


def time_of(record_id: str) -> str:
    """Return an id's time as ISO 8601."""
    day, clock = record_id[:8], record_id[9:22]
    return f"{day[:4]}-{day[4:6]}-{day[6:]}T{clock[:2]}:{clock[2:4]}:{clock[4:]}+00:00"


def attributes(encoded: Encoded, record_id: str) -> dict[str, Any]:
    """Return the file's plain attributes: what is asked for most, without reading the tree."""
    summary = summary_of(encoded, record_id, 0)
    found: dict[str, Any] = {
        "kind": encoded.kind, "id": record_id, "created": summary.created, "summary": summary.summary,
        "simulated": summary.simulated, "replayed": summary.replayed,
    }  # fmt: skip
    for source in (encoded.body, encoded.body.get("provenance") or {}):
        for key, value in source.items():
            if isinstance(value, (str, bool, int, float)) and key not in found and not key.startswith("$"):
                found[key] = value if not isinstance(value, str) else value[:4096].replace("\0", "\\0")
    for key, value in (encoded.body.get("settings") or {}).items():
        if isinstance(value, (str, int, float)):
            found[f"camera_{key}"] = value
    return found


def _text(encoded: Encoded) -> str:
    shapes = {header["path"]: header["shape"] for header in encoded.headers}
    dtypes = {header["path"]: header["dtype"] for header in encoded.headers}
    makers = {
        "FrameSet": _frame_set, "PatternSequence": _sequence, "PhaseMap": _phase_map, "Calibration": _calibration,
        "RangeImage": _range_image, "Registration": _registration, "Model": _model, "Truth": _truth, "Mesh": _mesh,
        "Artifact": _artifact, "BoardView": _board_view, "Verification": _verification,
    }  # fmt: skip
    bits = " 16-bit" if dtypes.get("frames") == "<u2" else ""
    return makers[encoded.kind](encoded.body, shapes) + bits


Body = Mapping[str, Any]
Shapes = Mapping[str, list[int]]


def _size(shape: list[int]) -> str:
    return f"{shape[1]} x {shape[0]}"


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, (int, float)) else str(value["$float"])


def _frame_set(body: Body, shapes: Shapes) -> str:
    frames = shapes["frames"]
    return f"{frames[0]} frames {_size(frames[1:])} {body['sequence']['family']}"


def _sequence(body: Body, _shapes: Shapes) -> str:
    return f"{len(body['frames'])} patterns {body['width_px']} x {body['height_px']} {body['family']}"


def _phase_map(body: Body, shapes: Shapes) -> str:
    return f"{body['kind']} phase {_size(shapes['phase_rad'])}, period {_number(body['period_px'])} px"


def _calibration(body: Body, _shapes: Shapes) -> str:
    return f"calibration of {body['rig'] or 'an unnamed rig'} ({body['source']})"


def _board_view(body: Body, shapes: Shapes) -> str:
    board = body["board"]
    name = f"{board.get('kind', 'board')} {board.get('columns', '?')} x {board.get('rows', '?')}"
    return f"{name}, {shapes['index'][0]} points" if body["found"] else f"{name}, not found: {body['reason']}"


def _verification(body: Body, _shapes: Shapes) -> str:
    return f"{body['artefact']}: {body['verdict']}, {body['points']} points"


def _range_image(_body: Body, shapes: Shapes) -> str:
    return f"range image {_size(shapes['xyz_mm'])}"


def _registration(body: Body, _shapes: Shapes) -> str:
    how = "converged" if body["converged"] else f"not converged: {body['reason']}"
    return f"{how}, rms {_number(body['rms_mm'])} mm"


def _model(body: Body, shapes: Shapes) -> str:
    return f"{shapes['points_mm'][0]} points of {len(body['views'])} views"


def _truth(_body: Body, shapes: Shapes) -> str:
    return f"truth {_size(shapes['xyz_mm'])}"


def _mesh(_body: Body, shapes: Shapes) -> str:
    return f"{shapes['vertices_mm'][0]} vertices, {shapes['faces'][0]} faces"


def _artifact(body: Body, shapes: Shapes) -> str:
    return f"{body['name']}, {body['media_type']}, {shapes['content'][0]} bytes"
