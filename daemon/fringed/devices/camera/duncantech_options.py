"""The options of the driver `duncantech`: every assumption about the MS3100 that a lab may have to correct.

[V] is verified, [R] recalled, [A] assumed; what is not [V] is a setting here and an assumption nowhere else.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from fringed.devices.camera.duncantech_control import ControlSettings
from fringed.errors import ConfigurationError, Problem, UsageError
from fringed.hookspecs import Params
from fringed.protocols.duncantech import UNVERIFIED, Dialect

WIDTH_PX, HEIGHT_PX = 1392, 1040  # [V]
Output = Literal["rgb", "red", "green", "blue", "white"]


def _units(units: str) -> dict[str, Any]:
    return {"units": units}


class ImageTransport(Params, frozen=True, kw_only=True):
    """What brings the frames: one of our camera drivers, and its options."""

    driver: Annotated[str, Meta(min_length=1, description="the driver that brings the frames, such as usb3vision")]
    options: dict[str, Any] = msgspec.field(default_factory=dict)


class Channels(Params, frozen=True, kw_only=True):
    """The channel byte of each CCD [A: numbered as the output multiplexer numbers its arrays]."""

    red: Annotated[int, Meta(ge=1, le=3)] = 2
    green: Annotated[int, Meta(ge=1, le=3)] = 1
    blue: Annotated[int, Meta(ge=1, le=3)] = 3


class Gains(Params, frozen=True, kw_only=True):
    """The gain of each CCD at 0 dB, raw; unset: left as it is."""

    red: Annotated[int, Meta(ge=0, le=65535)] | None = None
    green: Annotated[int, Meta(ge=0, le=65535)] | None = None
    blue: Annotated[int, Meta(ge=0, le=65535)] | None = None


class Offsets(Params, frozen=True, kw_only=True):
    """The offset of each CCD, raw; unset: left as it is. Setting one needs `enable_unverified`."""

    red: Annotated[int, Meta(ge=0, le=127)] | None = None
    green: Annotated[int, Meta(ge=0, le=127)] | None = None
    blue: Annotated[int, Meta(ge=0, le=127)] | None = None


class Opcodes(Params, frozen=True, kw_only=True):
    """The opcodes that nobody has confirmed [A], correctable here."""

    get_gain: Annotated[int, Meta(ge=0, le=255)] = UNVERIFIED["get_gain"]
    set_offset: Annotated[int, Meta(ge=0, le=255)] = UNVERIFIED["set_offset"]
    get_integration: Annotated[int, Meta(ge=0, le=255)] = UNVERIFIED["get_integration"]


class DuncanTechOptions(Params, frozen=True, kw_only=True):
    """The MS3100's own options (`camera.options`)."""

    port: Annotated[
        str,
        Meta(min_length=1, description="serial port of the control: a path, usb:serial=…, usb:location=… or usb:id=…"),
    ]
    images: ImageTransport
    baud: Annotated[int, Meta(ge=1200, le=115200, description="[R]; 8N1", extra_json_schema=_units("baud"))] = 9600
    enable_unverified: Annotated[
        bool, Meta(description="send opcodes that are assumed: read gain and integration time back, set offsets")
    ] = False
    opcodes: Opcodes = Opcodes()
    channels: Channels = Channels()
    status_ok: Annotated[int, Meta(ge=0, le=255, description="[A] the status byte that means success")] = 0
    set_answer: Annotated[
        Literal["status", "any", "none"], Meta(description="[A] what follows a set: a status, any frame, or nothing")
    ] = "status"
    reply_timeout_s: Annotated[float, Meta(gt=0, le=10, description="[A]", extra_json_schema=_units("s"))] = 0.5
    retries: Annotated[int, Meta(ge=0, le=10, description="how often a command is sent again")] = 2
    line_us: Annotated[
        float,
        Meta(ge=50, le=500, description="[V: about 125] what a line lasts", extra_json_schema=_units("us")),
    ] = 125.0
    gain: Gains = Gains()
    gain_max: Annotated[int, Meta(ge=1, le=65535, description="[A] the largest gain, raw")] = 1023
    gain_step_db: Annotated[
        float,
        Meta(
            ge=0,
            le=10,
            description="[A] dB of one step of the gain; 0: unknown, so only 0 dB can be asked for",
            extra_json_schema=_units("dB"),
        ),
    ] = 0.0
    offset: Offsets = Offsets()
    output: Annotated[
        Output, Meta(description="what the camera's output mode sends; set it with the maker's software")
    ] = "rgb"
    trigger_mode: Annotated[
        Literal["free-running", "external"],
        Meta(description="the camera's trigger mode (CC1 or BNC: external); set it with the maker's software"),
    ] = "free-running"
    settle_frames: Annotated[
        int, Meta(ge=0, le=20, description="[A] free-running frames that may still have the settings before")
    ] = 1
    width_px: Annotated[int, Meta(ge=16, le=8192, extra_json_schema=_units("px"))] = WIDTH_PX
    height_px: Annotated[int, Meta(ge=16, le=8192, extra_json_schema=_units("px"))] = HEIGHT_PX


def control_settings(options: DuncanTechOptions) -> ControlSettings:
    """Return how the control behaves with these options.

    Raises
    ------
    ConfigurationError
        opcodes or channels that cannot be told apart, or gains beyond the largest.
    """
    try:
        dialect = Dialect(
            options.enable_unverified,
            msgspec.to_builtins(options.opcodes),
            msgspec.to_builtins(options.channels),
            options.set_answer,
            options.status_ok,
        )
    except UsageError as error:
        raise ConfigurationError(f"camera.options: {error.message}") from error
    problems = tuple(
        Problem(f"camera.options.gain.{colour}", str(value), f"0 to gain_max = {options.gain_max}")
        for colour, value in msgspec.to_builtins(options.gain).items()
        if value is not None and value > options.gain_max
    )
    if problems:
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)}:", problems)
    return replace(
        ControlSettings(dialect),
        reply_timeout_s=options.reply_timeout_s,
        retries=options.retries,
        line_us=options.line_us,
        gain_max=options.gain_max,
    )
