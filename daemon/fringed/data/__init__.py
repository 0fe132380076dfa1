"""The data that travels through the house: frozen dataclasses around read-only arrays.

Owns what a frame set, a phase map, a board's view, a calibration, a range image, a registration and a model are;
knows nothing of sockets, files or plug-ins. Conventions that hold everywhere:

- Arrays are C-ordered and read-only. Images are `(height, width)`, row first.
- Pixel coordinates put the centre of the first pixel at 0 (OpenCV). A projector column `u` carries
  the phase `2 pi u / period_px + initial_phase_rad`.
- A transform is named by its frames: `T_reference_model` takes model points to the reference frame.
- Lengths are millimetres, angles radians, times seconds unless the name says otherwise.
- `rejected` masks (uint16) are zero where a pixel is kept, otherwise an OR of `Reject` flags.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from fringed.data.arrays import (
    Array,
    Float32Array,
    Float64Array,
    Frozen,
    Int32Array,
    Provenance,
    UInt8Array,
    UInt16Array,
    new_id,
    read_only,
)
from fringed.data.boards import BoardView
from fringed.data.calibration import Calibration, Lens, PhaseErrorTable, PixelModel, ViewFit
from fringed.data.frames import (
    CameraChannel,
    CameraSettings,
    Channel,
    CheckFinding,
    CheckReport,
    FrameSet,
    FrameStamp,
    Orientation,
    PatternFrame,
    PatternSequence,
    PhaseKind,
    Reject,
    Role,
)
from fringed.data.phase import PhaseMap
from fringed.data.points import IterationRecord, Mesh, Model, RangeImage, Registration, Truth
from fringed.data.verification import Verification


@dataclass(frozen=True)
class Artifact(Frozen):
    """A finished file: `content` uint8 (n,), with its name and media type."""

    name: str
    media_type: str
    content: UInt8Array
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)


Product = (
    PhaseMap | BoardView | Calibration | Verification | RangeImage | Registration | Model | Truth | Mesh | Artifact
)
RECORDED: tuple[type, ...] = (
    FrameSet, PatternSequence, PhaseMap, BoardView, Calibration, Verification, RangeImage, Registration, Model, Truth,
    Mesh, Artifact,
)  # fmt: skip

__all__ = [
    "RECORDED",
    "Array",
    "Artifact",
    "BoardView",
    "Calibration",
    "CameraChannel",
    "CameraSettings",
    "Channel",
    "CheckFinding",
    "CheckReport",
    "Float32Array",
    "Float64Array",
    "FrameSet",
    "FrameStamp",
    "Frozen",
    "Int32Array",
    "IterationRecord",
    "Lens",
    "Mesh",
    "Model",
    "Orientation",
    "PatternFrame",
    "PatternSequence",
    "PhaseErrorTable",
    "PhaseKind",
    "PhaseMap",
    "PixelModel",
    "Product",
    "Provenance",
    "RangeImage",
    "Registration",
    "Reject",
    "Role",
    "Truth",
    "UInt8Array",
    "UInt16Array",
    "Verification",
    "ViewFit",
    "new_id",
    "read_only",
]
