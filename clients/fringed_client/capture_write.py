"""Write frame sets as a capture folder: PNG images, `capture.toml`, and what a simulated rig knows.

Owns the files' names; `capture_images` reads them back.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fringed.data import FrameSet, PatternFrame, Truth
from fringed.errors import DataError
from fringed_client.capture import DESCRIPTION
from fringed_client.files import make_folder, write_aside
from fringed_client.private import to_toml


def write_capture(folder: Path, frame_sets: Mapping[str, FrameSet], calibration: str = "") -> Path:
    """Write images and description; returns the description's path.

    Raises
    ------
    DataError
        the sets are of a family that a capture.toml cannot describe.
    StorageError
        the folder cannot be written.
    """
    for role, frames in frame_sets.items():
        make_folder(folder / role)
        for number, index in enumerate(_order(frames)):
            name = f"{number:02d}-group{frames.sequence.frames[index].group}.png"
            write_aside(folder / role / name, _png(frames.frames[index]))
    return write_aside(folder / DESCRIPTION, _describe(frame_sets, calibration).encode())


def write_truth(path: Path, truth: Truth) -> Path:
    """Write a truth as NPZ: xyz_mm, projector_px, visible, lit, is_object, T_camera_object."""
    buffer = io.BytesIO()
    names = ("xyz_mm", "projector_px", "visible", "lit", "is_object", "T_camera_object")
    np.savez(buffer, **{name: getattr(truth, name) for name in names}, frame_set=truth.frame_set)
    return write_aside(path, buffer.getbuffer())


def _order(frames: FrameSet) -> list[int]:
    described = frames.sequence.frames
    return sorted(range(len(described)), key=lambda i: (described[i].group, described[i].step))


def _png(image: Any) -> Any:
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 2])[1].data


def _describe(frame_sets: Mapping[str, FrameSet], calibration: str) -> str:
    any_set = next(iter(frame_sets.values()))
    sequence = any_set.sequence
    if any(frame.style != "sinusoidal" for frame in sequence.frames):
        raise DataError(f"a capture.toml describes sinusoidal fringes; these are of family {sequence.family!r}")
    capture = {
        "family": sequence.family, "orientation": sequence.frames[0].orientation,
        "projector_px": [sequence.width_px, sequence.height_px], "projected": sequence.frames[0].channel,
        "bits": any_set.settings.bits, "calibration": calibration or None, "simulated": any_set.provenance.simulated,
    }  # fmt: skip
    sets = {role: f"{role}/*.png" for role in frame_sets}
    text = f"[capture]\n{to_toml(capture)}\n[sets]\n{to_toml(sets)}"
    if any_set.settings.electrons_per_dn > 0:
        sensor = {name: getattr(any_set.settings, name) for name in ("electrons_per_dn", "read_noise_electrons")}
        text += f"\n[sensor]\n{to_toml(sensor)}"
    groups = [[sequence.frames[i] for i in members] for members in sequence.groups().values()]
    return text + "".join(f"\n[[group]]\n{to_toml(_group(group))}" for group in groups)


def _group(group: list[PatternFrame]) -> dict[str, Any]:
    ordered = sorted(group, key=lambda frame: frame.step)
    shifts = [round(float(np.rad2deg(frame.shift_rad)), 9) for frame in ordered]
    usual = np.allclose(shifts, [360.0 * k / len(shifts) for k in range(len(shifts))], atol=1e-6)
    return {
        "period_px": ordered[0].period_px, "steps": len(ordered), "shifts_deg": None if usual else shifts,
        "initial_phase_rad": ordered[0].initial_phase_rad or None,
    }  # fmt: skip
