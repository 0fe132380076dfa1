"""Capture folders: images that somebody captured, described by a small `capture.toml`.

Owns the description (docs/capture-toml.md) and what it means as a PatternSequence; `capture_images` reads
the images, `capture_write` writes such a folder.
"""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from fringed.config import read_toml, validate
from fringed.data import Channel, Orientation, PatternFrame, PatternSequence, UInt8Array
from fringed.errors import ConfigurationError, Problem

DESCRIPTION = "capture.toml"
Size = tuple[Annotated[int, Meta(ge=1, le=65536)], Annotated[int, Meta(ge=1, le=65536)]]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every table: unknown keys are errors."""


class CaptureTable(_Table, frozen=True, kw_only=True):
    """What holds for every set."""

    family: Annotated[
        Literal["phase-shift", "multi-frequency"], Meta(description="one group of fringes, or coarse to fine")
    ] = "multi-frequency"
    orientation: Annotated[Orientation, Meta(description="what the phase counts: projector columns or rows")] = (
        "columns"
    )
    projector_px: Annotated[Size, Meta(description="width and height")] = (1024, 768)
    channel: Annotated[
        Literal["red", "green", "blue", "mean"], Meta(description="which one of colour images is used")
    ] = "green"
    projected: Annotated[Channel, Meta(description="the light of the fringes")] = "white"
    bits: Annotated[int, Meta(ge=8, le=16, description="significant bits of 16-bit images")] | None = None
    calibration: Annotated[str, Meta(description="a calibration file of this station's format, for XYZ")] = ""
    pipeline: Annotated[str, Meta(description="the station's pipeline; chosen by family and sets when empty")] = ""
    simulated: Annotated[bool, Meta(description="the images were rendered; every product says so")] = False


class SensorTable(_Table, frozen=True, kw_only=True):
    """The camera's noise, for uncertainties."""

    electrons_per_dn: Annotated[float, Meta(gt=0)] = 51.0
    read_noise_electrons: Annotated[float, Meta(ge=0)] = 12.0


class GroupTable(_Table, frozen=True, kw_only=True):
    """One frequency: N images that differ in phase only."""

    periods: Annotated[float, Meta(gt=0, le=65536, description="across the projector")] | None = None
    period_px: Annotated[float, Meta(gt=0, le=65536, description="instead of periods")] | None = None
    steps: Annotated[int, Meta(ge=3, le=64)] = 4
    shifts_deg: Annotated[list[float], Meta(description="of each image; 360 k / steps when left out")] | None = None
    initial_phase_rad: float = 0.0


class CaptureDescription(_Table, frozen=True, kw_only=True):
    """A whole capture.toml. `sets` maps a role to a glob pattern or a list of files, in the order of the groups."""

    sets: Annotated[dict[str, str | list[str]], Meta(min_length=1)]
    group: Annotated[list[GroupTable], Meta(min_length=1, max_length=64)]
    capture: CaptureTable = CaptureTable()
    sensor: SensorTable | None = None


def load_description(folder: Path) -> CaptureDescription:
    """Read and check `folder/capture.toml`.

    Raises
    ------
    ConfigurationError
        with every problem.
    """
    path = folder / DESCRIPTION
    if not path.exists():
        raise ConfigurationError(
            f"{folder} holds no {DESCRIPTION}; write one that tells files, order, periods and steps "
            "(docs/capture-toml.md), or make a folder with `fringe simulate`"
        )
    described = validate(read_toml(path), CaptureDescription, "")
    problems = [problem for index, group in enumerate(described.group) for problem in _problems(index, group)]
    if problems:
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)} in {path}:", tuple(problems))
    return described


def _problems(index: int, group: GroupTable) -> list[Problem]:
    found = []
    if (group.periods is None) == (group.period_px is None):
        given = "both" if group.periods is not None else "neither"
        found.append(Problem(f"group[{index}].periods", given, "either periods (across the projector) or period_px"))
    if group.shifts_deg is not None and len(group.shifts_deg) != group.steps:
        found.append(
            Problem(f"group[{index}].shifts_deg", f"{len(group.shifts_deg)} values", f"{group.steps}, one per step")
        )
    return found


def sequence_of(described: CaptureDescription) -> PatternSequence:
    """Return the sequence that the description stands for, its patterns computed from it."""
    width, height = described.capture.projector_px
    length = width if described.capture.orientation == "columns" else height
    frames = [
        frame for index, group in enumerate(described.group) for frame in _frames(described, index, group, length)
    ]
    return PatternSequence(
        family=described.capture.family,
        width_px=width,
        height_px=height,
        frames=tuple(frames),
        patterns=tuple(_pattern(frame, length) for frame in frames),
        encoder=DESCRIPTION,
        parameters=msgspec.to_builtins(described.group[0]) | {"groups": len(described.group)},
    )


def _frames(described: CaptureDescription, index: int, group: GroupTable, length: int) -> list[PatternFrame]:
    period_px = group.period_px or length / float(group.periods or 1)
    shifts = group.shifts_deg or [360.0 * step / group.steps for step in range(group.steps)]
    return [
        PatternFrame(
            "sinusoidal",
            described.capture.orientation,
            period_px,
            float(np.deg2rad(shift)),
            group.initial_phase_rad,
            step,
            group.steps,
            index,
            described.capture.projected,
        )
        for step, shift in enumerate(shifts)
    ]


def _pattern(frame: PatternFrame, length: int) -> UInt8Array:
    phase = 2 * pi * np.arange(length) / frame.period_px + frame.initial_phase_rad + frame.shift_rad
    row: UInt8Array = np.rint(127.5 + 127.5 * np.cos(phase)).astype(np.uint8)
    return row.reshape((1, -1, 1) if frame.orientation == "columns" else (-1, 1, 1))


def pipeline_of(described: CaptureDescription, calibrated: bool) -> dict[str, Any]:
    """Return the parameters of `process` that suit the sets: a pipeline, or only its phase without a calibration."""
    roles = set(described.sets)
    if described.capture.pipeline:
        return {"pipeline": described.capture.pipeline}
    if {"reference", "object"} <= roles:
        return {"pipeline": "thesis"} if calibrated else {"stages": difference_stages(described.capture.family)}
    if described.capture.family == "multi-frequency" and calibrated:
        return {"pipeline": "hierarchical"}
    return {"stages": [stage("phase", described.capture.family, {"frames": next(iter(described.sets))})]}


def difference_stages(family: str) -> list[dict[str, Any]]:
    """Return the stages that end with the phase difference of object and reference."""
    return [
        stage("wrapped-reference", family, {"frames": "reference"}),
        stage("wrapped-object", family, {"frames": "object"}),
        stage("phase", "unwrap-difference", {"reference": "wrapped-reference", "object": "wrapped-object"}),
    ]


def stage(name: str, plugin: str, inputs: dict[str, str]) -> dict[str, Any]:
    """Return one stage of `process`."""
    return {"name": name, "kind": "processor", "plugin": plugin, "inputs": inputs}
