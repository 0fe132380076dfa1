"""A capture that behaves like OpenCV's on V4L2: paced, losing frames, of a wrong size, silent, taken, unplugged."""

import threading
import time
from dataclasses import dataclass, field

import cv2
import numpy as np

from fringed.config import validate
from fringed.devices.camera.base import MachineClock
from fringed.devices.camera.webcam import WebcamCamera, WebcamOptions

WIDTH, HEIGHT = 32, 24
PERIOD_S = 0.005
VALUES = 200  # a frame's brightness is its number, modulo this
QUEUED = 4  # frames that wait for who grabs late
CONTROLS = {
    cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
    cv2.CAP_PROP_EXPOSURE: 157.0,
    cv2.CAP_PROP_GAIN: 10.0,
    cv2.CAP_PROP_AUTO_WB: 1.0,
    cv2.CAP_PROP_AUTOFOCUS: 1.0,
}


def fourcc(text):
    return float(cv2.VideoWriter.fourcc(*text))


@dataclass
class Webcam:
    """A webcam on a desk: what it can do, and what happens to it."""

    path: str
    sizes: tuple = ((WIDTH, HEIGHT), (64, 48))
    formats: tuple = ("YUYV", "MJPG")
    plugging: int = 1  # 0 is unplugged
    silent: bool = False
    taken: bool = False
    stamps: bool = True
    frozen: frozenset = frozenset()  # controls that stay as they are
    controls: dict = field(default_factory=lambda: dict(CONTROLS))
    wrong_size: tuple | None = None
    undecodable: bool = False
    lose: int = 0  # frames on the way to the next grab
    scene: object = None  # (start, end of an exposure) -> brightness; without one it is the frame's number
    exposure_s: float = 0.002
    stamp_marks: str = "frame-end"  # its rows are read for a whole period, one after the other
    opened: list = field(default_factory=list)

    def open(self, path):
        assert path == self.path
        capture = Capture(self)
        self.opened.append(capture)
        return capture

    def plugging_of(self, path):
        return self.plugging or None


class Capture:
    """What `cv2.VideoCapture` does on V4L2."""

    def __init__(self, webcam):
        self.webcam, self.plugging = webcam, 0 if webcam.taken else webcam.plugging
        self.asked = {cv2.CAP_PROP_FRAME_WIDTH: 64.0, cv2.CAP_PROP_FRAME_HEIGHT: 48.0}
        self.props = {
            cv2.CAP_PROP_FRAME_WIDTH: 64.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 48.0,
            cv2.CAP_PROP_FPS: 1 / PERIOD_S,
            cv2.CAP_PROP_FOURCC: fourcc("YUYV"),
            cv2.CAP_PROP_CONVERT_RGB: 1.0,
        }
        self.frame, self.stamp_s, self.start_s, self.inside, self.released = 0, 0.0, 0.0, threading.Lock(), False
        self.due_s = time.monotonic()

    def isOpened(self):
        return bool(self.plugging) and self.plugging == self.webcam.plugging and not self.released

    def get(self, prop):
        if prop == cv2.CAP_PROP_POS_MSEC:
            return self.stamp_s * 1e3 if self.webcam.stamps else 0.0
        return self.props.get(prop, self.webcam.controls.get(prop, -1.0))

    def set(self, prop, value):
        if prop in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT):
            self.asked[prop] = value
            size = tuple(self.asked.values())
            if size in self.webcam.sizes:
                self.props.update(self.asked)
            return True
        if prop == cv2.CAP_PROP_FOURCC:
            if value in map(fourcc, self.webcam.formats):
                self.props[prop] = value
            return value == self.props[prop]
        if prop == cv2.CAP_PROP_CONVERT_RGB:
            self.props[prop] = value
            return True
        if prop in self.webcam.controls:
            if prop not in self.webcam.frozen:
                self.webcam.controls[prop] = float(round(value))
            return True
        return prop in (cv2.CAP_PROP_MODE, cv2.CAP_PROP_FPS)

    def grab(self):
        assert not self.released, "a released capture was used"
        with self.inside:
            if self.webcam.silent:
                time.sleep(0.05)
                return False
            late = int((time.monotonic() - self.due_s) / PERIOD_S) - QUEUED
            lost, self.webcam.lose = max(0, late) + self.webcam.lose, 0
            self.frame, self.due_s = self.frame + 1 + lost, self.due_s + (1 + lost) * PERIOD_S
            time.sleep(max(0.0, self.due_s - time.monotonic()))
            if not self.isOpened():
                return False
            self.start_s = self.due_s - PERIOD_S - self.webcam.exposure_s
            begun_s = PERIOD_S + self.webcam.exposure_s
            before_s = {"frame-end": 0.0, "readout-start": PERIOD_S, "exposure-start": begun_s}
            self.stamp_s = self.due_s - before_s[self.webcam.stamp_marks]
            return True

    def retrieve(self):
        if self.webcam.undecodable:
            return False, None
        width, height = self.webcam.wrong_size or (WIDTH, HEIGHT)
        value = self.webcam.scene(self.start_s, self.due_s) if self.webcam.scene else self.frame % VALUES
        if self.props[cv2.CAP_PROP_CONVERT_RGB]:
            return True, np.full((height, width, 3), (10, 20, value), np.uint8)
        return True, np.stack([np.full((height, width), value, np.uint8), np.full((height, width), 128, np.uint8)], 2)

    def release(self):
        assert not self.inside.locked(), "released while a frame is grabbed"
        self.released = True


def driver(webcam, **options):
    options = {"device": webcam.path, "width_px": WIDTH, "height_px": HEIGHT, "fps": 1 / PERIOD_S, **options}
    return WebcamCamera(
        validate(options, WebcamOptions, "camera.options"), MachineClock(), webcam.open, webcam.plugging_of
    )
