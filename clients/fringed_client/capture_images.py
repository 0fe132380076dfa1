"""Read the images of a capture folder, and tell everything that is wrong with them before anything is processed.

Owns files, order, sizes and depths; what the images mean is in `capture`.
"""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from fringed.data import Array, CameraSettings, FrameSet, Provenance
from fringed.errors import ConfigurationError, Problem
from fringed_client.capture import DESCRIPTION, CaptureDescription, load_description
from fringed_client.capture_patterns import COLOURS, sequence_of, used_images

_CHANNELS = {"blue": 0, "green": 1, "red": 2}  # OpenCV's order


def load_capture(folder: Path, only: str = "") -> tuple[CaptureDescription, dict[str, FrameSet]]:
    """Read a capture folder: its description, and a FrameSet for each role, or for that one only.

    Raises
    ------
    ConfigurationError
        with every missing, extra, unreadable, differently sized or differently deep image.
    """
    described = load_description(folder)
    sequence = sequence_of(described)
    problems: list[Problem] = []
    used, place = used_images(described), folder / described.capture.images
    wanted = {role: pattern for role, pattern in described.sets.items() if only in ("", role)}
    files = {role: _files(place, role, pattern, used, problems) for role, pattern in wanted.items()}
    images = {role: [_read(path, place, described, problems) for path in paths] for role, paths in files.items()}
    _compare(images, files, place, problems)
    if problems:
        raise ConfigurationError(
            f"{len(problems)} problem{'s' * (len(problems) > 1)} with the images of {folder / DESCRIPTION}:",
            tuple(problems),
        )
    settings = _settings(described, images)
    provenance = Provenance(plugin=DESCRIPTION, rig=described.capture.rig, simulated=described.capture.simulated)
    return described, {
        role: FrameSet(
            _stacked(kept, described.capture.one_shot), sequence, role, settings=settings, provenance=provenance
        )
        for role, kept in images.items()
    }


def _stacked(images: list[Array | None], colour: bool) -> Array:
    """Return the frames (n, height, width); a colour image gives three, red first."""
    there = [image for image in images if image is not None]
    if not colour:
        return np.stack(there)
    return np.stack([image[..., _CHANNELS[name]] for image in there for name in COLOURS])


def _files(folder: Path, role: str, pattern: str | list[str], used: list[bool], problems: list[Problem]) -> list[Path]:
    if isinstance(pattern, list):
        files = [folder / name for name in pattern]
        problems += [
            Problem(f"sets.{role}", f"{p.relative_to(folder)} is missing; it", "an existing image")
            for p in files
            if not p.is_file()
        ]
        files = [path for path in files if path.is_file()]
        given = len(pattern)
    else:
        files = sorted((p for p in folder.glob(pattern) if p.is_file()), key=_natural)
        given = len(files)
    wanted = len(used)
    if given == wanted == len(files):
        return [path for path, wants in zip(files, used, strict=True) if wants]
    if given != wanted:
        what = "missing" if given < wanted else "too many"
        problems.append(
            Problem(f"sets.{role}", f"{given} images ({pattern if isinstance(pattern, str) else 'listed'}), "
                    f"{abs(wanted - given)} {what},", f"{wanted}: one for each image of each group")
        )  # fmt: skip
    return files


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort `2.png` before `10.png`."""
    parts = re.split(r"(\d+)", str(path))
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]


def _read(path: Path, folder: Path, described: CaptureDescription, problems: list[Problem]) -> Array | None:
    name = str(path.relative_to(folder))
    raw = np.fromfile(path, np.uint8)
    image = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED) if raw.size else None
    if image is None:
        problems.append(Problem(name, f"a file of {raw.size} bytes that is no image", "PNG, TIFF, BMP, JPEG or PGM"))
        return None
    if image.dtype not in (np.uint8, np.uint16):
        problems.append(Problem(name, f"{image.dtype} pixels", "8 or 16 bits without sign"))
        return None
    if described.capture.one_shot:
        if image.ndim == 3:
            return np.ascontiguousarray(image[..., :3])
        problems.append(Problem(name, "a grey image", "a colour image: its channels carry the frames of one shot"))
        return None
    if image.ndim == 2:
        return image
    if described.capture.channel == "mean":
        return np.asarray(image[..., :3].mean(axis=2, dtype=np.float32).round().astype(image.dtype))
    return np.ascontiguousarray(image[..., _CHANNELS[described.capture.channel]])


def _compare(
    images: dict[str, list[Array | None]], files: dict[str, list[Path]], folder: Path, problems: list[Problem]
) -> None:
    pairs = [(p, i) for role in images for p, i in zip(files[role], images[role], strict=True) if i is not None]
    if not pairs:
        return
    shapes, types = [image.shape for _, image in pairs], [image.dtype for _, image in pairs]
    usual = (max(shapes, key=shapes.count), max(types, key=types.count))  # the first one where numbers are equal
    for path, image in pairs:
        name = str(path.relative_to(folder))
        if image.shape != usual[0]:
            expected = f"{usual[0][1]} x {usual[0][0]}, as the others"
            problems.append(Problem(name, f"{image.shape[1]} x {image.shape[0]} pixels", expected))
        if image.dtype != usual[1]:
            problems.append(
                Problem(name, f"{image.dtype.itemsize * 8}-bit pixels", f"{usual[1].itemsize * 8}-bit, as the others")
            )


def _settings(described: CaptureDescription, images: dict[str, list[Array | None]]) -> CameraSettings:
    deep = any(image is not None and image.dtype == np.uint16 for kept in images.values() for image in kept)
    bits = described.capture.bits or (16 if deep else 8)
    sensor = described.sensor
    return CameraSettings(
        bits=bits,
        electrons_per_dn=sensor.electrons_per_dn if sensor else 0.0,
        read_noise_electrons=sensor.read_noise_electrons if sensor else 0.0,
    )
