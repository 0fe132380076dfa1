"""Write frame sets as a capture folder: PNG images, `capture.toml`, and what a simulated rig knows.

Owns the files' names; `capture_images` reads them back.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np

from fringed.data import FrameSet, PatternFrame, Truth
from fringed.errors import DataError
from fringed_client.capture import DESCRIPTION, Style
from fringed_client.capture_patterns import COLOURS
from fringed_client.files import make_folder, write_aside
from fringed_client.private import to_toml


def write_capture(
    folder: Path, frame_sets: Mapping[str, FrameSet], calibration: str = "", board: Mapping[str, Any] | None = None
) -> Path:
    """Write images and description, and the board of poses; returns the description's path.

    Raises
    ------
    DataError
        the sets are of a family that a capture.toml cannot describe.
    StorageError
        the folder cannot be written.
    """
    text = _describe(frame_sets, calibration) + (f"\n[board]\n{to_toml(board)}" if board else "")
    for role, frames in frame_sets.items():
        make_folder(folder / role)
        for number, indices in enumerate(_images(frames)):
            name = f"{number:02d}-group{frames.sequence.frames[indices[0]].group}.png"
            write_aside(folder / role / name, _png(frames.frames[indices]))
    return write_aside(folder / DESCRIPTION, text.encode())


def write_truth(path: Path, truth: Truth) -> Path:
    """Write a truth as NPZ: xyz_mm, projector_px, visible, lit, is_object, T_camera_object."""
    buffer = io.BytesIO()
    names = ("xyz_mm", "projector_px", "visible", "lit", "is_object", "T_camera_object")
    np.savez(buffer, **{name: getattr(truth, name) for name in names}, frame_set=truth.frame_set)
    return write_aside(path, buffer.getbuffer())


def _images(frames: FrameSet) -> list[list[int]]:
    """Return the frames of each image: one, or the three of a shot; groups together, a code's bits in order."""
    described = frames.sequence.frames

    def place(i: int) -> tuple[int, int, bool]:
        frame = described[i]
        last = frame.style == "gray" and frame.bit < 0
        return frame.group, frame.steps if last else frame.step, frame.inverted

    order = sorted(range(len(described)), key=place)
    if all(frame.shot < 0 for frame in described):
        return [[i] for i in order]
    shots = sorted({frame.shot for frame in described})
    return [
        [next(i for i in order if (described[i].shot, described[i].channel) == (s, c)) for c in COLOURS] for s in shots
    ]


def _png(image: Any) -> Any:
    """Return one frame, or three as the red, green and blue of one picture, as PNG."""
    picture = image[0] if len(image) == 1 else np.ascontiguousarray(image[::-1].transpose(1, 2, 0))
    return cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 2])[1].data


def _describe(frame_sets: Mapping[str, FrameSet], calibration: str) -> str:
    any_set = next(iter(frame_sets.values()))
    sequence = any_set.sequence
    styles = {frame.style for frame in sequence.frames}
    unknown = sorted(styles - set(get_args(Style))) + sorted(
        {"several levels" for f in sequence.frames if f.level != 1}
    )
    if unknown:
        raise DataError(
            f"a capture.toml describes fringes and Gray codes; these patterns of family {sequence.family!r} have "
            f"{', '.join(unknown)}: export the frame set as a recording instead (`fringe get ID -o set.h5`)"
        )
    orientation = sequence.frames[0].orientation
    capture = {
        "family": sequence.family, "orientation": orientation,
        "projector_px": [sequence.width_px, sequence.height_px],
        "projected": None if sequence.frames[0].shot >= 0 else sequence.frames[0].channel,
        "bits": any_set.settings.bits, "calibration": calibration or None, "simulated": any_set.provenance.simulated,
        "rig": any_set.provenance.rig or None,
    }  # fmt: skip
    sets = {role: f"{role}/*.png" for role in frame_sets}
    text = f"[capture]\n{to_toml(capture)}\n[sets]\n{to_toml(sets)}"
    if any_set.settings.electrons_per_dn > 0:
        sensor = {name: getattr(any_set.settings, name) for name in ("electrons_per_dn", "read_noise_electrons")}
        text += f"\n[sensor]\n{to_toml(sensor)}"
    groups = [[sequence.frames[i] for i in members] for _, members in sorted(sequence.groups().items())]
    return text + "".join(f"\n[[group]]\n{to_toml(_group(group, orientation))}" for group in groups)


def _group(group: list[PatternFrame], usual: str) -> dict[str, Any]:
    first = group[0]
    common = {
        "style": None if first.style == "sinusoidal" else first.style,
        "orientation": None if first.orientation == usual else first.orientation,
        "inverse": any(frame.inverted and (first.style != "gray" or frame.bit >= 0) for frame in group) or None,
    }
    return common | (_code(group) if first.style == "gray" else _fringes(group))


def _fringes(group: list[PatternFrame]) -> dict[str, Any]:
    ordered = sorted((frame for frame in group if not frame.inverted), key=lambda frame: frame.step)
    shifts = [round(float(np.rad2deg(frame.shift_rad)), 9) for frame in ordered]
    usual = np.allclose(shifts, [360.0 * k / len(shifts) for k in range(len(shifts))], atol=1e-6)
    return {
        "period_px": ordered[0].period_px, "steps": len(ordered), "shifts_deg": None if usual else shifts,
        "initial_phase_rad": ordered[0].initial_phase_rad or None,
    }  # fmt: skip


def _code(group: list[PatternFrame]) -> dict[str, Any]:
    cell_px = group[0].period_px / 2
    offset_px = round(0.5 - group[0].initial_phase_rad * cell_px / np.pi, 9)
    plain = [frame for frame in group if frame.bit < 0]
    return {
        "bits": 1 + max(frame.bit for frame in group), "cell_px": cell_px, "offset_px": offset_px or None,
        "white": any(not frame.inverted for frame in plain) or None,
        "black": any(frame.inverted for frame in plain) or None,
    }  # fmt: skip
