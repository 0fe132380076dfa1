"""Capture folders: images that somebody captured, described by a small `capture.toml`.

Owns the description (docs/capture-toml.md) and its checks. `capture_patterns` says what it means as a
PatternSequence, `capture_plan` how it is processed, `capture_images` reads the images, `capture_write` writes such
a folder.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from fringed.config import read_toml, validate
from fringed.data import Channel, Orientation
from fringed.errors import ConfigurationError, Problem

DESCRIPTION = "capture.toml"
Size = tuple[Annotated[int, Meta(ge=1, le=65536)], Annotated[int, Meta(ge=1, le=65536)]]
Family = Literal[
    "phase-shift", "multi-frequency", "heterodyne", "number-theoretic", "gray-code", "gray-phase-shift", "fourier",
    "windowed-fourier", "unknown-shifts", "one-shot-phase-shift", "one-shot-frequencies",
]  # fmt: skip
Style = Literal["sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary", "gray", "skip"]
WRAPPED: tuple[Family, ...] = ("phase-shift", "fourier", "windowed-fourier", "unknown-shifts", "one-shot-phase-shift")
SINGLE: tuple[Family, ...] = ("fourier", "windowed-fourier", "one-shot-frequencies")


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every table: unknown keys are errors."""


class CaptureTable(_Table, frozen=True, kw_only=True):
    """What holds for every set."""

    family: Annotated[Family, Meta(description="the fringe method, by the name of its decoder")] = "multi-frequency"
    orientation: Annotated[Orientation, Meta(description="what the phase counts: projector columns or rows")] = (
        "columns"
    )
    projector_px: Annotated[Size, Meta(description="width and height")] = (1024, 768)
    images: Annotated[str, Meta(description="the folder of the images, relative to this one")] = "."
    channel: Annotated[
        Literal["red", "green", "blue", "mean"], Meta(description="which one of colour images is used")
    ] = "green"
    projected: Annotated[Channel, Meta(description="the light of the fringes")] = "white"
    bits: Annotated[int, Meta(ge=8, le=16, description="significant bits of 16-bit images")] | None = None
    calibration: Annotated[str, Meta(description="a calibration file of this station's format, for XYZ")] = ""
    pipeline: Annotated[str, Meta(description="the station's pipeline; chosen by family and sets when empty")] = ""
    rig: Annotated[str, Meta(description="the rig, where it is known: a calibration of another one is refused")] = ""
    simulated: Annotated[bool, Meta(description="the images were rendered; every product says so")] = False

    @property
    def one_shot(self) -> bool:
        """Whether every image is a colour image of three frames."""
        return self.family.startswith("one-shot")


class SensorTable(_Table, frozen=True, kw_only=True):
    """The camera's noise, for uncertainties."""

    electrons_per_dn: Annotated[float, Meta(gt=0)] = 51.0
    read_noise_electrons: Annotated[float, Meta(ge=0)] = 12.0


class GroupTable(_Table, frozen=True, kw_only=True):
    """Images that belong together: N that differ in phase only, a Gray code's bits, or images without use."""

    style: Annotated[Style, Meta(description="the profile of the fringes; gray: a code; skip: not used")] = "sinusoidal"
    orientation: Annotated[Orientation, Meta(description="where it is not capture.orientation")] | None = None
    periods: Annotated[float, Meta(gt=0, le=65536, description="across the projector")] | None = None
    period_px: Annotated[float, Meta(gt=0, le=65536, description="instead of periods")] | None = None
    steps: Annotated[int, Meta(ge=1, le=64)] = 4
    shifts_deg: Annotated[list[float], Meta(description="of each image; 360 k / steps when left out")] | None = None
    initial_phase_rad: float = 0.0
    inverse: Annotated[bool, Meta(description="each image is followed by its complement")] = False
    bits: Annotated[int, Meta(ge=1, le=16, description="of a Gray code, the coarsest first")] | None = None
    cell_px: Annotated[float, Meta(gt=0, le=65536, description="width of a Gray code's cells")] | None = None
    offset_px: Annotated[float, Meta(description="where the first cell begins")] = 0.0
    white: Annotated[bool, Meta(description="an all-bright image follows the code")] = False
    black: Annotated[bool, Meta(description="an all-dark image follows, after the bright one")] = False


class CaptureDescription(_Table, frozen=True, kw_only=True):
    """A whole capture.toml. `sets` maps a role to a glob pattern or a list of files, in the order of the groups."""

    sets: Annotated[dict[str, str | list[str]], Meta(min_length=1)]
    group: Annotated[list[GroupTable], Meta(min_length=1, max_length=64)]
    capture: CaptureTable = CaptureTable()
    sensor: SensorTable | None = None
    board: Annotated[dict[str, Any], Meta(description="the calibration board of poses; `fringe board --toml`")] = {}

    def orientations(self) -> list[Orientation]:
        """Return what the groups count, each once, in their order."""
        used = (group.orientation or self.capture.orientation for group in self.group if group.style != "skip")
        return list(dict.fromkeys(used))


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
    problems = [
        problem
        for index, group in enumerate(described.group)
        for problem in _problems(f"group[{index}]", group, described.capture)
    ]
    problems += _wanting(described)
    if problems:
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)} in {path}:", tuple(problems))
    return described


def _problems(place: str, group: GroupTable, capture: CaptureTable) -> list[Problem]:
    if group.style == "skip":
        return []
    if group.style == "gray":
        return _gray_problems(place, group)
    found = []
    if (group.periods is None) == (group.period_px is None):
        given = "both" if group.periods is not None else "neither"
        found.append(Problem(f"{place}.periods", given, "either periods (across the projector) or period_px"))
    if group.shifts_deg is not None and len(group.shifts_deg) != group.steps:
        found.append(Problem(f"{place}.shifts_deg", f"{len(group.shifts_deg)} values", f"{group.steps}, one per step"))
    least = 1 if capture.family in SINGLE else 3
    if group.steps < least:
        found.append(Problem(f"{place}.steps", str(group.steps), f">= {least} for family {capture.family!r}"))
    if group.bits is not None or group.cell_px is not None:
        found.append(Problem(f"{place}.bits", "a code's key", 'style = "gray" with it'))
    return found


def _gray_problems(place: str, group: GroupTable) -> list[Problem]:
    found = [
        Problem(f"{place}.{key}", "nothing", "what a Gray code needs: its bits and the width of its cells in px")
        for key in ("bits", "cell_px")
        if getattr(group, key) is None
    ]
    if group.periods is not None or group.period_px is not None or group.shifts_deg is not None:
        found.append(Problem(f"{place}.periods", "a key of sinusoids", "bits and cell_px in a group of style gray"))
    return found


def _wanting(described: CaptureDescription) -> list[Problem]:
    """Return what the family needs and no group gives."""
    family, styles = described.capture.family, [group.style for group in described.group]
    coded = family.startswith("gray")
    found = []
    if coded != ("gray" in styles):
        expected = 'a group of style "gray"' if coded else f"no Gray code in family {family!r}: use gray-phase-shift"
        found.append(Problem("group", f"the styles {', '.join(dict.fromkeys(styles))}", expected))
    if family != "gray-code" and not {"sinusoidal", "sawtooth", "triangular", "trapezoidal", "binary"} & set(styles):
        found.append(Problem("group", "no fringes", f"a group of fringes for family {family!r}"))
    if described.capture.one_shot:
        frames = sum(group.steps * (1 + group.inverse) for group in described.group if group.style != "skip")
        if frames % 3:
            found.append(Problem("group", f"{frames} frames", "a multiple of 3: each colour image holds three"))
    return found
