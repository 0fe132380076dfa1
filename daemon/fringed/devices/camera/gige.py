"""The driver `gige`: cameras with GigE Vision or USB3 Vision, by GenICam and Aravis.

Owns the state of the camera and its options. When a frame was exposed is told from its arrival and the camera's own
clock, as a window that holds the exposure.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import replace
from typing import Annotated, Any

from msgspec import Meta

from fringed.data import CameraSettings
from fringed.devices.camera.base import MachineClock, checked_image
from fringed.devices.camera.gige_aravis import AravisPort
from fringed.devices.camera.gige_pixels import BY_CODE, image_of
from fringed.devices.camera.gige_port import STATUS, Delivery, GenicamPort
from fringed.devices.camera.gige_settings import InForce, Region, Wishes, apply
from fringed.devices.camera.gige_times import CameraTime, FrameIds
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.hookspecs import Clock, Driver, Params, RawFrame

LOOK_S = 0.3  # so long without a buffer, and it is asked whether the camera is still there


def _units(units: str) -> dict[str, Any]:
    return {"units": units}


class GigeOptions(Params, frozen=True, kw_only=True):
    """The GenICam camera's own options (`camera.options`). [A] marks what nobody has measured on your camera."""

    device: Annotated[
        str, Meta(description="its name (Vendor-Model-Serial), serial number, MAC or IP address; nothing: the only one")
    ] = ""
    width_px: Annotated[int, Meta(ge=0, description="0: all", extra_json_schema=_units("px"))] = 0
    height_px: Annotated[int, Meta(ge=0, description="0: all", extra_json_schema=_units("px"))] = 0
    x_px: Annotated[int, Meta(ge=0, description="left edge", extra_json_schema=_units("px"))] = 0
    y_px: Annotated[int, Meta(ge=0, description="upper edge", extra_json_schema=_units("px"))] = 0
    fps: Annotated[
        float, Meta(ge=0, description="free-running; 0: as the camera is set", extra_json_schema=_units("1/s"))
    ] = 0.0
    trigger_line: Annotated[str, Meta(min_length=1, description="TriggerSource of trigger 'hardware'")] = "Line1"
    gain_step_db: Annotated[
        float, Meta(ge=0, description="[A] dB of one step, for cameras whose gain counts in steps; 0: unknown")
    ] = 0.0
    full_well_electrons: Annotated[
        float, Meta(ge=0, description="[A] saturation capacity of its data sheet, reached at 0 dB; 0: unknown")
    ] = 0.0
    dark_noise_electrons: Annotated[float, Meta(ge=0, description="[A] temporal dark noise of its data sheet")] = 0.0
    delay_ms: Annotated[
        float,
        Meta(
            ge=0,
            description="[A] from the exposure's end to the first byte, at most",
            extra_json_schema=_units("ms"),
        ),
    ] = 1.0
    packet_bytes: Annotated[
        int, Meta(ge=0, le=16110, description="GigE Vision packets; 0: what the network lets through")
    ] = 0
    buffers: Annotated[int, Meta(ge=2, le=256, description="frames that may wait")] = 8


class GigeCamera:
    """A GenICam camera behind `port`."""

    simulated = False
    replayed = False

    def __init__(self, options: GigeOptions, port: GenicamPort, clock: Clock | None = None) -> None:
        self.clock: Clock = clock or MachineClock()
        self._options, self._port = options, port
        self._identity = ""
        self._in_force: InForce | None = None
        self._size_px = (options.width_px, options.height_px)
        self._ids, self._time = FrameIds(), CameraTime()
        self._triggered_s: float | None = None
        self.incomplete: Counter[str] = Counter()

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its frames; what the options say until it is armed."""
        return self._size_px

    @property
    def period_s(self) -> float:
        """Shortest time from frame to frame with the settings in force."""
        if self._in_force is not None:
            return self._in_force.period_s
        return 1.0 / self._options.fps if self._options.fps else 0.0

    def open(self) -> str:
        """Open it and return the identity; one that does not answer any more is opened afresh.

        Raises
        ------
        DeviceAbsent
            no such camera, another program controls it, or the library is missing.
        """
        if self._identity and not self._port.alive():
            self.close()
        if not self._identity:
            self._identity = self._port.open(self._options.device)
        return self._identity

    def close(self) -> None:
        """Release everything; harmless when closed."""
        with suppress(DeviceError):
            self.disarm()
        self._identity = ""
        self._port.close()

    def arm(self, settings: CameraSettings) -> CameraSettings:
        """Set the camera, start it and return the settings in force.

        Raises
        ------
        UsageError
            a value that the camera cannot have; it says which it can.
        DeviceError
            a feature that does not take its value.
        """
        self._check_open()
        self._look()
        self.disarm()
        options = self._options
        region = Region(options.width_px, options.height_px, options.x_px, options.y_px)
        wishes = Wishes(region, options.fps, options.trigger_line, options.gain_step_db)
        in_force = apply(self._port, settings, wishes)
        self._ids.restart()
        self._time.restart()
        self._triggered_s = None
        self.incomplete.clear()
        self._port.start(options.buffers)
        self._port.execute("AcquisitionStart")
        in_force = replace(in_force, settings=self._with_noise(in_force.settings))
        self._size_px, self._in_force = in_force.size_px, in_force
        return in_force.settings

    def disarm(self) -> None:
        """Stop acquisition; harmless when not armed; raises DeviceAbsent for a camera that is gone."""
        if self._in_force is not None:
            self._in_force = None
            self._look()
            try:
                self._port.execute("AcquisitionStop")
            finally:
                self._port.stop()

    def trigger(self) -> None:
        """Start one integration; with trigger "hardware" the line does that, and this only forgets what is waiting."""
        in_force = self._armed()
        if in_force.settings.trigger == "free-running":
            raise UsageError("the camera runs freely; arm it with trigger 'software' or 'hardware' to trigger it")
        self._look()  # a command to a camera that is gone would take 5 s to fail
        while self._port.pop(0.0) is not None:  # whatever is left of the past
            pass
        if in_force.settings.trigger == "software":
            self._triggered_s = self.clock.now()
            self._port.execute("TriggerSoftware")

    def read(self, timeout_s: float) -> RawFrame:
        """Return the next frame. Incomplete ones are passed over and show as a gap in the counters.

        Raises
        ------
        DeviceStalled
            no complete frame came within `timeout_s`; it says what came instead.
        DeviceAbsent
            the camera does not answer any more.
        ProtocolError
            a frame that was triggered by software came incomplete, or what came is no frame of the format that was set.
        """
        in_force = self._armed()
        end_s = self.clock.now() + timeout_s
        while True:
            delivery = self._port.pop(min(LOOK_S, max(0.0, end_s - self.clock.now())))
            if delivery is None:
                self._look()
            elif (frame := self._frame(delivery, in_force)) is not None:
                return frame
            if self.clock.now() >= end_s:
                raise DeviceStalled(f"no frame within {timeout_s:g} s{self._why(in_force)}")

    def _with_noise(self, settings: CameraSettings) -> CameraSettings:
        """Return the settings with the sensor's noise, where the options tell it."""
        top = self._options.full_well_electrons / 10 ** (settings.gain_db / 20)
        if not top:
            return settings
        return replace(
            settings,
            electrons_per_dn=top / (2**settings.bits - 1),
            read_noise_electrons=self._options.dark_noise_electrons,
        )

    def _frame(self, delivery: Delivery, in_force: InForce) -> RawFrame | None:
        counter = self._ids.count(delivery.frame_id)
        if not delivery.complete:
            reason = STATUS.get(delivery.status, f"of state {delivery.status}")
            self.incomplete[reason] += 1
            if in_force.settings.trigger != "software":  # the next one comes by itself
                return None
            raise ProtocolError(f"frame {counter} came {reason}{self._losses()}")
        if (delivery.size_px, BY_CODE.get(delivery.pixel_code)) != (in_force.size_px, BY_CODE[in_force.form.code]):
            form = BY_CODE.get(delivery.pixel_code)
            raise ProtocolError(
                f"the camera delivered {delivery.size_px[0]} x {delivery.size_px[1]} in "
                f"{form.name if form else hex(delivery.pixel_code)}; it was set to {in_force.size_px[0]} x "
                f"{in_force.size_px[1]} in {in_force.form.name}: another program may have changed it; open it again"
            )
        channel = in_force.settings.channel
        image = image_of(delivery.data, in_force.size_px, in_force.form, channel)
        checked = checked_image(image, in_force.size_px, in_force.form.bits, 3 if channel == "rgb" else 1)
        return RawFrame(checked, counter, *self._window_s(delivery, in_force.settings.exposure_us * 1e-6))

    def _window_s(self, delivery: Delivery, exposure_s: float) -> tuple[float, float]:
        """Return a window that holds the exposure: it ended before the frame began to arrive, by `delay_ms` at most."""
        arrival_s = self._time.arrival_s(delivery.stamp_ns, delivery.arrived_s)
        start_s = arrival_s - self._options.delay_ms * 1e-3 - exposure_s
        if self._triggered_s is not None:
            start_s = max(start_s, self._triggered_s)  # no triggered exposure begins before its trigger
        return start_s, max(arrival_s, start_s + exposure_s)

    def _look(self) -> None:
        """Ask whether the camera is there; raises DeviceAbsent where it is not."""
        if not self._port.alive():
            identity = self._identity
            self.close()
            raise DeviceAbsent(f"the camera {identity} does not answer any more: check its power and its cable")

    def _why(self, in_force: InForce) -> str:
        if self.incomplete:
            told = ", ".join(f"{count} {reason}" for reason, count in self.incomplete.items())
            return f"; since it was armed, frames came incomplete: {told}{self._losses()}"
        if in_force.settings.trigger == "free-running":
            return ": the camera answers and sends nothing; look at the firewall (UDP), and at the packets' size"
        return f": check that the trigger ({in_force.settings.trigger}) reaches the camera"

    def _losses(self) -> str:
        counts = self._port.statistics()
        missing, received = counts.get("missing_packets", 0), counts.get("received_packets", 0)
        if not missing:
            return ""
        return (
            f" ({missing} of {missing + received} packets are missing): raise the network port's MTU to 9000 and "
            "net.core.rmem_max, lower camera.options.fps, or use a port of its own"
        )

    def _check_open(self) -> None:
        if not self._identity:
            raise DeviceAbsent("the camera is closed or has vanished: open it")

    def _armed(self) -> InForce:
        self._check_open()
        if self._in_force is None:
            raise DeviceError("the camera is not armed: call arm first")
        return self._in_force


def create(options: GigeOptions, context: Any) -> GigeCamera:
    """Build the driver; nothing is opened, and the library is not loaded yet."""
    return GigeCamera(options, AravisPort(options.packet_bytes), context.clock)


GIGE = Driver("gige", GigeOptions, create, "a GigE Vision or USB3 Vision camera, by Aravis")
