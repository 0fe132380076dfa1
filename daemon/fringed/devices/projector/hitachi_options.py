"""The options of the driver "hitachi", and the line and control that they mean.

Owns the names, limits and what may not be combined; opens nothing. What is marked [A] is assumed: nobody published it.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, field

from fringed.devices.projector.hitachi_control import ControlSettings, HitachiControl
from fringed.devices.projector.hitachi_line import HitachiLine, LineTimes, NetworkFraming, SerialFraming
from fringed.devices.projector.hitachi_picture import SETTINGS
from fringed.devices.projector.hitachi_power import LampTimes
from fringed.errors import ConfigurationError, Problem
from fringed.hookspecs import Clock, Params
from fringed.protocols.hitachi_network import FRAMED_PORT, IDLE_S, RAW_PORT
from fringed.transports.base import Transport
from fringed.transports.serial_port import SerialPort, SerialSettings
from fringed.transports.tcp import TcpPort
from fringed.transports.tracing import traced

_S = {"units": "s"}
SettingName = Literal["picture mode", "gamma", "keystone", "magnify", "frame lock"]


class HitachiOptions(Params, frozen=True):
    """Options of the driver "hitachi": either `port` (serial) or `host` (network)."""

    port: Annotated[str, Meta(description="serial port: a path, usb:serial=…, usb:location=…; empty: the network")] = ""
    baud: Annotated[int, Meta(gt=0, le=4_000_000, description="of the serial port")] = 19200
    host: Annotated[str, Meta(description="name or address of a network model; empty: the serial port")] = ""
    tcp_port: Annotated[int, Meta(ge=1, le=65535, description="23: plain frames; 9715: wrapped frames")] = RAW_PORT
    framing: Annotated[
        Literal["auto", "plain", "wrapped"], Meta(description="auto: wrapped on TCP 9715, else plain")
    ] = "auto"
    password: Annotated[str, Meta(description="of the network port; empty where authentication is off")] = ""
    input: Annotated[Literal["rgb1", "rgb2"], Meta(description="where the computer is plugged in")] = "rgb1"
    power_on: Annotated[bool, Meta(description="switch the lamp on when the station finds it off")] = True
    check_picture: Annotated[bool, Meta(description="refuse to measure unless the picture is neutral")] = True
    reset_picture: Annotated[bool, Meta(description="reset what is not neutral instead of refusing")] = False
    unchecked: Annotated[
        list[SettingName], Meta(description="settings that are not judged, after a look into the projector's menu")
    ] = field(default_factory=list)
    neutral: Annotated[
        dict[str, Annotated[int, Meta(ge=0, le=65535)]],
        Meta(description="[A] other neutral numbers, by the setting's name, such as { keystone = 128 }"),
    ] = field(default_factory=dict)
    panel_px: Annotated[
        tuple[Annotated[int, Meta(ge=64, le=16384)], Annotated[int, Meta(ge=64, le=16384)]],
        Meta(description="the panel; a video output of another size is refused"),
    ] = (1024, 768)
    reply_timeout_s: Annotated[float, Meta(gt=0, le=10, description="[A] for a reply", extra_json_schema=_S)] = 0.5
    attempts: Annotated[int, Meta(ge=1, le=20, description="how often a command is sent at most")] = 4
    warm_up_s: Annotated[
        float, Meta(gt=0, le=600, description="[A] usual warm-up; four times that is a fault", extra_json_schema=_S)
    ] = 30.0
    cool_down_s: Annotated[float, Meta(gt=0, le=1200, description="[A] usual cool-down", extra_json_schema=_S)] = 90.0
    keep_alive_s: Annotated[
        float,
        Meta(
            gt=0, lt=IDLE_S, description="a look at least so often; TCP 9715 hangs up after 30 s", extra_json_schema=_S
        ),
    ] = 10.0
    recheck_s: Annotated[
        float,
        Meta(ge=0, le=86400, description="before a set, lamp and picture are checked again after so long",
             extra_json_schema=_S),
    ] = 60.0  # fmt: skip
    output_driver: Annotated[str, Meta(min_length=1, description="the driver of the video output")] = "window"
    output: Annotated[dict[str, Any], Meta(description="options of the video output")] = field(default_factory=dict)


def transport_of(options: HitachiOptions) -> Transport:
    """Return the closed transport; raises ConfigurationError where it is not clear which one is meant."""
    if bool(options.port) == bool(options.host):
        seen = "both port and host" if options.port else "neither port nor host"
        allowed = "one of them: port = '/dev/serial/by-id/…' (serial) or host = '10.0.0.5' (network)"
        raise ConfigurationError("1 problem:", (Problem("projector.options", seen, allowed),))
    if options.port:
        if options.password:
            problem = Problem("projector.options.password", "a password", "none: serial ports know no passwords")
            raise ConfigurationError("1 problem:", (problem,))
        return traced(SerialPort(options.port, SerialSettings(options.baud)))
    return traced(TcpPort(options.host, options.tcp_port))


def control_of(options: HitachiOptions, transport: Transport, clock: Clock) -> HitachiControl:
    """Return the control of the projector at that transport; nothing is opened."""
    unknown = [name for name in options.neutral if name not in SETTINGS]
    if unknown:
        problems = tuple(
            Problem(f"projector.options.neutral.{name}", "this key", f"one of {', '.join(SETTINGS)}")
            for name in unknown
        )
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)}:", problems)
    wrapped = options.framing == "wrapped" or (
        options.framing == "auto" and bool(options.host) and options.tcp_port == FRAMED_PORT
    )
    times = LineTimes(reply_s=options.reply_timeout_s, attempts=options.attempts)
    line = HitachiLine(transport, NetworkFraming() if wrapped else SerialFraming(), clock, times, options.password)
    settings = ControlSettings(
        options.input, LampTimes(options.warm_up_s, options.cool_down_s), options.neutral, tuple(options.unchecked)
    )
    return HitachiControl(line, clock, settings)
