"""What is projected and what the camera sees of it: patterns, frames, and why a pixel is dropped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntFlag
from typing import Any, Literal

import numpy as np

from fringed.data.arrays import Array, Frozen, Provenance, UInt8Array
from fringed.errors import DataError

Role = str  # "object", "reference", or what a pipeline names
Channel = Literal["white", "red", "green", "blue"]
CameraChannel = Literal["white", "red", "green", "blue", "rgb"]  # "rgb": all three of one exposure
Orientation = Literal["columns", "rows"]
PhaseKind = Literal["wrapped", "absolute", "relative"]


class Reject(IntFlag):
    """Say why a pixel was dropped."""

    KEPT = 0
    SATURATED = 1
    LOW_MODULATION = 2
    FRINGE_ORDER = 4
    RESIDUAL = 8
    OUT_OF_RANGE = 16
    ISOLATED = 32
    DISCONTINUITY = 64
    OTHER = 128
    HOT_PIXEL = 256
    SHADOW = 512
    REPEATED = 1024


@dataclass(frozen=True)
class PatternFrame:
    """What one projected frame is, enough to decode it.

    A sinusoid of `group` g is `A + B cos(2 pi u / period_px + initial_phase_rad + shift_rad)`, u the
    projector column (orientation "columns") or row. Frames of one group differ in `shift_rad` only. Other
    styles have that sinusoid as their fundamental. `bit` numbers the bits of a Gray code from the coarsest, 0;
    -1: no code. `inverted` frames show the complement. `level` is the frame's light over the sequence's
    (several of them: high dynamic range). Frames of one `shot` are the channels of a single exposure and
    share its pattern; -1: a shot of its own.
    """

    style: str
    orientation: Orientation = "columns"
    period_px: float = 0.0
    shift_rad: float = 0.0
    initial_phase_rad: float = 0.0
    step: int = 0
    steps: int = 1
    group: int = 0
    channel: Channel = "white"
    bit: int = -1
    inverted: bool = False
    level: float = 1.0
    shot: int = -1


@dataclass(frozen=True)
class PatternSequence(Frozen):
    """The ordered patterns of one acquisition.

    `patterns[i]` is uint8 `(height or 1, width or 1, 1 or 3)` and broadcasts to the projector's size.
    """

    family: str
    width_px: int
    height_px: int
    frames: tuple[PatternFrame, ...]
    patterns: tuple[UInt8Array, ...]
    grey_low: float = 0.0
    grey_high: float = 255.0
    precompensated: bool = False
    encoder: str = ""
    encoder_version: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def _check(self) -> None:
        if not self.frames or len(self.frames) != len(self.patterns):
            raise DataError(
                f"a pattern sequence needs as many patterns as frames and at least one; "
                f"it has {len(self.frames)} frames and {len(self.patterns)} patterns"
            )
        for index, pattern in enumerate(self.patterns):
            allowed = ({1, self.height_px}, {1, self.width_px}, {1, 3})
            if pattern.ndim != 3 or any(n not in a for n, a in zip(pattern.shape, allowed, strict=True)):
                raise DataError(
                    f"pattern {index} has shape {pattern.shape}; expected "
                    f"({self.height_px} or 1, {self.width_px} or 1, 1 or 3)"
                )

    def groups(self) -> dict[int, tuple[int, ...]]:
        """Map each group to the indices of its frames, in order."""
        found: dict[int, list[int]] = {}
        for index, frame in enumerate(self.frames):
            found.setdefault(frame.group, []).append(index)
        return {group: tuple(indices) for group, indices in found.items()}

    def exposures(self) -> tuple[tuple[int, ...], ...]:
        """Return the frames of each exposure, in order: one frame, or those of one shot."""
        found: dict[tuple[str, int], list[int]] = {}
        for index, frame in enumerate(self.frames):
            found.setdefault(("frame", index) if frame.shot < 0 else ("shot", frame.shot), []).append(index)
        return tuple(tuple(indices) for indices in found.values())


@dataclass(frozen=True)
class FrameStamp:
    """When one frame was shown and integrated, on the station's clock, and the camera's counter."""

    flip_s: float
    exposure_start_s: float
    exposure_end_s: float
    counter: int


@dataclass(frozen=True)
class CameraSettings:
    """What the camera was told. `noise_floor_dn` and `electrons_per_dn` describe its noise."""

    exposure_us: float = 8000.0
    gain_db: float = 0.0
    bits: int = 8
    channel: CameraChannel = "white"
    trigger: Literal["free-running", "software", "hardware"] = "free-running"
    electrons_per_dn: float = 0.0
    read_noise_electrons: float = 0.0


@dataclass(frozen=True)
class CheckFinding:
    """One thing that the station's own check of a set found wrong."""

    fault: str
    detail: str
    frames: tuple[int, ...] = ()


@dataclass(frozen=True)
class CheckReport:
    """What the station's own check of a set measured."""

    passed: bool
    findings: tuple[CheckFinding, ...] = ()
    residual: float = 0.0
    saturated_fraction: float = 0.0
    lit_fraction: float = 0.0
    counters_skipped: int = 0


@dataclass(frozen=True)
class FrameSet(Frozen):
    """Frames `(n, height, width)` uint8 or uint16 of one role, one for each frame of `sequence`."""

    frames: Array
    sequence: PatternSequence
    role: Role = "object"
    id: str = ""
    scan: str = ""
    stamps: tuple[FrameStamp, ...] = ()
    settings: CameraSettings = field(default_factory=CameraSettings)
    check: CheckReport | None = None
    retakes: int = 0
    provenance: Provenance = field(default_factory=Provenance)

    def _check(self) -> None:
        frames = self.frames
        if frames.ndim != 3 or frames.dtype not in (np.uint8, np.uint16) or 0 in frames.shape:
            raise DataError(
                f"frames have shape {frames.shape} and type {frames.dtype}; "
                "expected (n, height, width) of uint8 or uint16, none of them zero"
            )
        if len(frames) != len(self.sequence.frames):
            raise DataError(f"{len(frames)} frames for a sequence of {len(self.sequence.frames)} patterns")
        if self.stamps and len(self.stamps) != len(frames):
            raise DataError(f"{len(self.stamps)} stamps for {len(frames)} frames; expected none or one for each")
