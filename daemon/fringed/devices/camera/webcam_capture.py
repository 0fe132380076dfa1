"""A webcam's port: OpenCV's VideoCapture on V4L2, where the device is, and its controls.

Owns the paths, the format and the numbers of the controls; knows nothing of acquisition or time.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import cv2

from fringed.errors import DeviceAbsent, DeviceError

BY_ID = Path("/dev/v4l/by-id")
SELECT_TIMEOUT_S = 1  # OpenCV waits that long for a frame before `grab` says no; its own default is 10 s

EXPOSURE_UNIT_US = 100.0  # V4L2_CID_EXPOSURE_ABSOLUTE counts in these [V: the kernel's documentation]
MANUAL_EXPOSURE = 1.0  # V4L2_EXPOSURE_MANUAL [V: the kernel's header]
ALIKE = 0.25  # what a camera may make of an exposure: it has only some

Outcome = Literal["fixed", "absent", "refused"]


class Capture(Protocol):
    """What is used of `cv2.VideoCapture`, by its names."""

    def isOpened(self) -> bool:
        """Whether there is a device behind it."""
        ...

    def get(self, prop: int) -> float:
        """Return a property, 0 or less for one that it has not."""
        ...

    def set(self, prop: int, value: float) -> bool:
        """Set a property; whether it has it."""
        ...

    def grab(self) -> bool:
        """Wait for the next frame; whether there is one."""
        ...

    def retrieve(self) -> tuple[bool, Any]:
        """Return the frame that was grabbed."""
        ...

    def release(self) -> None:
        """Let go of the device."""


OpenCapture = Callable[[str], Capture]
Identify = Callable[[str], object]


def open_v4l2(path: str) -> Capture:
    """Open `path` with V4L2; the caller asks whether it is opened."""
    os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(SELECT_TIMEOUT_S))
    capture: Capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
    return capture


def identify(path: str) -> object:
    """Return what tells this plugging of a device from the next one, None where there is none."""
    try:
        status = Path(path).stat()
    except OSError:
        return None
    return (status.st_dev, status.st_ino, status.st_rdev)


def plugged_in(by_id: Path = BY_ID) -> tuple[str, ...]:
    """Return the names of the webcams that are plugged in; one that ends in -index1 or more holds no pictures."""
    return tuple(sorted(path.name for path in by_id.iterdir())) if by_id.is_dir() else ()


def find(device: str, by_id: Path = BY_ID) -> str:
    """Return the path of `device`: a path, a name below /dev/v4l/by-id, or nothing for the only one there is.

    Raises
    ------
    DeviceAbsent
        none has that name, or several could be meant; the message lists what is there.
    """
    names = plugged_in(by_id)
    there = f"plugged in are {', '.join(names)}" if names else "no webcam is plugged in"
    if device:
        path = Path(device) if device.startswith("/") else by_id / device
        if path.exists():
            return str(path)
        raise DeviceAbsent(f"the webcam {path} is not there; {there}: plug it in, or set camera.options.device")
    firsts = [name for name in names if name.endswith("-index0")] or list(
        names
    )  # a webcam's other nodes hold no pictures
    if len(firsts) == 1:
        return str(by_id / firsts[0])
    raise DeviceAbsent(f"camera.options.device names no webcam and {there}: name one of them, or a path /dev/video…")


def open_device(path: str, opener: OpenCapture) -> Capture:
    """Open the device at `path`.

    Raises
    ------
    DeviceAbsent
        no permission, taken by another program, or no camera; it says what to do.
    """
    if Path(path).exists() and not os.access(path, os.R_OK | os.W_OK):
        raise DeviceAbsent(f"no permission to open {path}: add this user to the group video, and log in again")
    capture = opener(path)
    if not capture.isOpened():
        capture.release()
        raise DeviceAbsent(
            f"{path} cannot be opened as a camera: another program has it (`fuser -v {path}` names it), or it is a "
            "node without pictures (a webcam has several; take the one that ends in -index0)"
        )
    return capture


@dataclass(frozen=True)
class Mode:
    """Size, rate and format of a webcam's frames; `fourcc` such as YUYV."""

    width_px: int
    height_px: int
    fps: float
    fourcc: str

    def __str__(self) -> str:
        return f"{self.width_px} x {self.height_px} at {self.fps:g} frames/s in {self.fourcc}"


def set_mode(capture: Capture, asked: Mode) -> Mode:
    """Set the mode and return the one in force: the rate may differ, size and format may not.

    Raises
    ------
    DeviceError
        the camera gives another size or format; it says which.
    """
    capture.set(cv2.CAP_PROP_MODE, 0.0)  # controls in the driver's own numbers
    capture.set(cv2.CAP_PROP_FOURCC, float(cv2.VideoWriter.fourcc(*asked.fourcc)))  # before the size: it limits sizes
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, float(asked.width_px))
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, float(asked.height_px))
    capture.set(cv2.CAP_PROP_FPS, asked.fps)
    seen = mode(capture)
    if (seen.width_px, seen.height_px, seen.fourcc) != (asked.width_px, asked.height_px, asked.fourcc):
        raise DeviceError(
            f"asked for {asked}, the webcam gives {seen}: set camera.options.width_px, height_px, fps and fourcc to a "
            "mode that it has (`v4l2-ctl --list-formats-ext` lists them)"
        )
    return seen if seen.fps > 0 else Mode(seen.width_px, seen.height_px, asked.fps, seen.fourcc)


def mode(capture: Capture) -> Mode:
    """Return the mode in force."""
    code = round(capture.get(cv2.CAP_PROP_FOURCC))
    fourcc = "".join(chr(code >> shift & 0xFF) for shift in (0, 8, 16, 24)).strip("\0 ") if code > 0 else "unknown"
    width, height = (round(capture.get(prop)) for prop in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    return Mode(width, height, capture.get(cv2.CAP_PROP_FPS), fourcc)


@dataclass(frozen=True)
class Control:
    """What became of one control: its name, the value asked for, the value seen."""

    name: str
    outcome: Outcome
    asked: float
    seen: float

    def __str__(self) -> str:
        if self.outcome == "absent":
            return f"it has no control of its {self.name}"
        return f"its {self.name} stays at {self.seen:g} where {self.asked:g} was asked for"


def fix(capture: Capture, name: str, prop: int, value: float, alike: float = 0.0) -> Control:
    """Set one control and read it back; a value within `alike` (relative) of the asked one is taken as set."""
    has = capture.set(prop, value)
    seen = capture.get(prop)
    if not has and seen <= 0:
        return Control(name, "absent", value, seen)
    fixed = abs(seen - value) <= max(0.5, alike * abs(value))
    return Control(name, "fixed" if fixed else "refused", value, seen)


def fix_automatics(capture: Capture) -> tuple[Control, ...]:
    """Turn off whatever the camera would change by itself."""
    return (
        fix(capture, "automatic exposure", cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL_EXPOSURE),
        fix(capture, "automatic white balance", cv2.CAP_PROP_AUTO_WB, 0.0),
        fix(capture, "automatic focus", cv2.CAP_PROP_AUTOFOCUS, 0.0),
    )


def fix_exposure(capture: Capture, exposure_us: float) -> Control:
    """Fix the exposure, as well as the camera can."""
    steps = max(1.0, round(exposure_us / EXPOSURE_UNIT_US))
    return fix(capture, "exposure (in steps of 100 us)", cv2.CAP_PROP_EXPOSURE, steps, ALIKE)


def fix_gain(capture: Capture, gain: float) -> Control:
    """Fix the gain, in the camera's own steps."""
    return fix(capture, "gain (in its own steps)", cv2.CAP_PROP_GAIN, round(gain))


def probe(capture: Capture) -> tuple[Control, ...]:
    """Turn off what is automatic, and try the other controls with the values that they have."""
    others = (("exposure", cv2.CAP_PROP_EXPOSURE), ("gain", cv2.CAP_PROP_GAIN))
    return (*fix_automatics(capture), *(fix(capture, name, prop, capture.get(prop)) for name, prop in others))
