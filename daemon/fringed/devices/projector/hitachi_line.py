"""One command after the other over one transport: times, resending, resynchronising.

Owns when bytes are sent and how long is waited; knows nothing of what the commands are for. Replies have no
checksum and, on a serial line, no number. So after a time-out, noise or a reply of the wrong kind the line is read
until it is quiet before anything else is sent, and for some seconds after a time-out a value counts only when it is
answered twice: a late reply is not taken for the next one's.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from fringed.errors import DeviceError, DeviceStalled, ProtocolError
from fringed.hookspecs import Clock
from fringed.protocols.hitachi import (
    GAP_S,
    Ack,
    AuthenticationError,
    CannotExecute,
    Data,
    Event,
    ReplyDecoder,
    encode_command,
)
from fringed.protocols.hitachi_commands import Action, Command, Entry, entry_of
from fringed.protocols.hitachi_network import NONCE_SIZE, NetworkDecoder, answer_nonce, wrap_command
from fringed.transports.base import Transport

log = logging.getLogger(__name__)

Answer = Ack | CannotExecute | Data


@dataclass(frozen=True)
class LineTimes:
    """How long is waited. Only `gap_s` is published; the others are assumed."""

    reply_s: float = 0.5
    gap_s: float = GAP_S
    quiet_s: float = 0.1
    noise_s: float = 3.0
    late_s: float = 3.0
    attempts: int = 4


class Framing(Protocol):
    """Commands to bytes and bytes to events, for one kind of connection. `numbered`: a reply names its command."""

    numbered: bool

    def encode(self, command: Command) -> bytes:
        """Return the bytes of a command."""
        ...

    def feed(self, data: bytes) -> None:
        """Take bytes as they come."""

    def next_event(self) -> Event | None:
        """Return the reply to the last command; None when more bytes are needed."""
        ...

    def resynchronise(self) -> bytes:
        """Forget what is no event yet."""
        ...


class SerialFraming:
    """The serial line's, and TCP 23's."""

    numbered = False

    def __init__(self) -> None:
        self._decoder = ReplyDecoder()
        self.feed, self.next_event = self._decoder.feed, self._decoder.next_event
        self.resynchronise = self._decoder.resynchronise

    def encode(self, command: Command) -> bytes:
        """Return the 13 bytes of a command."""
        return encode_command(command)


class NetworkFraming:
    """TCP 9715's: replies that carry another command's id are late, and dropped."""

    numbered = True

    def __init__(self) -> None:
        self._decoder, self._id = NetworkDecoder(), 0
        self.feed, self.resynchronise = self._decoder.feed, self._decoder.resynchronise

    def encode(self, command: Command) -> bytes:
        """Return the 17 bytes of a command, with the next id."""
        self._id = (self._id + 1) & 0xFF
        return wrap_command(command, self._id)

    def next_event(self) -> Event | None:
        """Return the reply to the last command; None when more bytes are needed."""
        while (reply := self._decoder.next_reply()) is not None:
            if reply.id == self._id:
                return reply.event
        return None


class HitachiLine:
    """A projector's line. One thread uses it."""

    def __init__(
        self, transport: Transport, framing: Framing, clock: Clock, times: LineTimes, password: str = ""
    ) -> None:
        self._transport, self._framing, self._clock = transport, framing, clock
        self._times, self._password = times, password
        self._open, self._dirty, self._prefix = False, True, b""
        self._free_s = self._doubt_s = 0.0
        self.resent = 0

    @property
    def name(self) -> str:
        """What messages call it."""
        return self._transport.name

    @property
    def is_open(self) -> bool:
        """Whether commands can be exchanged."""
        return self._open

    def open(self) -> None:
        """Open the transport and answer the projector's nonce, if a password is set; raises DeviceError."""
        if self._open:
            return
        self._transport.open()
        self._dirty, self._prefix = True, b""
        self._framing.resynchronise()
        if self._password:
            self._prefix = answer_nonce(self._nonce(), self._password)
        self._open = True

    def close(self) -> None:
        """Close the transport; harmless when closed."""
        self._open = False
        self._transport.close()

    def watch(self) -> None:
        """Drop what came unasked; raises DeviceAbsent at once where the line is gone."""
        self._dirty = bool(self._transport.read(0.0)) or self._dirty

    def exchange(self, name: str) -> Answer:
        """Send the command of that name until it is answered, and return the answer.

        Raises
        ------
        DeviceAbsent
            the line is closed or gone.
        DeviceStalled
            nothing answered.
        ProtocolError
            what answered is no projector of this family, or the line is too noisy.
        DeviceError
            the projector wants a password, or another one.
        """
        answer = self._answered(name)
        for _ in range(self._times.attempts):
            if not isinstance(answer, Data) or self._clock.now() >= self._doubt_s:
                return answer
            before, answer = answer, self._answered(name)  # a reply to another command may still be under way
            if answer == before:
                return answer
        raise ProtocolError(f"{self.name} answered {name!r} with another value each time, at last {answer}: a bad line")

    def _answered(self, name: str) -> Answer:
        entry, seen, last = entry_of(name), "nothing", None
        for attempt in range(self._times.attempts):
            self.resent += attempt > 0
            try:
                event = self._once(entry)
            except ProtocolError as error:
                self._dirty, last, seen = True, error, error.message
                continue
            if isinstance(event, AuthenticationError):
                raise self._unauthorised()
            if isinstance(event, Ack | CannotExecute | Data):
                return event
            if event is None:
                self._dirty, self._doubt_s = True, 0.0 if self._framing.numbered else self._late_s()
            seen = "NAK (not understood)" if event else "nothing"
        tried = f"{self.name}: {name!r} was sent {self._times.attempts} times; the last answer: {seen}"
        if last is not None or seen != "nothing":
            raise ProtocolError(
                f"{tried}. Check that a HITACHI projector is there, at 19200 8N1, and the cable away from mains"
            )
        raise DeviceStalled(
            f"{tried} within {self._times.reply_s:g} s. Check mains, the cross cable (pins 2 and 3 crossed), 19200 "
            "8N1, and that it is the projector's CONTROL port"
        )

    def _once(self, entry: Entry) -> Event | None:
        """Send once; return the reply, None for none in time; raise ProtocolError for one that cannot be meant."""
        if self._dirty or self._transport.read(0.0):
            self._settle()
        self._clock.sleep(self._free_s - self._clock.now())
        frame = self._framing.encode(entry.command)
        log.debug("%s > %s", self.name, frame.hex(" "))
        self._transport.write(self._prefix + frame)
        self._prefix = b""
        event = self._reply()
        self._free_s = self._clock.now() + self._times.gap_s
        if isinstance(event, Ack | Data):
            _require_fit(entry, event)
        if isinstance(event, Data):
            self._require_alone(event)
        return event

    def _require_alone(self, event: Data) -> None:
        """Raise ProtocolError where more bytes follow: noise that looked like a value. The gap has to pass anyway."""
        if more := self._transport.read(self._times.gap_s):
            log.debug("%s: dropped %s with %s behind it", self.name, event, more.hex(" "))
            raise ProtocolError(f"it answered {event}, and {more.hex(' ')} behind it: noise on the line")

    def _reply(self) -> Event | None:
        for data in self._incoming(self._times.reply_s):
            self._framing.feed(data)
            event = self._framing.next_event()
            if event is not None:
                if late := self._framing.resynchronise():
                    log.debug("%s: dropped %s behind a reply", self.name, late.hex(" "))
                    self._dirty = True
                return event
        return None

    def _settle(self) -> None:
        """Read until it is quiet, and forget what came."""
        end_s = self._clock.now() + self._times.noise_s
        while data := self._transport.read(self._times.quiet_s):
            log.debug("%s: dropped %s", self.name, data.hex(" "))
            self._framing.feed(data)
            self._framing.resynchronise()
            if self._clock.now() > end_s:
                raise ProtocolError(
                    f"{self.name} never falls silent ({data[-8:].hex(' ')} …): another device or baud rate"
                )
        self._framing.resynchronise()
        self._dirty = False

    def _incoming(self, within_s: float) -> Iterator[bytes]:
        """Yield what comes until the time is over."""
        end_s = self._clock.now() + within_s
        while (left_s := end_s - self._clock.now()) > 0:
            if data := self._transport.read(left_s):
                log.debug("%s < %s", self.name, data.hex(" "))
                yield data

    def _late_s(self) -> float:
        return self._clock.now() + self._times.late_s

    def _nonce(self) -> bytes:
        nonce = b""
        for data in self._incoming(self._times.reply_s * self._times.attempts):
            nonce += data
            if len(nonce) >= NONCE_SIZE:
                return nonce[:NONCE_SIZE]
        self._transport.close()
        raise DeviceError(
            f"{self.name} asked for no password ({len(nonce)} of {NONCE_SIZE} bytes came): authentication is off "
            "there; remove projector.options.password, or switch it on in the projector's network settings"
        )

    def _unauthorised(self) -> DeviceError:
        self.close()
        what = "refuses the password" if self._password else "wants a password"
        return DeviceError(f"{self.name} {what} (1f 04 00): set projector.options.password to the projector's own")


def _require_fit(entry: Entry, event: Ack | Data) -> None:
    """Raise ProtocolError for a reply of the other kind, or a value that the command cannot answer."""
    asked = entry.command.action == Action.GET
    if isinstance(event, Data) != asked:
        raise ProtocolError(f"it answered a {'get' if asked else 'set'} with {event}")
    if isinstance(event, Data) and entry.allowed is not None and event.value not in entry.allowed:
        allowed = ", ".join(map(str, entry.allowed))
        raise ProtocolError(f"it answered the value {event.value}; allowed are {allowed}")
