"""The driver `duncantech`: an MS3100 as one camera, its settings over the serial line, its frames over another driver.

Owns what a scan's settings mean for the three CCDs, and the order of things; the line is `duncantech_control`'s, the
frames are the image transport's, which has the Camera protocol itself (a Camera Link bridge to USB3 Vision or GigE).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fringed.config.validation import validate
from fringed.data import CameraChannel, CameraSettings
from fringed.devices.camera.base import checked_image
from fringed.devices.camera.duncantech_control import COLOURS, DuncanTechControl
from fringed.devices.camera.duncantech_options import DuncanTechOptions, control_settings
from fringed.devices.camera.duncantech_settings import adjust, settings_of
from fringed.errors import ConfigurationError, DeviceAbsent, DeviceError, DeviceStalled, Problem, UsageError
from fringed.hookspecs import Adjustable, Camera, Driver, RawFrame, Setting, Watched
from fringed.protocols.duncantech import Colour
from fringed.transports.serial_port import SerialPort, SerialSettings
from fringed.transports.tracing import traced

FRAME_PERIOD_S = 1 / 7.5  # [V] where the image transport does not know better
BITS = (8, 10)  # [V]
_BRIDGE = "images_"  # before the names of the image transport's own settings


@dataclass(frozen=True)
class _Plan:
    """What settings mean for the camera."""

    lines: int
    gains: dict[Colour, int]
    gain_db: float
    offsets: dict[Colour, int]
    colours: tuple[Colour, ...]
    images: CameraSettings


class DuncanTechCamera:
    """An MS3100: `control` takes the settings, `images` brings the frames. Used by one thread."""

    def __init__(self, control: DuncanTechControl, images: Camera, options: DuncanTechOptions) -> None:
        self.control, self._images, self._options = control, images, options
        self.replayed, self.clock = images.replayed, images.clock
        self._settings: CameraSettings | None = None
        self._unsettled, self._others_exposure_us = 0, 0.0

    @property
    def simulated(self) -> bool:
        """Whether its frames are simulated."""
        return self._images.simulated

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the frames."""
        return (self._options.width_px, self._options.height_px)

    @property
    def period_s(self) -> float:
        """Shortest time from frame to frame with the settings in force."""
        return self._images.period_s or FRAME_PERIOD_S

    def open(self) -> str:
        """Open control and image transport and return both identities; raises DeviceError, and closes both."""
        self._settings = None
        try:
            control = self.control.open()
            images = self._images.open()
            self._check_size()
        except BaseException:
            self.close()
            raise
        return f"{control}; frames from {images}"

    def close(self) -> None:
        """Release everything; harmless when closed."""
        self._settings = None
        try:
            self._images.close()
        finally:
            self.control.close()

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Set the CCDs in use, start the acquisition, and return the settings in force.

        Raises
        ------
        UsageError
            settings that this camera has not, or that cannot be set because their bytes are not known.
        DeviceError
            the camera does not take them, or the image transport delivers something else.
        """
        plan = self._plan(settings)
        self.disarm()
        for colour in plan.colours:
            self.control.set_integration_lines(colour, plan.lines)
            if colour in plan.gains:
                self.control.set_gain(colour, plan.gains[colour])
            if colour in plan.offsets:
                self.control.set_offset(colour, plan.offsets[colour])
        brought = self._images.arm(plan.images)
        self._check_brought(plan.images, brought)
        noise_known = plan.gain_db == 0  # what the image transport knows of it, it knows at 0 dB
        self._settings = replace(
            brought,
            exposure_us=plan.images.exposure_us,
            gain_db=plan.gain_db,
            channel=settings.channel,
            electrons_per_dn=brought.electrons_per_dn if noise_known else 0.0,
            read_noise_electrons=brought.read_noise_electrons if noise_known else 0.0,
        )
        self._others_exposure_us = brought.exposure_us
        self._unsettled = self._options.settle_frames if settings.trigger == "free-running" else 0
        return self._settings

    def disarm(self) -> None:
        """Stop the acquisition; harmless when not armed."""
        self._settings = None
        self._images.disarm()

    def trigger(self) -> None:
        """Start one integration; only when armed with a trigger."""
        if self._armed().trigger == "free-running":
            raise UsageError("the camera runs freely; arm it with trigger 'software' or 'hardware' to trigger it")
        self._images.trigger()

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame whose settings are in force.

        Raises
        ------
        DeviceStalled
            none came in time.
        DeviceAbsent
            the control's port, or the image transport, has vanished.
        ProtocolError
            the frame has another size or depth.
        """
        settings = self._armed()
        try:
            self.control.check()
            frame = self._next(timeout_s)
        except DeviceAbsent:
            self.close()
            raise
        planes = 3 if self._options.output == "rgb" else 1
        image = checked_image(frame.image, self.size_px, settings.bits, planes)
        if planes == 3 and settings.channel != "rgb":
            image = np.ascontiguousarray(image[..., COLOURS.index(_colour(settings.channel))])
        start_s = frame.exposure_start_s
        if self._others_exposure_us != settings.exposure_us:  # the transport does not know how long the CCDs integrate
            start_s = frame.exposure_end_s - settings.exposure_us * 1e-6
        return replace(frame, image=image, exposure_start_s=start_s)

    def check(self) -> None:
        """Notice that the control's port or the image transport has gone while both rest; raises DeviceError."""
        self.control.check()
        if isinstance(self._images, Watched):
            self._images.check()

    def settings(self) -> Sequence[Setting]:
        """Ask for every CCD's gain, offset and integration time, and for what the image transport has of its own."""
        own = list(settings_of(self.control))
        if isinstance(self._images, Adjustable):
            own += [replace(one, name=_BRIDGE + one.name) for one in self._images.settings()]
        return own

    def adjust(self, name: str, value: bool | float | str) -> None:
        """Set one of them; raises UsageError for what there is not, or while the camera is armed."""
        if self._settings is not None:
            raise UsageError(f"{name} cannot be set while the camera is armed: wait for the scan's end")
        if name.startswith(_BRIDGE) and isinstance(self._images, Adjustable):
            self._images.adjust(name.removeprefix(_BRIDGE), value)
        else:
            adjust(self.control, name, value)

    def _next(self, timeout_s: float) -> RawFrame:
        deadline_s = self.clock.now() + timeout_s
        while True:
            frame = self._images.read(max(0.0, deadline_s - self.clock.now()))
            if self._unsettled == 0:
                return frame
            self._unsettled -= 1
            if self.clock.now() >= deadline_s:
                raise DeviceStalled(f"only frames that began with the settings before came within {timeout_s:g} s")

    def _plan(self, asked: CameraSettings) -> _Plan:
        options = self._options
        if asked.bits not in BITS:
            raise UsageError(f"frames of {asked.bits} bits are asked; the MS3100 gives 8 or 10")
        if asked.trigger != "free-running" and options.trigger_mode == "free-running":
            self.control.set_trigger_mode(asked.trigger)
        if asked.trigger == "free-running" and options.trigger_mode == "external":
            self.control.set_trigger_mode(asked.trigger)
        self._check_channel(asked)
        lines = self.control.lines_of(asked.exposure_us * 1e-6)
        exposure_us = round(self.control.seconds_of(lines) * 1e6, 6)
        # The gain is the CCDs', whatever brings the frames; which plane a mono output shows, only the camera knows.
        channel: CameraChannel = "rgb" if options.output == "rgb" else "white"
        images = replace(asked, exposure_us=exposure_us, gain_db=0.0, channel=channel)
        colours = (_colour(asked.channel),) if asked.channel in COLOURS else COLOURS
        offsets = {c: value for c in colours if (value := getattr(options.offset, c)) is not None}
        gains, gain_db = self._gains(asked.gain_db, colours)
        return _Plan(lines, gains, gain_db, offsets, colours, images)

    def _check_channel(self, asked: CameraSettings) -> None:
        output = self._options.output
        possible = ("rgb", *COLOURS) if output == "rgb" else (output,)
        if asked.channel not in possible:
            raise UsageError(
                f"channel {asked.channel!r} is asked; the camera's output mode is {output!r}, which gives "
                f"{', '.join(possible)}. Ask for one of them, or set the output mode with the maker's software (its "
                "bytes are not known) and camera.options.output to match"
            )

    def _gains(self, gain_db: float, colours: tuple[Colour, ...]) -> tuple[dict[Colour, int], float]:
        """Return the raw gains that `gain_db` means, and the decibels that they are."""
        options, most = self._options, self.control.settings.gain_max
        known = {c: value for c in colours if (value := getattr(options.gain, c)) is not None}
        if gain_db == 0:
            return known, 0.0
        if not options.gain_step_db or len(known) < len(colours):
            raise UsageError(
                f"a gain of {gain_db:g} dB is asked; the dB scale of the MS3100's gain is not known. Ask for 0 dB and "
                "set camera.options.gain (raw), or measure a step and set camera.options.gain_step_db and the gain of "
                f"{', '.join(colours)} at 0 dB"
            )
        steps = round(gain_db / options.gain_step_db)
        gains = {colour: value + steps for colour, value in known.items()}
        if not 0 <= min(gains.values()) <= max(gains.values()) <= most:
            raise UsageError(f"a gain of {gain_db:g} dB is asked, raw {gains}; the raw gain must be 0 to {most}")
        return gains, steps * options.gain_step_db

    def _check_size(self) -> None:
        if self._images.size_px != self.size_px:
            width, height = self._images.size_px
            raise DeviceError(
                f"the image transport delivers {width} x {height}; the MS3100 has {self.size_px[0]} x "
                f"{self.size_px[1]}: set its width and height to that (another model, such as the MS4100 with 1916 x "
                "1078, is not driven by this driver)"
            )

    def _check_brought(self, asked: CameraSettings, brought: CameraSettings) -> None:
        for what in ("bits", "channel", "trigger"):
            wanted, found = getattr(asked, what), getattr(brought, what)
            if wanted != found:
                self._images.disarm()
                raise DeviceError(
                    f"the image transport delivers {what} {found!r} where {wanted!r} is asked: set its pixel format to "
                    "what the camera sends (Mono8, Mono10, RGB8 or RGB10)"
                )

    def _armed(self) -> CameraSettings:
        if self._settings is None:
            raise DeviceError("the camera is not armed: call arm first")
        return self._settings


def _colour(channel: str) -> Colour:
    return next(colour for colour in COLOURS if colour == channel)


def create(options: DuncanTechOptions, context: Any) -> DuncanTechCamera:
    """Build the camera and its image transport; nothing is opened.

    Raises
    ------
    ConfigurationError
        options that contradict each other, or no such image transport.
    """
    from fringed.devices.building import BUILT_IN, built_in

    settings = control_settings(options)
    driver = built_in("camera", options.images.driver) if options.images.driver != DUNCANTECH.name else None
    if driver is None:
        allowed = ", ".join(sorted(set(BUILT_IN["camera"]) - {DUNCANTECH.name})) or "none here"
        problem = Problem("camera.options.images.driver", repr(options.images.driver), f"one of {allowed}")
        raise ConfigurationError("1 problem:", (problem,))
    chosen = validate(options.images.options, driver.Options, "camera.options.images.options")
    images: Camera = driver.create(chosen, context)
    port = traced(SerialPort(options.port, SerialSettings(options.baud)))
    return DuncanTechCamera(DuncanTechControl(port, settings), images, options)


DUNCANTECH = Driver(
    "duncantech", DuncanTechOptions, create, "DuncanTech MS3100: settings by RS-232, frames by another driver"
)
