"""The driver `webcam`: any camera that Linux knows as /dev/video…, by OpenCV.

Owns the state of the camera and its options. A webcam runs free and has a rolling shutter; what it does not tell of its
times is told as a window that holds the exposure, so that no frame of another pattern is ever taken for one of this.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import cv2
from msgspec import Meta

from fringed.data import Array, CameraSettings
from fringed.devices.camera.base import MachineClock, checked_image
from fringed.devices.camera.webcam_capture import (
    EXPOSURE_UNIT_US,
    Capture,
    Control,
    Identify,
    Mode,
    OpenCapture,
    find,
    fix_automatics,
    fix_exposure,
    fix_gain,
    identify,
    open_device,
    open_v4l2,
    probe,
    set_mode,
)
from fringed.devices.camera.webcam_pictures import picture_of, wants_raw
from fringed.devices.camera.webcam_reader import Exposing, Reader
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, UsageError
from fringed.hookspecs import Clock, Driver, Params, RawFrame

log = logging.getLogger(__name__)

QUEUED = 4  # frames that OpenCV's V4L2 backend may hold from before [R]
LOOK_S = 0.1  # how often a reader who waits looks whether the device is still there


def _units(units: str) -> dict[str, Any]:
    return {"units": units}


class WebcamOptions(Params, frozen=True, kw_only=True):
    """The webcam's own options (`camera.options`). [A] marks what nobody has measured on your camera."""

    device: Annotated[
        str, Meta(description="path, or name below /dev/v4l/by-id; nothing: the only webcam that is plugged in")
    ] = ""
    width_px: Annotated[int, Meta(ge=16, le=16384, extra_json_schema=_units("px"))] = 1280
    height_px: Annotated[int, Meta(ge=16, le=16384, extra_json_schema=_units("px"))] = 720
    fps: Annotated[float, Meta(gt=0, le=1000, extra_json_schema=_units("1/s"))] = 10.0
    fourcc: Annotated[
        str, Meta(min_length=4, max_length=4, description="format; YUYV is not compressed, MJPG is, and harms fringes")
    ] = "YUYV"
    gain: Annotated[int, Meta(ge=0, description="its gain at 0 dB, in its own steps")] = 0
    gain_step_db: Annotated[
        float, Meta(ge=0, description="[A] dB of one of its steps; 0: unknown, so only 0 dB can be asked for")
    ] = 0.0
    stamps: Annotated[
        Literal["driver", "arrival"], Meta(description="whose time stamps are used; arrival where the driver has none")
    ] = "driver"
    stamp_marks: Annotated[
        Literal["unknown", "frame-end", "readout-start", "exposure-start"],
        Meta(description="[A] what the driver's stamp marks; unknown is safe, the others may save a frame per pattern"),
    ] = "unknown"
    readout_ms: Annotated[
        float,
        Meta(ge=0, description="[A] from the first row's end to the frame's arrival; 0: a whole frame period"),
    ] = 0.0
    rolling_shutter: Annotated[bool, Meta(description="[A] whether rows are exposed one after the other")] = True
    settle_frames: Annotated[int, Meta(ge=0, le=100, description="[A] frames until new settings hold")] = 2
    keep_frames: Annotated[int, Meta(ge=1, le=16, description="newest frames that wait for a slow reader")] = 2
    strict: Annotated[bool, Meta(description="refuse to measure while a control does not take its value")] = True


@dataclass
class _Device:
    """An open webcam."""

    path: str
    plugging: object
    capture: Capture
    mode: Mode
    controls: tuple[Control, ...] = ()


class WebcamCamera:
    """A webcam. `open_capture` and `plugging_of` stand for OpenCV and the file system."""

    simulated = False
    replayed = False

    def __init__(
        self,
        options: WebcamOptions,
        clock: Clock | None = None,
        open_capture: OpenCapture = open_v4l2,
        plugging_of: Identify = identify,
    ) -> None:
        self.clock: Clock = clock or MachineClock()
        self._options = options
        self._open_capture, self._plugging_of = open_capture, plugging_of
        self._device: _Device | None = None
        self._reader: Reader | None = None
        self._settings = CameraSettings()
        self._counter = -1

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its frames."""
        return (self._options.width_px, self._options.height_px)

    @property
    def period_s(self) -> float:
        """Time from frame to frame, as the mode in force says; a longer exposure stretches it."""
        mode_s = 1.0 / (self._device.mode.fps if self._device else self._options.fps)
        return max(mode_s, self._settings.exposure_us * 1e-6) if self._reader else mode_s

    @property
    def controls(self) -> tuple[Control, ...]:
        """What became of each control when it was armed last."""
        return self._device.controls if self._device else ()

    def open(self) -> str:
        """Open it and return the identity, with what of it cannot be fixed.

        Raises
        ------
        DeviceAbsent
            it is not plugged in, taken, or without permission.
        DeviceError
            it has not the mode that the options ask for.
        """
        if self._device is not None and self._plugging_of(self._device.path) != self._device.plugging:
            self.close()
        if self._device is None:
            options = self._options
            path = find(options.device)
            capture = open_device(path, self._open_capture)
            try:
                asked = Mode(options.width_px, options.height_px, options.fps, options.fourcc)
                mode = set_mode(capture, asked)
                self._device = _Device(path, self._plugging_of(path), capture, mode, probe(capture))
            except BaseException:
                capture.release()
                raise
        absent = [str(control) for control in self._device.controls if control.outcome == "absent"]
        return f"webcam {self._device.path}, {self._device.mode}" + "".join(f"; {text}" for text in absent)

    def close(self) -> None:
        """Release everything; harmless when closed."""
        try:
            self.disarm()
        finally:
            device, self._device = self._device, None
            if device is not None and self._reader is None:  # a reader that hangs still has the capture
                device.capture.release()
            self._reader = None

    def check(self) -> None:
        """Notice that it was unplugged; costs no time. Raises DeviceAbsent, and closes."""
        device = self._opened()
        if self._plugging_of(device.path) != device.plugging:
            self.close()
            raise DeviceAbsent(f"the webcam {device.path} was unplugged: plug it in again")

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Fix the controls, begin to read, and return the settings in force.

        Raises
        ------
        UsageError
            a trigger, a depth or a gain that a webcam has not.
        DeviceError
            a control does not take its value.
        """
        device = self._opened()
        gain = self._gain(settings)
        self.disarm()
        automatics = fix_automatics(device.capture)  # first: some cameras take an exposure only without them
        exposure = fix_exposure(device.capture, settings.exposure_us)
        device.controls = (*automatics, exposure, fix_gain(device.capture, gain))
        refused = [str(control) for control in device.controls if control.outcome == "refused"]
        if refused and self._options.strict:
            raise DeviceError(
                f"the webcam {device.path} would change while it measures: {'; '.join(refused)}. Ask for a value that "
                "it has (`v4l2-ctl --list-ctrls`), or set camera.options.strict to false"
            )
        for control in device.controls:
            if control.outcome != "fixed":
                log.warning("webcam %s: %s", device.path, control)
        seen_us = exposure.seen * EXPOSURE_UNIT_US if exposure.outcome != "absent" else settings.exposure_us
        self._settings = replace(settings, exposure_us=seen_us)
        device.capture.set(cv2.CAP_PROP_CONVERT_RGB, float(not wants_raw(device.mode.fourcc, settings.channel)))
        reader = Reader(device.capture, self.clock, self._exposing(seen_us * 1e-6), self._convert, self._kept)
        self._reader = reader
        reader.start(QUEUED + self._options.settle_frames, self._counter)
        return self._settings

    def disarm(self) -> None:
        """Stop reading; harmless when not armed."""
        if self._reader is not None:
            self._counter = self._reader.stop()
            self._reader = None

    def trigger(self) -> None:
        """Refuse: a webcam runs free."""
        raise UsageError("a webcam cannot be triggered; set camera.trigger to free-running")

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame.

        Raises
        ------
        DeviceStalled
            none came within `timeout_s`.
        DeviceAbsent
            the webcam was unplugged.
        ProtocolError
            what came is no frame of the mode that was set.
        """
        device, reader = self._opened(), self._reader
        if reader is None:
            raise DeviceError("the webcam is not armed: call arm first")
        end_s = self.clock.now() + timeout_s
        while True:
            self.check()
            frame = reader.take(min(LOOK_S, max(0.0, end_s - self.clock.now())))
            if frame is not None:
                return frame
            if self.clock.now() >= end_s:
                raise DeviceStalled(
                    f"no frame from {device.path} within {timeout_s:g} s: check its cable and that no other program "
                    "uses it; in the dark some webcams slow down until their automatic exposure is off"
                )

    @property
    def _kept(self) -> int:
        return self._options.keep_frames

    def _opened(self) -> _Device:
        if self._device is None:
            raise DeviceAbsent("the webcam is closed or has vanished: open it")
        return self._device

    def _convert(self, raw: Any) -> Array:
        channel = self._settings.channel
        image = picture_of(raw, self.size_px, self._options.fourcc, channel)
        return checked_image(image, self.size_px, 8, 3 if channel == "rgb" else 1)

    def _gain(self, settings: CameraSettings) -> float:
        """Return its gain in its own steps, after a check of the settings that it cannot have at all."""
        if settings.trigger != "free-running":
            raise UsageError(f"a webcam cannot be triggered ({settings.trigger!r}): set camera.trigger to free-running")
        if settings.bits != 8:
            raise UsageError(f"a webcam delivers 8 bits, {settings.bits} were asked for: set camera.bits to 8")
        if settings.gain_db and not self._options.gain_step_db:
            raise UsageError(
                f"a gain of {settings.gain_db:g} dB was asked for, and it is not known what this webcam's steps are in "
                "dB: set camera.options.gain_step_db, or camera.gain_db to 0 and camera.options.gain to its steps"
            )
        steps = settings.gain_db / self._options.gain_step_db if settings.gain_db else 0.0
        return self._options.gain + steps

    def _exposing(self, exposure_s: float) -> Exposing:
        options = self._options
        readout_s = options.readout_ms * 1e-3 or self.period_s
        before_arrival_s = exposure_s + readout_s
        before_stamp_s = {
            "unknown": before_arrival_s,  # the earliest that it can be
            "frame-end": before_arrival_s,
            "readout-start": exposure_s,
            "exposure-start": 0.0,
        }[options.stamp_marks]
        known_s = before_arrival_s if options.rolling_shutter else exposure_s
        lasts_s = None if options.stamp_marks == "unknown" else known_s
        return Exposing(before_stamp_s, before_arrival_s, lasts_s, options.stamps == "driver")


def create(options: WebcamOptions, context: Any) -> WebcamCamera:
    """Build the driver; nothing is opened."""
    return WebcamCamera(options, context.clock)


WEBCAM = Driver("webcam", WebcamOptions, create, "any webcam, by OpenCV and V4L2")
