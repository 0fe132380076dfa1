"""The simulated camera: the rig's sensor behind the interface of every camera."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

from msgspec import Meta

from fringed.config.validation import validate
from fringed.data import CameraSettings
from fringed.devices.camera.base import checked_image
from fringed.errors import DeviceAbsent, DeviceError, UsageError
from fringed.hookspecs import Clock, Params, RawFrame
from fringed.simulation.readout import Readout
from fringed.simulation.rig import SimulatedRig


class SimulatedCameraOptions(Params, frozen=True, kw_only=True):
    """The simulated camera's own options (`camera.options`)."""

    buffers: Annotated[int, Meta(ge=1, le=64, description="finished frames that wait for a slow reader")] = 3
    warm_up: Annotated[bool, Meta(description="compute in the background, once open, what the first frame needs")] = (
        True
    )


class SimulatedCamera:
    """A camera of the simulated rig."""

    simulated = True
    replayed = False

    def __init__(self, rig: SimulatedRig, options: Mapping[str, Any] | None = None) -> None:
        self._options = validate(options or {}, SimulatedCameraOptions, "camera.options")
        self._rig = rig
        self.clock: Clock = rig.clock
        self._open = False
        self._readout: Readout | None = None
        self._settings = CameraSettings()
        self._warming: threading.Thread | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the frames."""
        return (self._rig.config.sensor.width_px, self._rig.config.sensor.height_px)

    @property
    def period_s(self) -> float:
        """Shortest time from frame to frame with the settings in force."""
        return self._readout.period_s if self._readout else self._rig.config.sensor.period_s

    def open(self) -> str:
        """Open and return the identity; a camera that vanished is back."""
        self._open = True
        if self._options.warm_up and self._warming is None:
            self._warming = threading.Thread(target=self._rig.warm_up, name="warm-simulation", daemon=True)
            self._warming.start()
        return f"{self._rig.identity} camera {self.size_px[0]} x {self.size_px[1]}"

    def close(self) -> None:
        """Release everything; harmless when closed."""
        self.disarm()
        self._open = False
        if self._warming is not None:
            self._warming.join(30.0)
            self._warming = None

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Start acquisition and return the settings in force; raises UsageError for those it has not."""
        self._require_open()
        self._settings = self._rig.sensor.in_force(settings)
        self._readout = Readout(self._rig, self._settings, self._options.buffers)
        return replace(self._settings)

    def disarm(self) -> None:
        """Stop acquisition; harmless when not armed."""
        self._readout = None

    def trigger(self) -> None:
        """Start one integration; only when armed with a trigger."""
        readout = self._require_armed()
        if self._settings.trigger == "free-running":
            raise UsageError("the camera runs freely; arm it with trigger 'software' or 'hardware' to trigger it")
        readout.trigger()

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame; raises DeviceStalled, DeviceAbsent when it vanished, ProtocolError for garbage."""
        readout = self._require_armed()
        try:
            frame = readout.read(timeout_s)
        except DeviceAbsent:
            self._readout, self._open = None, False
            raise
        channels = 3 if self._settings.channel == "rgb" else 1
        return replace(frame, image=checked_image(frame.image, self.size_px, self._settings.bits, channels))

    def _require_open(self) -> None:
        if not self._open:
            raise DeviceAbsent("the simulated camera is closed or has vanished: open it")

    def _require_armed(self) -> Readout:
        self._require_open()
        if self._readout is None:
            raise DeviceError("the camera is not armed: call arm first")
        return self._readout
