"""When a USB3 Vision camera's exposures began, on the rig's clock.

Owns how a time stamp becomes a time, and how far the two clocks may be believed.
"""

from __future__ import annotations

from fringed.devices.camera.usb3vision_control import Usb3VisionControl
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.errors import ProtocolError
from fringed.hookspecs import Clock

SYNCHRONISE_EVERY_S = 2.0  # 50 ppm between two quartzes make 0.1 ms in that time
TOLERANCE_S = 0.02
_EXCHANGE_S = 0.001  # the clocks are known to each other within the time of a command


class ExposureTimes:
    """The times of one arming: exposures of `exposure_s`."""

    def __init__(self, control: Usb3VisionControl, options: Usb3VisionOptions, clock: Clock, exposure_s: float) -> None:
        self._control, self._options, self._clock, self._exposure_s = control, options, clock, exposure_s
        self._triggered_s = self._synchronised_s = float("-inf")
        self.keep_up()

    def keep_up(self) -> None:
        """Compare the clocks, if that is due."""
        due = self._clock.now() - self._synchronised_s > SYNCHRONISE_EVERY_S
        if self._options.time_stamps == "camera" and due:
            self._synchronise()

    def triggered(self) -> None:
        """Note that a trigger is given now."""
        self._triggered_s = self._clock.now()

    def start_s(self, stamp: int, arrived_s: float) -> float:
        """Return when the exposure began: not before its trigger, and so that it ended before its frame came.

        Raises
        ------
        ProtocolError
            the time stamp contradicts the frame's arrival.
        """
        latest_s = arrived_s - self._exposure_s
        if self._options.time_stamps == "arrival":
            return latest_s - self._options.readout_ms / 1000
        start_s = self._stamped_s(stamp)
        if start_s > latest_s + TOLERANCE_S:
            self._synchronise()
            start_s = self._stamped_s(stamp)
        if start_s > latest_s + TOLERANCE_S:
            raise ProtocolError(
                f"the camera's time stamp says that an exposure ended {start_s - latest_s:.3f} s after its frame came: "
                "set camera.options.stamp_marks, or time_stamps to 'arrival'"
            )
        start_s = min(start_s, latest_s)
        return self._triggered_s if 0 < self._triggered_s - start_s < _EXCHANGE_S else start_s

    def _stamped_s(self, stamp: int) -> float:
        moment_s = self._control.on_rig_clock(stamp)
        return moment_s - self._exposure_s if self._options.stamp_marks == "exposure-end" else moment_s

    def _synchronise(self) -> None:
        self._control.synchronise()
        self._synchronised_s = self._clock.now()
