"""Put a GenICam camera into the settings that are asked for: features by their standard names.

Owns the names (SFNC, and those from before it), the limits, and what of a camera has to be off so that it measures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from fringed.data import CameraSettings
from fringed.devices.camera.gige_pixels import PixelFormat, choose
from fringed.devices.camera.gige_port import FeatureError, GenicamPort
from fringed.errors import DeviceError, UsageError

AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")
EXPOSURES = (("ExposureTime", False), ("ExposureTimeAbs", False), ("ExposureTimeRaw", True))  # name, whether whole
RATES = ("ResultingFrameRate", "AcquisitionResultingFrameRate", "ResultingFrameRateAbs")
RATE, RATE_BEFORE = "AcquisitionFrameRate", "AcquisitionFrameRateAbs"
SHORTEST_PERIOD_S = 1e-3
ALIKE = 0.05  # what a camera may make of an exposure


@dataclass(frozen=True)
class Region:
    """The part of the sensor that is read; 0 for width and height: all of it."""

    width_px: int = 0
    height_px: int = 0
    x_px: int = 0
    y_px: int = 0


@dataclass(frozen=True)
class Wishes:
    """What is asked for beside `CameraSettings`."""

    region: Region = Region()
    fps: float = 0.0
    trigger_line: str = "Line1"
    gain_step_db: float = 0.0


@dataclass(frozen=True)
class InForce:
    """What the camera is set to."""

    settings: CameraSettings
    form: PixelFormat
    size_px: tuple[int, int]
    period_s: float


def apply(port: GenicamPort, settings: CameraSettings, wishes: Wishes) -> InForce:
    """Set the camera and return what is in force.

    Raises
    ------
    UsageError
        a value that the camera cannot have; it says which it can.
    DeviceError
        a feature that does not take its value.
    """
    turn_automatics_off(port)
    form, channel = choose(port.choices("PixelFormat"), settings.bits, settings.channel)
    _put(port, "PixelFormat", form.name)
    size_px = set_region(port, wishes.region)
    set_trigger(port, settings.trigger, wishes.trigger_line)
    exposure_us = set_exposure(port, settings.exposure_us)
    set_gain(port, settings.gain_db, wishes.gain_step_db)
    period_s = set_rate(port, wishes.fps, settings.trigger == "free-running", exposure_us * 1e-6)
    return InForce(replace(settings, exposure_us=exposure_us, channel=channel), form, size_px, period_s)


def turn_automatics_off(port: GenicamPort) -> None:
    """Turn off whatever the camera would change by itself, and what bends its response."""
    for name in AUTOMATICS:
        if port.has(name):
            _put(port, name, "Off")
    if port.has("ExposureMode"):
        _put(port, "ExposureMode", "Timed")
    if port.has("GammaEnable"):
        _put(port, "GammaEnable", False)
    elif port.has("Gamma"):
        _put(port, "Gamma", 1.0)
    if port.has("AcquisitionMode"):
        _put(port, "AcquisitionMode", "Continuous")


def set_region(port: GenicamPort, region: Region) -> tuple[int, int]:
    """Set the region and return width and height as the camera has them; raises UsageError for one it cannot have."""
    for name in ("OffsetX", "OffsetY"):
        if port.has(name):
            _put(port, name, 0)  # a wide region does not fit beside an offset
    for name, wanted in (("Width", region.width_px), ("Height", region.height_px)):
        low, high = _size_limits(port, name)
        if wanted and not low <= wanted <= high:
            raise UsageError(f"a {name} of {wanted} was asked for; the camera has {low:g} to {high:g}")
        _put(port, name, int(wanted or high))
    for name, offset in (("OffsetX", region.x_px), ("OffsetY", region.y_px)):
        if offset:
            _put(port, name, offset)
    seen = tuple(int(port.number(name, whole=True)) for name in ("Width", "Height"))
    asked = (region.width_px or seen[0], region.height_px or seen[1])
    if seen != asked:
        raise UsageError(
            f"{asked[0]} x {asked[1]} pixels were asked for, the camera makes it {seen[0]} x {seen[1]}: ask for that"
        )
    return seen[0], seen[1]


def set_trigger(port: GenicamPort, trigger: str, line: str) -> None:
    """Let it run free, or wait for a trigger of its own software or of `line`."""
    if not port.has("TriggerMode"):
        if trigger != "free-running":
            raise UsageError(
                f"the camera has no trigger ({trigger!r} was asked for): set camera.trigger to free-running"
            )
        return
    selectors = port.choices("TriggerSelector") if port.has("TriggerSelector") else ("",)
    for selector in selectors:
        if selector:
            _put(port, "TriggerSelector", selector)
        if port.has("TriggerMode"):
            _put(port, "TriggerMode", "Off")
    if trigger == "free-running":
        return
    source = "Software" if trigger == "software" else line
    if "FrameStart" in selectors:
        _put(port, "TriggerSelector", "FrameStart")
    sources = port.choices("TriggerSource")
    if source not in sources:
        raise UsageError(
            f"the camera cannot be triggered by {source!r}; it has {', '.join(sources)}: set camera.trigger, or "
            "camera.options.trigger_line for the line that the cable is on"
        )
    _put(port, "TriggerSource", source)
    _put(port, "TriggerMode", "On")


def set_exposure(port: GenicamPort, exposure_us: float) -> float:
    """Set the exposure and return it as the camera has it, in microseconds."""
    name, whole = next(((n, w) for n, w in EXPOSURES if port.has(n)), ("", False))
    if not name:
        raise DeviceError(f"the camera has none of {', '.join(n for n, _ in EXPOSURES)}: its exposure cannot be set")
    _within(port, name, whole, exposure_us, "us", "camera.exposure_us")
    _put(port, name, round(exposure_us) if whole else float(exposure_us))
    seen = port.number(name, whole)
    if abs(seen - exposure_us) > ALIKE * exposure_us:
        raise DeviceError(
            f"an exposure of {exposure_us:g} us was asked for, the camera makes it {seen:g} us: ask for that"
        )
    return seen


def set_gain(port: GenicamPort, gain_db: float, step_db: float) -> None:
    """Set the gain; one that counts in steps needs `step_db`, but for its least value, which is taken as 0 dB [A]."""
    if port.has("GainSelector"):
        entries = port.choices("GainSelector")
        _put(port, "GainSelector", next((name for name in ("All", "AnalogAll") if name in entries), entries[0]))
    if port.has("Gain"):
        _within(port, "Gain", False, gain_db, "dB", "camera.gain_db")
        _put(port, "Gain", float(gain_db))
        return
    if not port.has("GainRaw"):
        if gain_db:
            raise UsageError(f"the camera has no gain ({gain_db:g} dB was asked for): set camera.gain_db to 0")
        return
    if gain_db and not step_db:
        raise UsageError(
            f"a gain of {gain_db:g} dB was asked for, and the camera counts its gain in steps of its own: set "
            "camera.options.gain_step_db to what its manual says of one step, or camera.gain_db to 0"
        )
    steps = port.limits("GainRaw", whole=True)[0] + (round(gain_db / step_db) if gain_db else 0)
    _within(port, "GainRaw", True, steps, "steps", "camera.gain_db")
    _put(port, "GainRaw", int(steps))


def set_rate(port: GenicamPort, fps: float, free: bool, exposure_s: float) -> float:
    """Set the frame rate where one is asked for; return the shortest time from frame to frame, in seconds."""
    name = next((n for n in (RATE, RATE_BEFORE) if port.has(n)), "")
    if free and fps:
        if port.has("AcquisitionFrameRateEnable"):
            _put(port, "AcquisitionFrameRateEnable", True)
            name = next((n for n in (RATE, RATE_BEFORE) if port.has(n)), "")
        if not name:
            raise UsageError(f"the camera's rate cannot be set ({fps:g} was asked for): set camera.options.fps to 0")
        _within(port, name, False, fps, "frames/s", "camera.options.fps")
        _put(port, name, float(fps))
    result = next((n for n in RATES if port.has(n)), "")
    rate = port.number(result or name) if result or (name and free) else 0.0
    if not free and not result and name:
        rate = port.limits(name)[1]
    period_s = 1.0 / rate if math.isfinite(rate) and 0.0 < rate < 1e5 else 0.0
    if free:
        return max(period_s, exposure_s, SHORTEST_PERIOD_S)
    return max(period_s, SHORTEST_PERIOD_S) + exposure_s  # a trigger during the exposure would be lost


def _size_limits(port: GenicamPort, name: str) -> tuple[float, float]:
    low, high = port.limits(name, whole=True)
    for bound in (f"{name}Max", f"Sensor{name}"):
        if port.has(bound):
            return low, min(high, port.number(bound, whole=True))
    return low, high


def _within(port: GenicamPort, name: str, whole: bool, value: float, unit: str, setting: str) -> None:
    low, high = port.limits(name, whole)
    if not low <= value <= high:
        raise UsageError(f"{setting}: {value:g} {unit} was asked for; the camera's {name} has {low:g} to {high:g}")


def _put(port: GenicamPort, name: str, value: str | float | int | bool) -> None:
    try:
        port.put(name, value)
    except FeatureError as error:
        raise DeviceError(
            f"the camera does not take {value} as its {name}: {error.message}; look at it in `arv-viewer-0.8`, and "
            "whether another program holds it"
        ) from error
