"""The DuncanTech MS3100's serial control: gain, offset and integration time of each CCD, over any transport.

Owns what is sent when, how often, and how long an answer is waited for; the bytes are `protocols.duncantech`'s.
Knows nothing of frames. Every call ends: with the value in force, or with an error that says why not.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Literal, NoReturn

from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError
from fringed.protocols.duncantech import (
    LINES,
    OFFSETS,
    Colour,
    Command,
    Dialect,
    Done,
    GetGain,
    GetIntegration,
    GetOffset,
    SetGain,
    SetIntegration,
    SetOffset,
    Value,
    answers,
    encode,
    parse_answer,
)
from fringed.protocols.duncantech_frames import Frame, FrameDecoder
from fringed.transports.base import Transport

COLOURS: tuple[Colour, ...] = ("red", "green", "blue")
_DRAIN_READS = 64  # a port that never falls silent is not drained for good


@dataclass(frozen=True)
class ControlSettings:
    """How the control behaves: `line_us` is verified as "about 125", time-out and largest gain are assumed [A]."""

    dialect: Dialect = field(default_factory=Dialect)
    reply_timeout_s: float = 0.5
    retries: int = 2
    line_us: float = 125.0
    gain_max: int = 1023


@dataclass(frozen=True)
class Parameter:
    """One thing that can be read or set; `verified` says of reading and of setting whether the bytes are."""

    name: Literal["gain", "offset", "integration"]
    units: str
    low: int
    high: int
    verified: tuple[bool, bool]


class DuncanTechControl:
    """The camera's serial line. Used by one thread; `close` may be called by another one."""

    def __init__(self, transport: Transport, settings: ControlSettings | None = None) -> None:
        self.settings = settings or ControlSettings()
        self._transport, self._decoder = transport, FrameDecoder()
        self._open, self._late = False, 0
        self.retried = 0  # commands that had to be sent again
        self.reopened = 0  # ports that were opened again under way

    @property
    def name(self) -> str:
        """What messages call its port."""
        return self._transport.name

    def parameters(self) -> tuple[Parameter, ...]:
        """Return what can be set on each CCD, with units and limits."""
        return (
            Parameter("gain", "raw; decibels per step unknown", 0, self.settings.gain_max, (False, True)),
            Parameter("offset", "raw", *OFFSETS, verified=(True, False)),
            Parameter("integration", f"lines of {self.settings.line_us:g} us", *LINES, verified=(False, True)),
        )

    def open(self) -> str:
        """Open the port, ask for an offset, and return who answered.

        Raises
        ------
        DeviceAbsent
            there is no such port, or it may not be used.
        DeviceStalled, ProtocolError
            nothing answers there, or something that is no MS3100.
        """
        self._transport.open()
        self._decoder, self._open, self._late = FrameDecoder(), True, 0
        try:
            value = self.offset("green")
        except DeviceError:
            self.close()
            raise
        return f"DuncanTech MS3100 on {self.name} (answers 'get offset' with {value}; its identity cannot be asked for)"

    def close(self) -> None:
        """Release the port; harmless when closed."""
        self._open = False
        self._transport.close()

    def check(self) -> None:
        """Notice a port that has vanished; costs no time. Raises DeviceAbsent."""
        self._require_open()
        self._drain()

    def gain(self, colour: Colour) -> int:
        """Read a CCD's gain (raw) [A]; raises UsageError unless unverified commands are enabled."""
        return self._value(GetGain(self._channel(colour)))

    def offset(self, colour: Colour) -> int:
        """Read a CCD's offset, 0 to 127."""
        return self._value(GetOffset(self._channel(colour)))

    def integration_lines(self, colour: Colour) -> int:
        """Read a CCD's integration time in lines [A]; raises UsageError unless unverified commands are enabled."""
        return self._value(GetIntegration(self._channel(colour)))

    def set_gain(self, colour: Colour, value: int) -> int:
        """Set a CCD's gain (raw) and return the one in force."""
        if not 0 <= value <= self.settings.gain_max:
            raise UsageError(
                f"gain {value} is asked of the {colour} CCD; it must be 0 to {self.settings.gain_max} (the upper limit "
                "is assumed: gain_max in the camera's options)"
            )
        channel = self._channel(colour)
        return self._set(SetGain(channel, value), GetGain(channel), value)

    def set_offset(self, colour: Colour, value: int) -> int:
        """Set a CCD's offset and return the one in force; nothing unverified is sent where it is so already."""
        channel = self._channel(colour)
        command = SetOffset(channel, value)
        command.arguments()
        if self.offset(colour) == value:
            return value
        return self._set(command, GetOffset(channel), value)

    def set_integration_lines(self, colour: Colour, lines: int) -> int:
        """Set a CCD's integration time in lines and return the one in force."""
        channel = self._channel(colour)
        return self._set(SetIntegration(channel, lines), GetIntegration(channel), lines)

    def lines_of(self, seconds: float) -> int:
        """Return the number of lines nearest to an integration time; raises UsageError beyond the limits."""
        line_s = self.settings.line_us * 1e-6
        lines = round(seconds / line_s) if 0 <= seconds < 1e3 else -1
        if not LINES[0] <= lines <= LINES[1]:
            raise UsageError(
                f"an integration time of {seconds * 1e6:.6g} us is asked; the MS3100 takes {LINES[0]} to {LINES[1]} "
                f"lines of {self.settings.line_us:g} us, {LINES[0] * self.settings.line_us:.6g} to "
                f"{LINES[1] * self.settings.line_us:.6g} us"
            )
        return lines

    def seconds_of(self, lines: int) -> float:
        """Return the integration time of so many lines."""
        return lines * self.settings.line_us * 1e-6

    def set_integration_s(self, colour: Colour, seconds: float) -> float:
        """Set the integration time nearest to `seconds` and return the one in force."""
        return self.seconds_of(self.set_integration_lines(colour, self.lines_of(seconds)))

    def set_trigger_mode(self, mode: str) -> NoReturn:
        """Refuse: its bytes are not known."""
        _refuse(f"trigger mode {mode!r}", "trigger_mode")

    def set_output_mode(self, mode: str) -> NoReturn:
        """Refuse: its bytes are not known."""
        _refuse(f"output mode {mode!r}", "output")

    def _value(self, command: Command) -> int:
        answer = self._exchange(command)
        if not isinstance(answer, Value):
            raise ProtocolError(f"{self.name}: {command} was answered without a value")
        return answer.value

    def _set(self, command: Command, read: Command, value: int) -> int:
        """Send a set, and read back what can be read; the camera's word counts."""
        dialect = self.settings.dialect
        for _ in range(self.settings.retries + 1):
            self._exchange(command)
            if not (dialect.unverified or isinstance(read, GetOffset)):
                if dialect.set_answer == "none":  # a camera that answers nothing may as well be gone
                    self._value(GetOffset(command.channel))
                return value
            found = self._value(read)
            if found == value:
                return found
        raise ProtocolError(f"{self.name}: {command} was sent {self.settings.retries + 1} times; {read} reads {found}")

    def _exchange(self, command: Command) -> Value | Done:
        self._require_open()
        data, attempts, reopened = encode(command, self.settings.dialect), 0, False
        self._settle()
        while True:
            try:
                self._drain()
                self._transport.write(data)
                return self._answer(command)
            except (ProtocolError, DeviceStalled) as error:
                attempts += 1
                if attempts > self.settings.retries:
                    raise type(error)(f"{self._said(error)} (sent {attempts} times)") from error
                self.retried += 1
            except DeviceAbsent as error:
                if reopened or not self._open:
                    self._open = False
                    why = "vanished again" if reopened else "was closed"
                    raise DeviceAbsent(
                        f"{self.name} {why} during {command}: {error.message}; check its plug, then open it again"
                    ) from error
                reopened = True
                self._reopen()

    def _reopen(self) -> None:
        """Open the port once more: an adapter that was pulled and plugged again is back."""
        self._transport.close()
        try:
            self._transport.open()
        except DeviceError:
            self._open = False
            raise
        self._decoder, self._late = FrameDecoder(), 0
        self.reopened += 1

    def _answer(self, command: Command) -> Value | Done:
        if not command.answer_width and self.settings.dialect.set_answer == "none":
            return Done()
        before, others = self._decoder.discarded, 0
        self._late += 1
        deadline_s = time.monotonic() + self.settings.reply_timeout_s
        while True:
            left_s = deadline_s - time.monotonic()
            found = self._read(left_s) if left_s > 0 else self._decoder.finish()
            for frame in found:
                self._late = max(0, self._late - 1)
                if answers(frame, command, self.settings.dialect):
                    return parse_answer(frame, command, self.settings.dialect)
                others += 1
            if left_s <= 0:
                raise self._silence(command, self._decoder.discarded - before, others)

    def _silence(self, command: Command, noise: int, others: int) -> DeviceError:
        limit = f"{self.name}: no answer to {command} within {self.settings.reply_timeout_s:g} s"
        if others or noise:
            return ProtocolError(
                f"{limit}, but {others} other frames and {noise} bytes that are none: check the baud rate (9600 8N1 is "
                "recalled, not confirmed), and that the MS3100 is what is on this port"
            )
        return DeviceStalled(f"{limit}: check that the camera has power, the cable, its direction and the baud rate")

    def _settle(self) -> None:
        """Let late answers of repeated commands arrive, so that none is taken for the next command's."""
        deadline_s = time.monotonic() + self.settings.reply_timeout_s
        while self._late and (left_s := deadline_s - time.monotonic()) > 0:
            try:
                self._late = max(0, self._late - len(self._read(left_s)))
            except DeviceAbsent:  # the exchange that follows opens it again
                break
        self._late = 0

    def _read(self, timeout_s: float) -> tuple[Frame, ...]:
        return self._decoder.feed(self._transport.read(timeout_s))

    def _drain(self) -> None:
        for _ in range(_DRAIN_READS):
            chunk = self._transport.read(0.0)
            if not chunk:
                break
            self._late = max(0, self._late - len(self._decoder.feed(chunk)))
        self._decoder.finish()

    def _channel(self, colour: Colour) -> int:
        if colour not in COLOURS:
            raise UsageError(f"the MS3100 has no {colour!r} CCD; it has {', '.join(COLOURS)}")
        return self.settings.dialect.channels[colour]

    def _said(self, error: DeviceError) -> str:
        return error.message if error.message.startswith(self.name) else f"{self.name}: {error.message}"

    def _require_open(self) -> None:
        if not self._open:
            raise DeviceAbsent(f"the MS3100's control on {self.name} is closed or has vanished: open it")


def _refuse(what: str, option: str) -> NoReturn:
    raise UsageError(
        f"{what} of the MS3100 cannot be set: the bytes that do it are not known; set it with the maker's software, "
        f"let the camera keep it, and say so by `{option}` in the camera's options (docs/devices/duncantech.md)"
    )
