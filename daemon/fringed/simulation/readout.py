"""When the simulated camera integrates, and what leaves it: frames in time, or what goes wrong with them.

Owns the camera's timing, its counter and the faults of its transport; the picture comes from the rig. It is the
simulated camera's port, as a cable is a real one's: a frame that it delivers may be garbage.
"""

from __future__ import annotations

import math

import numpy as np

from fringed.data import Array, CameraSettings
from fringed.errors import DeviceAbsent, DeviceStalled
from fringed.hookspecs import RawFrame
from fringed.simulation.rig import SimulatedRig


class Readout:
    """One armed acquisition.

    Free-running, frame k starts at `k * period_s` after arming and is delivered when its exposure ends; up to
    `buffers` finished frames wait for their reader, older ones are lost and missing in the counter.
    """

    def __init__(self, rig: SimulatedRig, settings: CameraSettings, buffers: int) -> None:
        self._rig = rig
        self._settings = settings
        self._buffers = buffers
        self._exposure_s = settings.exposure_us * 1e-6
        self.period_s = max(rig.config.sensor.period_s, self._exposure_s)
        self._zero_s = rig.clock.now()
        self._next = 0
        self._first_counter = rig.counter
        self._triggers: list[float] = []
        self._ready_s = self._zero_s
        self._last_image: Array | None = None

    def trigger(self) -> None:
        """Start one integration, as soon as the last frame is out."""
        start_s = max(self._rig.clock.now(), self._ready_s)
        self._ready_s = start_s + self.period_s
        self._triggers.append(start_s)

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame.

        Raises
        ------
        DeviceStalled
            none came within `timeout_s` on the rig's clock.
        DeviceAbsent
            the camera vanished.
        """
        clock, faults = self._rig.clock, self._rig.faults
        deadline_s = clock.now() + timeout_s
        if faults.strikes("vanish"):
            raise DeviceAbsent("the simulated camera vanished (a fault that was ordered); open it again")
        start_s = math.inf if faults.strikes("stall") else self._start()
        end_s = start_s + self._exposure_s
        if end_s > deadline_s:
            clock.sleep_until(deadline_s)
            raise DeviceStalled(f"no frame came from the simulated camera within {timeout_s:g} s")
        clock.sleep_until(end_s)
        counter = self._taken()
        image = self._rig.image(start_s, end_s, self._settings, counter)
        frame = RawFrame(self._struck(image, start_s), counter, start_s, end_s)
        self._rig.display.delivered(start_s)
        return frame

    def _start(self) -> float:
        """Return when the next frame's exposure starts; a dropped one is skipped."""
        rig = self._rig
        if self._settings.trigger != "free-running":
            if self._triggers and rig.display.is_awaited(self._triggers[0]) and rig.faults.strikes("dropped"):
                self._next += 1
            return self._triggers[0] if self._triggers else math.inf
        finished = math.floor((rig.clock.now() - self._zero_s - self._exposure_s) / self.period_s)
        self._next = max(self._next, finished - self._buffers + 1)
        start_s = self._zero_s + self._next * self.period_s
        if rig.display.is_awaited(start_s) and rig.faults.strikes("dropped"):
            self._next += 1
        return self._zero_s + self._next * self.period_s

    def _taken(self) -> int:
        if self._triggers:
            self._triggers.pop(0)
        counter = self._first_counter + self._next
        self._next += 1
        self._rig.counter = counter + 1
        return counter

    def _struck(self, image: Array, start_s: float) -> Array:
        """Return the image as the transport delivers it: repeated or garbage where that was ordered."""
        faults = self._rig.faults
        if self._rig.display.is_awaited(start_s) and self._last_image is not None and faults.strikes("repeated"):
            return self._last_image
        self._last_image = image
        if faults.strikes("garbage"):
            kind = int(faults.draw("garbage", 0, 3))
            return (image[: len(image) // 2], image.astype(np.float32), np.stack([image] * 3, axis=-1))[kind]
        return image
