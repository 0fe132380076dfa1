"""What a capture.toml means: the frames of its images, and the patterns that they show.

Owns the order of frames and the lines that were projected, as far as the description tells; knows no files.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import pi

import msgspec
import numpy as np

from fringed.data import Channel, Float64Array, PatternFrame, PatternSequence, UInt8Array
from fringed_client.capture import DESCRIPTION, CaptureDescription, GroupTable

COLOURS: tuple[Channel, ...] = ("red", "green", "blue")


def sequence_of(described: CaptureDescription) -> PatternSequence:
    """Return the sequence that the description stands for, its patterns computed from it."""
    width, height = described.capture.projector_px
    frames = [frame for frame in _frames(described) if frame is not None]
    lines = [_line(frame, width if frame.orientation == "columns" else height) for frame in frames]
    if described.capture.one_shot:
        frames = [replace(frame, shot=i // 3, channel=COLOURS[i % 3]) for i, frame in enumerate(frames)]
        lines = [np.concatenate(lines[3 * (i // 3) : 3 * (i // 3) + 3], axis=2) for i in range(len(lines))]
    return PatternSequence(
        family=described.capture.family,
        width_px=width,
        height_px=height,
        frames=tuple(frames),
        patterns=tuple(lines),
        encoder=DESCRIPTION,
        parameters=msgspec.to_builtins(described.group[0]) | {"groups": len(described.group)},
    )


def used_images(described: CaptureDescription) -> list[bool]:
    """Tell for each image of a set, in order, whether it is used."""
    used = [frame is not None for frame in _frames(described)]
    return used[::3] if described.capture.one_shot else used


def _frames(described: CaptureDescription) -> Iterator[PatternFrame | None]:
    """Yield a frame for each image (for each third of one where a shot holds three); None where it is not used."""
    number = 0
    for group in described.group:
        if group.style == "skip":
            yield from [None] * (group.steps * (3 if described.capture.one_shot else 1))
            continue
        yield from (_gray if group.style == "gray" else _fringes)(described, number, group)
        number += 1


def _fringes(described: CaptureDescription, number: int, group: GroupTable) -> Iterator[PatternFrame]:
    orientation = group.orientation or described.capture.orientation
    length = described.capture.projector_px[0 if orientation == "columns" else 1]
    shifts = group.shifts_deg or [360.0 * step / group.steps for step in range(group.steps)]
    for step, shift in enumerate(shifts):
        frame = PatternFrame(
            style=group.style,
            orientation=orientation,
            period_px=group.period_px or length / float(group.periods or 1),
            shift_rad=float(np.deg2rad(shift)),
            initial_phase_rad=group.initial_phase_rad,
            step=step,
            steps=group.steps,
            group=number,
            channel=described.capture.projected,
        )
        yield frame
        if group.inverse:
            yield replace(frame, shift_rad=frame.shift_rad + pi, inverted=True)


def _gray(described: CaptureDescription, number: int, group: GroupTable) -> Iterator[PatternFrame]:
    """Yield a code's frames; what their period and initial phase say is in docs/methods/temporal-unwrapping.md."""
    bits, cell_px = int(group.bits or 1), float(group.cell_px or 1)
    common = PatternFrame(
        style="gray",
        orientation=group.orientation or described.capture.orientation,
        period_px=2 * cell_px,
        initial_phase_rad=-pi * (group.offset_px - 0.5) / cell_px,
        steps=bits,
        group=number,
        channel=described.capture.projected,
    )
    for bit in range(bits):
        yield replace(common, step=bit, bit=bit)
        if group.inverse:
            yield replace(common, step=bit, bit=bit, inverted=True)
    if group.white:
        yield replace(common, step=bits)
    if group.black:
        yield replace(common, step=bits, inverted=True)


def _line(frame: PatternFrame, length: int) -> UInt8Array:
    u = np.arange(length, dtype=np.float64)
    light = _code(frame, u) if frame.style == "gray" else _profile(frame, u)
    row: UInt8Array = np.rint(255 * light).astype(np.uint8)
    return row.reshape((1, -1, 1) if frame.orientation == "columns" else (-1, 1, 1))


def _code(frame: PatternFrame, u: Float64Array) -> Float64Array:
    cells = np.floor((2 * pi * u / frame.period_px + frame.initial_phase_rad) / pi).astype(np.int64)
    gray = cells ^ (cells >> 1)
    bright = (gray >> (frame.steps - 1 - frame.bit)) & 1 if frame.bit >= 0 else np.ones_like(gray)
    return np.asarray(1.0 - bright if frame.inverted else bright, np.float64)


def _profile(frame: PatternFrame, u: Float64Array) -> Float64Array:
    """Return relative light 0 to 1 of a profile whose fundamental is the frame's cosine."""
    phase = 2 * pi * u / frame.period_px + frame.initial_phase_rad + frame.shift_rad
    wave = np.cos(phase)
    ramp = 1 - 2 * np.abs(np.angle(np.exp(1j * phase))) / pi  # 1 at phase 0, -1 at pi
    shapes = {
        "sinusoidal": wave,
        "binary": np.where(wave >= 0, 1.0, -1.0),
        "triangular": ramp,
        "trapezoidal": np.clip(1.5 * ramp, -1, 1),
        "sawtooth": 2 * ((phase / (2 * pi) - 0.25) % 1.0) - 1,
    }
    return np.asarray((1 + shapes[frame.style]) / 2, np.float64)
