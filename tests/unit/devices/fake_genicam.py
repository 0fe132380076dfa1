"""A GenICam camera in memory: features with limits that hold, and buffers as a library delivers them."""

import time
from dataclasses import dataclass, field

import numpy as np

from fringed.devices.camera.gige_pixels import BY_NAME
from fringed.devices.camera.gige_port import Delivery, FeatureError
from fringed.errors import DeviceAbsent


@dataclass
class Feature:
    """One feature: its value, and its limits or entries."""

    value: object
    limits: tuple = ()
    entries: tuple = ()
    stuck: bool = False


def modern():
    """A monochrome camera of today, by the names of the standard."""
    return {
        "PixelFormat": Feature("Mono8", entries=("Mono8", "Mono10p", "Mono12", "Mono12p", "Mono12Packed")),
        "Width": Feature(1280, (16, 1280)),
        "Height": Feature(1024, (16, 1024)),
        "WidthMax": Feature(1280),
        "OffsetX": Feature(64, (0, 1264)),
        "OffsetY": Feature(32, (0, 1008)),
        "ExposureAuto": Feature("Continuous", entries=("Off", "Continuous")),
        "GainAuto": Feature("Continuous", entries=("Off", "Continuous")),
        "ExposureMode": Feature("TriggerWidth", entries=("Timed", "TriggerWidth")),
        "ExposureTime": Feature(15000.0, (20.0, 1e6)),
        "GainSelector": Feature("DigitalAll", entries=("All", "DigitalAll")),
        "Gain": Feature(6.0, (0.0, 24.0)),
        "Gamma": Feature(0.45, (0.25, 4.0)),
        "AcquisitionMode": Feature("SingleFrame", entries=("SingleFrame", "Continuous")),
        "AcquisitionFrameRateEnable": Feature(False),
        "AcquisitionFrameRate": Feature(40.0, (1.0, 100.0)),
        "ResultingFrameRate": Feature(40.0),
        "TriggerSelector": Feature("FrameStart", entries=("AcquisitionStart", "FrameStart")),
        "TriggerMode": Feature("On", entries=("Off", "On")),
        "TriggerSource": Feature("Line0", entries=("Software", "Line0", "Line1")),
    }


@dataclass
class Genicam:
    """A port with a camera in memory behind it: what is queued in `coming` is popped."""

    features: dict = field(default_factory=modern)
    coming: list = field(default_factory=list)
    executed: list = field(default_factory=list)
    lost_packets: int = 0
    plugged: bool = True
    is_open: bool = False
    streams: int = 0

    def open(self, device):
        if not self.plugged:
            raise DeviceAbsent("no camera")
        self.is_open = True
        return f"Maker Model {device or 'only'}"

    def close(self):
        self.is_open = False
        self.streams = 0

    def alive(self):
        return self.plugged and self.is_open

    def has(self, feature):
        return feature in self.features

    def choices(self, feature):
        return self._of(feature).entries

    def text(self, feature):
        return str(self._of(feature).value)

    def number(self, feature, whole=False):
        return float(self._of(feature).value)

    def limits(self, feature, whole=False):
        return self._of(feature).limits

    def put(self, feature, value):
        found = self._of(feature)
        if found.entries and value not in found.entries:
            raise FeatureError(f"[{feature}] '{value}' not an entry")
        if found.limits and not found.limits[0] <= value <= found.limits[1]:
            raise FeatureError(f"[{feature}] out of range")
        assert not self.streams or feature.startswith("Trigger"), "set while streaming"
        if not found.stuck:
            found.value = value

    def execute(self, command):
        self.executed.append(command)

    def start(self, buffers):
        self.streams += 1

    def stop(self):
        self.streams = 0

    def pop(self, timeout_s):
        assert self.streams == 1
        if self.coming:
            return self.coming.pop(0)
        time.sleep(min(timeout_s, 0.01))
        return None

    def statistics(self):
        return {"missing_packets": self.lost_packets, "received_packets": 1000}

    def _of(self, feature):
        if feature not in self.features:
            raise FeatureError(f"[{feature}] Not found")
        return self.features[feature]


def buffer(frame_id, image=None, status=0, stamp_ns=0, arrived_s=None, form="Mono8", size_px=None):
    """Return a buffer as it comes; `image` are the bytes."""
    data = np.zeros(0, np.uint8) if image is None else np.ascontiguousarray(image).view(np.uint8).reshape(-1)
    size = size_px or ((0, 0) if image is None else (image.shape[1], image.shape[0]))
    code = BY_NAME[form].code
    return Delivery(data, size, code, status, frame_id, stamp_ns, time.monotonic() if arrived_s is None else arrived_s)
