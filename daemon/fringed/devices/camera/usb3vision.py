"""The driver `usb3vision`: a camera, or a Camera Link bridge, that speaks USB3 Vision.

Owns the order of things: open, arm, frames, times, counters. Bytes are in `fringed.protocols`, USB in
`usb3vision_usb`, registers and features in `usb3vision_control`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

from fringed.data import Array, CameraSettings
from fringed.devices.camera.base import MachineClock, checked_image
from fringed.devices.camera.usb3vision_control import Usb3VisionControl
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.devices.camera.usb3vision_usb import TransferLost, Usb3VisionLink, load_backend
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.hookspecs import Camera, Clock, Driver, RawFrame
from fringed.protocols.u3v import Block, BlockAssembler
from fringed.protocols.u3v_pixels import BY_NAME, PixelFormat, decode_image, format_of

SYNCHRONISE_EVERY_S = 2.0  # 50 ppm between two quartzes make 0.1 ms in that time
TOLERANCE_S = 0.02
_BEGUN_S = 0.1
_PLANES = {"red": 0, "green": 1, "blue": 2}


class Usb3VisionCamera:
    """A USB3 Vision camera.

    A hardware trigger comes by the camera's line: `trigger` then does nothing, and `read` waits for its frame.
    """

    simulated = False
    replayed = False

    def __init__(
        self, options: Usb3VisionOptions | None = None, clock: Clock | None = None, backend: Any = None
    ) -> None:
        self._options = options or Usb3VisionOptions()
        self.clock: Clock = clock or MachineClock()
        self._backend = backend
        self._link: Usb3VisionLink | None = None
        self._control: Usb3VisionControl | None = None
        self._assembler: BlockAssembler | None = None
        self._settings = CameraSettings()
        self._pixels: PixelFormat = BY_NAME["Mono8"]
        self._size_px = (self._options.width_px, self._options.height_px)
        self._period_s = 0.0
        self._counter = self._base = 0
        self._triggered_s = self._synchronised_s = float("-inf")

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its frames; what the options say before it was opened."""
        return self._size_px

    @property
    def period_s(self) -> float:
        """Shortest time from frame to frame: the camera's own figure, or exposure and readout."""
        return self._period_s

    def open(self) -> str:
        """Find it, read what it is and can, and return its identity; harmless when open.

        Raises
        ------
        DeviceAbsent
            it is not there, or in use, or forbidden.
        ProtocolError
            it is no USB3 Vision camera, or describes itself in a way that cannot be read.
        """
        if self._control is None:
            if self._backend is None:
                self._backend = load_backend(self._options.backend)
            timeout_s = self._options.control_timeout_ms / 1000
            self._link = Usb3VisionLink(self._options.serial, self._backend, self.clock, timeout_s)
            try:
                self._link.open()
                self._control = Usb3VisionControl(self._link, self._options, self.clock)
                self._size_px = self._control.size_px()
                self._period_s = self._shortest_s()
            except BaseException:
                self._forget()
                raise
        return f"{self._control.identity}, {self._size_px[0]} x {self._size_px[1]}"

    def close(self) -> None:
        """Release everything; harmless when closed."""
        with suppress(DeviceError):
            self.disarm()
        self._forget()

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Set it, program its transfers and start; return the settings in force.

        Raises
        ------
        UsageError
            an exposure, a gain, bits or a channel that it has not.
        """
        control = self._require_open()
        self.disarm()
        try:
            in_force, self._pixels = control.configure(settings)
            self._size_px = control.size_px()
            if self._options.time_stamps == "camera":
                self._synchronise(control)
            self._assembler = BlockAssembler(control.start())
            self._settings = self._with_noise(in_force)
            self._period_s = self._shortest_s()
        except DeviceAbsent:
            self._forget()
            raise
        self._base, self._triggered_s = self._counter, float("-inf")
        return replace(self._settings)

    def disarm(self) -> None:
        """Stop acquisition; harmless when not armed."""
        if self._assembler is None or self._control is None:
            return
        self._assembler = None
        try:
            self._control.stop()
        except DeviceAbsent:
            self._forget()
            raise

    def trigger(self) -> None:
        """Start one integration; only when armed with a trigger."""
        control, _ = self._require_armed()
        if self._settings.trigger == "free-running":
            raise UsageError("the camera runs freely; arm it with trigger 'software' or 'hardware' to trigger it")
        if self._settings.trigger == "software":
            self._triggered_s = self.clock.now()
            try:
                control.trigger()
            except DeviceAbsent:
                self._forget()
                raise

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame.

        Raises
        ------
        DeviceStalled
            none was complete within `timeout_s`; one that has begun goes on with the next call.
        DeviceAbsent
            the camera has vanished.
        ProtocolError
            a frame is incomplete, or of another format than was set; the next one can be read.
        """
        control, assembler = self._require_armed()
        deadline = self.clock.now() + timeout_s
        try:
            self._resynchronise(control)
            while (block := self._next(assembler, deadline)) is None:
                if self.clock.now() >= deadline:
                    raise DeviceStalled(self._silence(timeout_s))
            return self._frame(control, block)
        except DeviceAbsent:
            self._forget()
            raise

    def _next(self, assembler: BlockAssembler, deadline: float) -> Block | None:
        """Fetch one transfer; return the block that it completes."""
        link = self._link
        assert link is not None
        try:
            # A transfer that a time-out cuts in two costs the frame: what has begun gets time to end.
            least_s = _BEGUN_S if not assembler.between_blocks else 0.001
            transfer = link.transfer(assembler.wanted, max(least_s, deadline - self.clock.now()))
        except TransferLost as lost:
            if assembler.between_blocks:  # what was lost is the rest of a block that has been reported
                assembler.skipped += 1
                return None
            assembler.lost(str(lost))
        return None if transfer is None else assembler.feed(transfer)

    def _frame(self, control: Usb3VisionControl, block: Block) -> RawFrame:
        arrived_s, leader = self.clock.now(), block.leader
        self._counter = self._base + leader.block_id + 1
        pixels = format_of(leader.pixel_format)
        if pixels != self._pixels or (leader.width, leader.height) != self._size_px:
            raise ProtocolError(
                f"the camera delivered {leader.width} x {leader.height} pixels of {pixels.name}; it was set to "
                f"{self._size_px[0]} x {self._size_px[1]} of {self._pixels.name}: arm it again, close other programs"
            )
        image = decode_image(block.payload, pixels, self._size_px, leader.x_padding)
        start_s = self._start_s(control, leader.time_stamp, arrived_s)
        exposure_s = self._settings.exposure_us * 1e-6
        return RawFrame(self._selected(image), self._counter, start_s, min(arrived_s, start_s + exposure_s))

    def _selected(self, image: Array) -> Array:
        channel = self._settings.channel
        if image.ndim == 3 and channel in _PLANES:
            image = image[:, :, _PLANES[channel]].copy()
        return checked_image(image, self._size_px, self._settings.bits, 3 if channel == "rgb" else 1)

    def _start_s(self, control: Usb3VisionControl, stamp: int, arrived_s: float) -> float:
        """Return when the exposure began, between the trigger and the latest that the frame's arrival allows."""
        exposure_s = self._settings.exposure_us * 1e-6
        latest_s = arrived_s - exposure_s
        if self._options.time_stamps == "arrival":
            return latest_s - self._options.readout_ms / 1000
        start_s = self._stamped_s(control, stamp)
        if start_s > latest_s + TOLERANCE_S:
            self._synchronise(control)
            start_s = self._stamped_s(control, stamp)
        if start_s > latest_s + TOLERANCE_S:
            raise ProtocolError(
                f"the camera's time stamp says that an exposure ended {start_s - latest_s:.3f} s after its frame came: "
                "set camera.options.stamp_marks, or time_stamps to 'arrival'"
            )
        start_s = min(start_s, latest_s)
        # The two clocks are known to each other within the time of a command: no frame begins before its trigger.
        return self._triggered_s if 0 < self._triggered_s - start_s < TOLERANCE_S / 20 else start_s

    def _stamped_s(self, control: Usb3VisionControl, stamp: int) -> float:
        moment_s = control.on_rig_clock(stamp)
        marks_end = self._options.stamp_marks == "exposure-end"
        return moment_s - self._settings.exposure_us * 1e-6 if marks_end else moment_s

    def _resynchronise(self, control: Usb3VisionControl) -> None:
        if self._options.time_stamps == "camera" and self.clock.now() - self._synchronised_s > SYNCHRONISE_EVERY_S:
            self._synchronise(control)

    def _synchronise(self, control: Usb3VisionControl) -> None:
        control.synchronise()
        self._synchronised_s = self.clock.now()

    def _shortest_s(self) -> float:
        assert self._control is not None
        rate_hz = self._control.frame_rate_hz()
        exposure_s = self._settings.exposure_us * 1e-6
        return max(exposure_s, 1 / rate_hz if rate_hz else exposure_s + self._options.readout_ms / 1000)

    def _with_noise(self, settings: CameraSettings) -> CameraSettings:
        full_well = self._options.full_well_electrons
        return replace(
            settings,
            electrons_per_dn=full_well / (2**settings.bits - 1) / 10 ** (settings.gain_db / 20),
            read_noise_electrons=self._options.read_noise_electrons,
        )

    def _silence(self, timeout_s: float) -> str:
        waits = self._settings.trigger
        advice = {
            "free-running": "check its link and that nothing else stops it",
            "software": "trigger it, or check that it takes triggers this fast",
            "hardware": f"check the pulses on its {self._options.trigger_line}",
        }[waits]
        return f"the camera delivered no frame within {timeout_s:g} s ({waits}): {advice}"

    def _forget(self) -> None:
        self._assembler = self._control = None
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _require_open(self) -> Usb3VisionControl:
        if self._control is None:
            raise DeviceAbsent("the USB3 Vision camera is closed or has vanished: open it")
        return self._control

    def _require_armed(self) -> tuple[Usb3VisionControl, BlockAssembler]:
        control = self._require_open()
        if self._assembler is None:
            raise DeviceError("the camera is not armed: call arm first")
        return control, self._assembler


def create(options: Usb3VisionOptions, context: Any) -> Camera:
    """Return the camera; nothing is opened."""
    return Usb3VisionCamera(options, context.clock)


USB3_VISION = Driver(
    "usb3vision",
    Usb3VisionOptions,
    create,
    "any USB3 Vision camera, or a Camera Link to USB3 Vision bridge, over libusb",
)
