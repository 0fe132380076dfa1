"""The driver `usb3vision`: a camera, or a Camera Link bridge, that speaks USB3 Vision.

Owns the order of things: open, arm, frames, times, counters. Bytes are in `fringed.protocols`, USB in
`usb3vision_usb`, registers and features in `usb3vision_control`.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace
from typing import Any

from fringed.data import Array, CameraSettings
from fringed.devices.camera.base import MachineClock, checked_image
from fringed.devices.camera.usb3vision_control import Usb3VisionControl
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.devices.camera.usb3vision_settings import adjust, own_settings
from fringed.devices.camera.usb3vision_times import ExposureTimes
from fringed.devices.camera.usb3vision_usb import TransferLost, Usb3VisionLink, load_backend
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.hookspecs import Camera, Clock, Driver, RawFrame, Setting
from fringed.protocols.u3v import Block, BlockAssembler, TransferPlan
from fringed.protocols.u3v_pixels import BY_NAME, PixelFormat, decode_image, format_of

log = logging.getLogger(__name__)

EMULATORS = "fringed.emulators."
_BEGUN_S = 0.1
_PLANES = {"red": 0, "green": 1, "blue": 2}


class Usb3VisionCamera:
    """A USB3 Vision camera.

    A hardware trigger comes by the camera's line: `trigger` then does nothing, and `read` waits for its frame.
    """

    replayed = False

    def __init__(
        self, options: Usb3VisionOptions | None = None, clock: Clock | None = None, backend: Any = None
    ) -> None:
        self._options = options or Usb3VisionOptions()
        # An emulator's photons are simulated, however real its bytes are.
        self.simulated = self._options.backend.startswith(EMULATORS)
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
        self._times: ExposureTimes | None = None
        self.incomplete = 0
        self._last_broken = ""

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
            self._times = ExposureTimes(control, self._options, self.clock, in_force.exposure_us * 1e-6)
            self._assembler = BlockAssembler(self._started(control))
            self._settings = self._with_noise(in_force)
            self._period_s = self._shortest_s()
        except DeviceAbsent:
            self._forget()
            raise
        self._base, self.incomplete = self._counter, 0
        return replace(self._settings)

    def _started(self, control: Usb3VisionControl) -> TransferPlan:
        try:
            return control.start()
        except DeviceError:  # half started, it would refuse other settings
            with suppress(DeviceError):
                control.stop()
            raise

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
        control, _, times = self._require_armed()
        if self._settings.trigger == "free-running":
            raise UsageError("the camera runs freely; arm it with trigger 'software' or 'hardware' to trigger it")
        if self._settings.trigger == "software":
            times.triggered()
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
        _, assembler, times = self._require_armed()
        deadline = self.clock.now() + timeout_s
        try:
            times.keep_up()
            while (block := self._awaited(assembler, deadline)) is None:
                if self.clock.now() >= deadline:
                    raise DeviceStalled(self._silence(timeout_s))
            return self._frame(times, block)
        except DeviceAbsent:
            self._forget()
            raise

    def check(self) -> None:
        """Notice a camera that has gone while it rests; raises DeviceAbsent."""
        self._require_open()
        assert self._link is not None
        try:
            self._link.check()
        except DeviceAbsent:
            self._forget()
            raise

    def settings(self) -> tuple[Setting, ...]:
        """Ask the camera for its own settings."""
        return own_settings(self._require_open().features)

    def adjust(self, name: str, value: bool | float | str) -> None:
        """Set one of them; raises UsageError for what it has not, or while it is armed."""
        control = self._require_open()
        if self._assembler is not None:
            raise UsageError(f"{name} cannot be set while the camera is armed: wait for the scan's end")
        adjust(control.features, name, value)
        self._size_px = control.size_px()

    def _awaited(self, assembler: BlockAssembler, deadline: float) -> Block | None:
        """Fetch one transfer; pass over an incomplete frame where that is wanted and another one comes by itself."""
        try:
            return self._next(assembler, deadline)
        except ProtocolError as error:
            self.incomplete += 1
            self._last_broken = error.message
            if self._options.incomplete_frames == "fail" or self._settings.trigger != "free-running":
                raise
            log.warning("a frame is passed over: %s", error.message)
            return None

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

    def _frame(self, times: ExposureTimes, block: Block) -> RawFrame:
        arrived_s, leader = self.clock.now(), block.leader
        self._counter = self._base + leader.block_id + 1
        pixels = format_of(leader.pixel_format)
        if pixels != self._pixels or (leader.width, leader.height) != self._size_px:
            raise ProtocolError(
                f"the camera delivered {leader.width} x {leader.height} pixels of {pixels.name}; it was set to "
                f"{self._size_px[0]} x {self._size_px[1]} of {self._pixels.name}: arm it again, close other programs"
            )
        image = decode_image(block.payload, pixels, self._size_px, leader.x_padding)
        start_s = times.start_s(leader.time_stamp, arrived_s)
        exposure_s = self._settings.exposure_us * 1e-6
        return RawFrame(self._selected(image), self._counter, start_s, min(arrived_s, start_s + exposure_s))

    def _selected(self, image: Array) -> Array:
        channel = self._settings.channel
        if image.ndim == 3 and channel in _PLANES:
            image = image[:, :, _PLANES[channel]].copy()
        return checked_image(image, self._size_px, self._settings.bits, 3 if channel == "rgb" else 1)

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
        broken = f"; {self.incomplete} were incomplete, the last: {self._last_broken}" if self.incomplete else ""
        return f"the camera delivered no frame within {timeout_s:g} s ({waits}): {advice}{broken}"

    def _forget(self) -> None:
        self._assembler = self._control = None
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _require_open(self) -> Usb3VisionControl:
        if self._control is None:
            raise DeviceAbsent("the USB3 Vision camera is closed or has vanished: open it")
        return self._control

    def _require_armed(self) -> tuple[Usb3VisionControl, BlockAssembler, ExposureTimes]:
        control = self._require_open()
        if self._assembler is None or self._times is None:
            raise DeviceError("the camera is not armed: call arm first")
        return control, self._assembler, self._times


def create(options: Usb3VisionOptions, context: Any) -> Camera:
    """Return the camera; nothing is opened."""
    return Usb3VisionCamera(options, context.clock)


USB3_VISION = Driver(
    "usb3vision",
    Usb3VisionOptions,
    create,
    "any USB3 Vision camera, or a Camera Link to USB3 Vision bridge, over libusb",
)
