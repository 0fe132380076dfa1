"""Patterns as files: the exact pictures that a projector is sent, and a description of each frame.

Owns the names and the description; knows no station and draws nothing else.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from fringed.data import PatternSequence, UInt8Array
from fringed_client.files import make_folder, write_aside

DESCRIPTION = "patterns.json"


def full_picture(sequence: PatternSequence, index: int) -> UInt8Array:
    """Return pattern `index` as the projector shows it: (height, width, 1 or 3), red first."""
    pattern = sequence.patterns[index]
    whole = (sequence.height_px, sequence.width_px, pattern.shape[2])
    return np.ascontiguousarray(np.broadcast_to(pattern, whole))


def file_names(sequence: PatternSequence) -> list[str]:
    """Return the file name of each frame's picture; frames of one shot share theirs."""
    names: list[str] = []
    shots: dict[int, str] = {}
    for index, frame in enumerate(sequence.frames):
        own = f"pattern-{index:03d}.png"
        names.append(shots.setdefault(frame.shot, own) if frame.shot >= 0 else own)
    return names


def describe(sequence: PatternSequence) -> dict[str, Any]:
    """Return everything but the pixels, as JSON can hold it."""
    told = msgspec.to_builtins(sequence.frames)
    return {
        "encoder": sequence.encoder, "encoder_version": sequence.encoder_version,
        "parameters": msgspec.to_builtins(dict(sequence.parameters), enc_hook=str),
        "width_px": sequence.width_px, "height_px": sequence.height_px,
        "grey_low": sequence.grey_low, "grey_high": sequence.grey_high, "precompensated": sequence.precompensated,
        "frames": [{"file": name, **frame} for name, frame in zip(file_names(sequence), told, strict=True)],
    }  # fmt: skip


def group_rows(sequence: PatternSequence) -> list[dict[str, Any]]:
    """Return one row for each group of frames: what its frames have in common, and their shifts in degrees."""
    rows = []
    for group, indices in sequence.groups().items():
        frames = [sequence.frames[i] for i in indices]
        first = frames[0]
        rows.append({
            "group": group, "style": first.style, "orientation": first.orientation, "period_px": first.period_px,
            "frames": len(frames), "inverted": sum(frame.inverted for frame in frames), "level": first.level,
            "channel": ", ".join(dict.fromkeys(frame.channel for frame in frames)),
            "shifts_deg": [round(float(np.degrees(frame.shift_rad)), 3) for frame in frames],
            "bits": [frame.bit for frame in frames if frame.bit >= 0],
        })  # fmt: skip
    return rows


def write_patterns(folder: Path, sequence: PatternSequence) -> list[Path]:
    """Write every picture as PNG, and their description; returns the paths.

    Raises
    ------
    StorageError
        the folder cannot be made or written.
    """
    make_folder(folder)
    written = []
    for index, name in enumerate(file_names(sequence)):
        path = folder / name
        if path not in written:
            picture = full_picture(sequence, index)[..., ::-1]
            written.append(write_aside(path, cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 7])[1].data))
    text = json.dumps(describe(sequence), indent=2, ensure_ascii=False)
    return [*written, write_aside(folder / DESCRIPTION, text.encode())]
