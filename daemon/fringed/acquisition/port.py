"""Both devices of a rig as one port that can be interrupted.

Owns the slicing of waits, so that a cancelled scan ends within a fraction of a second, and the shape of
what a camera may deliver. Used by the acquisition thread only.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fringed.acquisition.rig import Device, Rig, culprit
from fringed.data import CameraSettings, PatternSequence
from fringed.errors import DeviceError, DeviceStalled, FringedError, ProtocolError
from fringed.hookspecs import RawFrame, Watched
from fringed.messages import DeviceState

SLICE_S = 0.15
READ_SLICE_S = 2.0  # a camera in order answers within a period; only a silent one is waited for that long


class RigPort:
    """Use camera and projector; `check` raises Cancelled when the work is to end."""

    def __init__(self, rig: Rig, report: Callable[[str, DeviceState], None], check: Callable[[], None]) -> None:
        self.rig = rig
        self.camera = Device("camera", rig.camera_driver, rig.camera, report)
        self.projector = Device("projector", rig.projector_driver, rig.projector, report)
        self._check = check
        self._armed: CameraSettings | None = None
        self._in_force = CameraSettings()

    @property
    def is_open(self) -> bool:
        """Whether both devices can be used."""
        return self.camera.is_open and self.projector.is_open

    def now(self) -> float:
        """Seconds on the rig's clock."""
        return self.rig.camera.clock.now()

    def connect(self) -> None:
        """Open what is not open; raises DeviceError, after having tried both."""
        try:
            self.camera.open()
        finally:
            self.projector.open()

    def check(self) -> None:
        """Ask both whether they are still there, those that can tell; what has gone becomes its state."""
        for device, driver in ((self.camera, self.rig.camera), (self.projector, self.rig.projector)):
            if not (device.is_open and isinstance(driver, Watched)):
                continue
            try:
                with device.guarded("check"):
                    driver.check()
            except DeviceError as error:
                self.failed(error)
            except FringedError as error:
                self.failed(DeviceError(f"the {device.which} does not answer: {error.message}"))

    def close(self) -> None:
        """Close both; harmless when closed."""
        self.rest()
        self.camera.close()
        self.projector.close()

    def failed(self, error: DeviceError) -> None:
        """Take note of which device failed; where that is not known, doubt both."""
        device = culprit(error)
        for candidate in (self.camera, self.projector) if device is None else (device,):
            candidate.fail(error)
        if not self.camera.is_open:  # it was closed, which disarms it
            self._armed = None

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Arm the camera, unless it is armed so already, and return the settings in force."""
        if self._armed != settings:
            self.disarm()
            with self.camera.guarded("arm"):
                self._in_force = self.rig.camera.arm(settings)
            self._armed = settings
            self.camera.go("ARMED")
        return self._in_force

    def disarm(self) -> None:
        """Disarm the camera; harmless when not armed."""
        if self._armed is not None:
            self._armed = None
            with self.camera.guarded("disarm"):
                self.rig.camera.disarm()
            self.camera.go("IDLE")

    def rest(self, doubt: str = "") -> None:
        """Disarm and show the idle picture; `doubt` says why the camera is DEGRADED. Errors become states."""
        try:
            if self.camera.is_open:
                self.disarm()
                self.camera.go("DEGRADED" if doubt else "IDLE", doubt)
            if self.projector.is_open:
                self.idle()
                self.projector.go("IDLE")
        except DeviceError as error:
            self.failed(error)
        except FringedError as error:
            self.failed(DeviceError(f"the rig cannot be put to rest: {error.message}"))

    def acquiring(self) -> None:
        """Say that a set is being taken."""
        self.camera.go("ACQUIRING")
        self.projector.go("ACQUIRING")

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Prepare the projector for a set."""
        with self.projector.guarded("load patterns"):
            self.rig.projector.load(sequence, role)

    def idle(self) -> None:
        """Show the idle picture."""
        with self.projector.guarded("show its idle picture"):
            self.rig.projector.idle()

    def show(self, index: int) -> float:
        """Show pattern `index`; return the time of its flip."""
        self._check()
        with self.projector.guarded("show a pattern"):
            return float(self.rig.projector.show(index))

    def trigger(self) -> float:
        """Trigger the camera; return when."""
        self._check()
        with self.camera.guarded("trigger"):
            self.rig.camera.trigger()
        return self.now()

    def wait_until(self, time_s: float) -> float:
        """Let time pass until `time_s`; return the time.

        Raises
        ------
        ProtocolError
            the rig's clock stands still.
        """
        clock = self.rig.camera.clock
        left_s = time_s - clock.now()
        for _ in range(100 + 2 * int(max(left_s, 0.0) / SLICE_S)):
            self._check()
            if (left_s := time_s - clock.now()) <= 0:
                return clock.now()
            clock.sleep(min(left_s, SLICE_S))
        raise ProtocolError(f"the rig's clock stands still {left_s:.3f} s before the time waited for")

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame, uint8 or uint16: `(height, width)`, or `(height, width, 3)` of channel "rgb".

        Raises
        ------
        DeviceStalled
            none came within `timeout_s` on the rig's clock.
        ProtocolError
            what came is no frame.
        """
        left_s = timeout_s
        with self.camera.guarded("deliver a frame"):
            while True:
                self._check()
                try:
                    return self._checked(self.rig.camera.read(min(left_s, READ_SLICE_S)))
                except DeviceStalled:
                    left_s -= READ_SLICE_S
                    if left_s <= 0:
                        raise

    def _checked(self, frame: RawFrame) -> RawFrame:
        width, height = self.rig.camera.size_px
        image = frame.image
        if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
            raise ProtocolError(f"the camera delivered {type(image).__name__}; expected an array of uint8 or uint16")
        shape = (height, width, 3) if self._in_force.channel == "rgb" else (height, width)
        if image.shape != shape:
            raise ProtocolError(f"the camera delivered a frame of shape {image.shape}; expected {shape}")
        return frame
