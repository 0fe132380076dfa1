"""Simulated optics that are fed by what an X server scans out, not by what a program says it shows.

Owns the thread that watches the frame buffer. The scene, the light and the sensor are the simulated rig's, in real
time; cameras take their images from here.
"""

from __future__ import annotations

import threading

import numpy as np

from fringed.config.simulated import SimulationConfig
from fringed.data import Array, CameraSettings, UInt8Array
from fringed.emulators.framebuffer import FrameBuffer, reduced
from fringed.simulation.display import Picture
from fringed.simulation.rig import SimulatedRig

_WATCH_S = 0.002


class ScannedOptics:
    """A scene in front of a projector whose video cable ends here.

    `settings` are those of the camera that looks; whoever emulates it sets them. The configuration has to be in real
    time.
    """

    def __init__(self, config: SimulationConfig, buffer: FrameBuffer) -> None:
        if not config.real_time:
            raise ValueError("simulation.real_time is false; optics behind a real video output need the real clock")
        self.rig = SimulatedRig(config)
        self.settings = CameraSettings(channel="green", trigger="software")
        self.pictures = 0
        self._buffer, self._counter = buffer, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="scan-out", daemon=True)

    def start(self) -> None:
        """Begin to watch; compiles first what an image needs."""
        self.rig.warm_up()
        self._thread.start()

    def close(self) -> None:
        """Stop watching; harmless before the start."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def image(self, start_s: float, exposure_s: float) -> Array:
        """Return the frame of an exposure on the machine's monotonic clock, when it has ended."""
        end_s = start_s + exposure_s
        self.rig.clock.sleep_until(end_s + 2 * _WATCH_S)  # what changed until then is known
        self._counter += 1
        return self.rig.image(start_s, end_s, self.rig.sensor.in_force(self.settings), self._counter)

    def _watch(self) -> None:
        """Hand every picture over that stood still for one look: the server draws while we look."""
        known = before = self._buffer.sample()
        self._appear(self._buffer.picture(), self.rig.clock.now())
        changed_s: float | None = None
        while not self._stop.wait(_WATCH_S):
            now = self._buffer.sample()
            if changed_s is None and not np.array_equal(now, known):
                changed_s = self.rig.clock.now()
            elif changed_s is not None and np.array_equal(now, before):
                known = now
                self._appear(self._buffer.picture(), changed_s)
                changed_s = None
            before = now

    def _appear(self, picture: UInt8Array, time_s: float) -> None:
        self.pictures += 1
        self.rig.display.appear(Picture(reduced(picture)), time_s)
