"""What a known artefact said of a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from fringed.data.arrays import Provenance

Verdict = Literal["green", "yellow", "red"]


@dataclass(frozen=True)
class Verification:
    """One measurement of an artefact of known size, in the terms of VDI/VDE 2634 part 2.

    `figures` (mm) such as `probing_error_form`, `probing_error_size`, `sphere_spacing_error`, `flatness_error`,
    `step_error`; `limits` what each may be at most, and `verdicts` how it stands to that; `verdict` is the worst of
    them. `depth_mm` is the nearest and the farthest depth of the artefact's points: it holds there. `calibration` is
    the hash.
    """

    artefact: Literal["plane", "sphere", "ball-bar", "step"]
    calibration: str
    rig: str
    figures: Mapping[str, float]
    limits: Mapping[str, float]
    verdicts: Mapping[str, Verdict]
    verdict: Verdict
    depth_mm: tuple[float, float]
    points: int
    nominal: Mapping[str, float] = field(default_factory=dict)
    temperature_c: float | None = None
    notes: tuple[str, ...] = ()
    id: str = ""
    provenance: Provenance = field(default_factory=Provenance)
