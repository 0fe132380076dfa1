"""A USB3 Vision camera's control side: who it is, its features, its stream's registers, its clock.

Owns which features and registers are used for what. Fetches no frames.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass

from fringed.data import CameraSettings
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.devices.camera.usb3vision_usb import Usb3VisionLink
from fringed.errors import ProtocolError, UsageError
from fringed.hookspecs import Clock
from fringed.protocols import u3v_registers as reg
from fringed.protocols.u3v import TransferPlan, plan_transfers
from fringed.protocols.u3v_features import Features
from fringed.protocols.u3v_genapi import parse_description
from fringed.protocols.u3v_pixels import BY_NAME, FORMATS, PixelFormat

_PACKINGS = {"none": 0, "lsb": 1, "gev": 2}
_RATES = ("AcquisitionResultingFrameRate", "ResultingFrameRate", "ResultingFrameRateAbs", "AcquisitionFrameRate")
_SYNC_TRIES = 5


@dataclass(frozen=True)
class Identity:
    """What the camera says of itself."""

    vendor: str
    model: str
    version: str
    serial: str

    def __str__(self) -> str:
        return f"{self.vendor} {self.model} {self.version} serial number {self.serial}"


class Usb3VisionControl:
    """One open camera."""

    def __init__(self, link: Usb3VisionLink, options: Usb3VisionOptions, clock: Clock) -> None:
        self._link, self._options, self._clock = link, options, clock
        sbrm = self._whole(reg.SBRM, 8)
        command, answer = (self._whole(sbrm + at) for at in (reg.MAX_COMMAND_BYTES, reg.MAX_ACKNOWLEDGE_BYTES))
        link.allow(command, answer, self._whole(reg.RESPONSE_TIME_MS) / 1000)
        self.identity = Identity(
            *(self._text(at) for at in (reg.VENDOR, reg.MODEL, reg.DEVICE_VERSION, reg.SERIAL_NUMBER))
        )
        self._sirm = self._whole(sbrm + reg.SIRM, 8)
        if not self._sirm:
            raise ProtocolError(f"the {self.identity} has no stream interface (SBRM + 0x20 is 0): is it a camera?")
        self.features = Features(parse_description(self._description()), link)
        self._tick_s = self._whole(reg.TIME_STAMP_INCREMENT, 8) * 1e-9
        self._offset_s = 0.0
        self.stop()
        self._set_size()

    def size_px(self) -> tuple[int, int]:
        """Return the width and the height in force."""
        return self.features.whole("Width"), self.features.whole("Height")

    def configure(self, asked: CameraSettings) -> tuple[CameraSettings, PixelFormat]:
        """Set what was asked; return what is in force, without its noise, and the format.

        Raises
        ------
        UsageError
            settings that this camera has not.
        """
        pixels = self.format_for(asked)
        self._set_if_there("AcquisitionMode", "Continuous")
        self.features.set("PixelFormat", pixels.name)
        for automatic in ("ExposureAuto", "GainAuto"):
            self._set_if_there(automatic, "Off")
        self._set_if_there("AcquisitionFrameRateEnable", 0)  # a limited rate would limit the exposure
        self._straighten()
        exposure_us, gain_db = self._set_exposure(asked.exposure_us), self._set_gain(asked.gain_db)
        self._set_trigger(asked.trigger)
        in_force = CameraSettings(
            exposure_us=exposure_us,
            gain_db=gain_db,
            bits=pixels.bits,
            channel=asked.channel,
            trigger=asked.trigger,
        )
        return in_force, pixels

    def format_for(self, asked: CameraSettings) -> PixelFormat:
        """Return the camera's format for these bits and this channel.

        One colour comes from an RGB format where there is one; a camera without delivers its only picture for it.
        """
        offered = [BY_NAME[name] for name in self.features.choices("PixelFormat") if name in BY_NAME]
        fitting = sorted((one for one in offered if one.bits == asked.bits), key=lambda one: _PACKINGS[one.packing])
        grey = next((one for one in fitting if one.channels == 1), None)
        colour = next((one for one in fitting if one.channels == 3), None)
        found = {"rgb": colour, "white": grey}.get(asked.channel, colour or grey)
        if found is None:
            names = ", ".join(one.name for one in offered) or "none of " + ", ".join(one.name for one in FORMATS)
            raise UsageError(
                f"{asked.bits} bits of channel {asked.channel!r} are asked; the camera has the formats {names}: ask "
                "for bits and a channel among these"
            )
        return found

    def start(self) -> TransferPlan:
        """Program the stream's registers, enable it and start; return the plan of its transfers."""
        info = self._whole(self._sirm + reg.STREAM_INFO)
        required = (
            self._whole(self._sirm + reg.REQUIRED_LEADER),
            self._whole(self._sirm + reg.REQUIRED_PAYLOAD, 8),
            self._whole(self._sirm + reg.REQUIRED_TRAILER),
        )
        plan = plan_transfers(required, reg.alignment_of(info), self._options.transfer_bytes)
        for offset, value in (
            (reg.LEADER_SIZE, plan.leader),
            (reg.PAYLOAD_SIZE, plan.payload),
            (reg.PAYLOAD_COUNT, plan.count),
            (reg.FINAL1_SIZE, plan.final1),
            (reg.FINAL2_SIZE, plan.final2),
            (reg.TRAILER_SIZE, plan.trailer),
            (reg.STREAM_CONTROL, reg.STREAM_ENABLE),
        ):
            self._link.write(self._sirm + offset, struct.pack("<I", value))
        self._set_if_there("TLParamsLocked", 1)
        self.features.execute("AcquisitionStart")
        return plan

    def stop(self) -> None:
        """Stop acquisition and stream."""
        if self.features.has("AcquisitionStop"):
            self.features.execute("AcquisitionStop")
        self._set_if_there("TLParamsLocked", 0)
        self._link.write(self._sirm + reg.STREAM_CONTROL, struct.pack("<I", 0))
        self._link.reset_stream()

    def trigger(self) -> None:
        """Start one integration."""
        self.features.execute("TriggerSoftware")

    def frame_rate_hz(self) -> float | None:
        """Return the rate that the camera says it reaches; None where it does not tell."""
        name = next((name for name in _RATES if self.features.has(name)), None)
        rate = float(self.features.number(name)) if name else 0.0
        return rate if rate > 0 else None

    def synchronise(self) -> float:
        """Learn how the camera's clock stands to the rig's; return how uncertain that is, in seconds.

        Raises
        ------
        ProtocolError
            the camera has no clock.
        """
        if not self._tick_s:
            raise ProtocolError(
                f"the {self.identity} tells no time (its time stamp increment is 0): set camera.options.time_stamps "
                "to 'arrival'"
            )
        best = float("inf")
        for _ in range(_SYNC_TRIES):
            before = self._clock.now()
            self._link.write(reg.TIME_STAMP_LATCH, struct.pack("<I", 1))
            after = self._clock.now()
            if after - before < best:
                best = after - before
                self._offset_s = (before + after) / 2 - self._whole(reg.TIME_STAMP, 8) * self._tick_s
        return best / 2

    def on_rig_clock(self, stamp: int) -> float:
        """Return when, on the rig's clock, the camera's clock stood at `stamp`."""
        return stamp * self._tick_s + self._offset_s

    def _set_size(self) -> None:
        for name, wanted in (("Width", self._options.width_px), ("Height", self._options.height_px)):
            if wanted:
                self.features.set(name, wanted)

    def _straighten(self) -> None:
        """Turn off what bends the numbers: phase is measured in light."""
        self._set_if_there("BalanceWhiteAuto", "Off")
        self._set_if_there("GammaEnable", 0)
        if self.features.has("Gamma") and not self.features.has("GammaEnable"):
            self.features.set("Gamma", 1)

    def _set_exposure(self, asked_us: float) -> float:
        name = self._options.exposure_feature
        if not name:  # a bridge: whoever sets the exposure answers for it
            return asked_us
        if not self.features.has(name):
            raise ProtocolError(
                f"the {self.identity} has no {name}: set camera.options.exposure_feature to what it calls its exposure "
                "in us, or to nothing where the exposure is set elsewhere"
            )
        self._set_within(name, asked_us, "us")
        return float(self.features.number(name))

    def _set_gain(self, asked_db: float) -> float:
        name = self._options.gain_feature
        if name and self.features.has(name):
            self._set_within(name, asked_db, "dB")
            return float(self.features.number(name))
        if asked_db:
            raise UsageError(f"a gain of {asked_db:g} dB is asked; the camera has no {name or 'gain'} here: ask for 0")
        return 0.0

    def _set_trigger(self, trigger: str) -> None:
        if trigger == "free-running" and not self.features.has("TriggerMode"):
            return
        for selector in self.features.choices("TriggerSelector"):
            if selector != "FrameStart":  # an acquisition or a burst that waits for its own trigger never begins
                with suppress(ProtocolError):
                    self.features.set("TriggerSelector", selector)
                    self.features.set("TriggerMode", "Off")
        self._set_if_there("TriggerSelector", "FrameStart")
        if trigger == "free-running":
            self.features.set("TriggerMode", "Off")
            return
        self.features.set("TriggerSource", "Software" if trigger == "software" else self._options.trigger_line)
        self.features.set("TriggerMode", "On")

    def _set_within(self, name: str, value: float, unit: str) -> None:
        low, high = self.features.limits(name)
        if not low <= value <= high:
            raise UsageError(f"{name} {value:g} {unit} is asked; this camera's goes from {low:g} to {high:g} {unit}")
        self.features.set(name, value)

    def _set_if_there(self, name: str, value: int | str) -> None:
        if self.features.has(name) and (isinstance(value, int) or value in self.features.choices(name)):
            self.features.set(name, value)

    def _description(self) -> str:
        table = self._whole(reg.MANIFEST, 8)
        count = self._whole(table, 8)
        if not 0 < count <= 64:
            raise ProtocolError(f"the {self.identity} lists {count} descriptions of itself; 1 to 64 make sense")
        entries, refusal = [], ProtocolError("no description")
        for index in range(count):
            try:
                entries.append(reg.decode_entry(self._link.read(table + 8 + 64 * index, 64)))
            except ProtocolError as error:  # of another kind: the camera may have one of ours beside it
                refusal = error
        if not entries:
            raise refusal
        newest = max(entries, key=lambda entry: entry.version)
        return reg.description_text(self._link.read(newest.address, newest.size), newest.zipped)

    def _text(self, address: int) -> str:
        return reg.text_of(self._link.read(address, reg.TEXT_BYTES))

    def _whole(self, address: int, size: int = 4) -> int:
        return int.from_bytes(self._link.read(address, size), "little")
