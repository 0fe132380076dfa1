"""What passes over one port of the emulated projector, at the line's pace.

Owns framing, authentication and when each byte leaves; asks no clock. Bytes take 10 bits at the baud rate, both
ways. A command that began within 40 ms of the last reply is dropped.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from fringed.emulators.cpx260_model import Projector
from fringed.errors import ProtocolError
from fringed.protocols.hitachi import FRAME_SIZE, AuthenticationError, CommandReader, encode_reply
from fringed.protocols.hitachi_commands import Command
from fringed.protocols.hitachi_network import (
    DIGEST_SIZE,
    IDLE_S,
    NONCE_SIZE,
    WRAPPED_SIZE,
    answer_nonce,
    unwrap_command,
)

_HEX = b"0123456789abcdef"


@dataclass(frozen=True)
class Manner:
    """How a port speaks. `baud` 0 takes no time."""

    baud: int = 19200
    latency_s: float = 0.005
    wrapped: bool = False
    password: str = ""
    idle_s: float = 0.0

    @property
    def byte_s(self) -> float:
        """How long a byte takes."""
        return 10 / self.baud if self.baud else 0.0


class Conversation:
    """One port's bytes."""

    def __init__(self, projector: Projector, manner: Manner) -> None:
        self._projector, self._manner = projector, manner
        self.begin(0.0)

    def begin(self, now_s: float) -> None:
        """Forget everything: a fresh connection. A port with a password sends its nonce."""
        self._reader, self._buffer = CommandReader(), b""
        self._queue: list[tuple[float, bytes]] = []
        self._began_s, self._heard_s = now_s, now_s
        self._nonce = b""
        self._trusted = not self._manner.password

    def greet(self, now_s: float) -> None:
        """Send the nonce, where a password is set."""
        if self._manner.password:
            self._nonce = bytes(self._projector.dice.choice(_HEX) for _ in range(NONCE_SIZE))
            self._queue.append((now_s, self._nonce))

    def idle_too_long(self, now_s: float) -> bool:
        """Whether it hangs up now."""
        return self._manner.idle_s > 0 and now_s - self._heard_s > self._manner.idle_s

    def feed(self, data: bytes, now_s: float) -> None:
        """Take bytes that came at that time."""
        if not data:
            return
        self._heard_s = now_s
        if not self._buffer:
            self._began_s = now_s
        self._buffer += data
        if self._authenticate():
            self._commands(now_s)

    def emit(self, data: bytes, now_s: float) -> None:
        """Send bytes unasked."""
        self._say(data, now_s)

    def due(self, now_s: float) -> bytes:
        """Return the bytes that leave now."""
        leaving = b"".join(data for when_s, data in self._queue if when_s <= now_s)
        if leaving:
            self._queue = [each for each in self._queue if each[0] > now_s]
            if not self._queue:
                self._projector.replied(now_s)
        return leaving

    def next_s(self) -> float | None:
        """Return when the next byte leaves."""
        return min((when_s for when_s, _ in self._queue), default=None)

    def _authenticate(self) -> bool:
        """Take the digest, if one is due and has begun; return whether the rest can be read as commands."""
        if self._trusted or not self._nonce or self._buffer[0] not in _HEX:
            return True
        if len(self._buffer) < DIGEST_SIZE:
            return False
        self._trusted = self._buffer[:DIGEST_SIZE] == answer_nonce(self._nonce, self._manner.password)
        self._buffer = self._buffer[DIGEST_SIZE:]
        return True

    def _commands(self, now_s: float) -> None:
        for command, tag in self._wrapped() if self._manner.wrapped else self._plain():
            if self._projector.too_early(self._began_s):
                continue
            reply = self._projector.receive(command, now_s) if self._trusted else encode_reply(AuthenticationError())
            if reply:
                usual_s = now_s + FRAME_SIZE * self._manner.byte_s + self._manner.latency_s
                self._say(reply + tag, usual_s + self._projector.delay_s)

    def _plain(self) -> list[tuple[Command | None, bytes]]:
        self._reader.feed(self._buffer)
        self._buffer = b""
        found: list[tuple[Command | None, bytes]] = []
        while True:
            try:
                command = self._reader.next_command()
            except ProtocolError:
                found.append((None, b""))
                continue
            if command is None:
                return found
            found.append((command, b""))

    def _wrapped(self) -> list[tuple[Command | None, bytes]]:
        found: list[tuple[Command | None, bytes]] = []
        while len(self._buffer) >= WRAPPED_SIZE:
            frame, self._buffer = self._buffer[:WRAPPED_SIZE], self._buffer[WRAPPED_SIZE:]
            try:
                command, number = unwrap_command(frame)
                found.append((command, bytes([number])))
            except ProtocolError:
                found.append((None, frame[-1:]))
        return found

    def _say(self, data: bytes, from_s: float) -> None:
        start_s = max([from_s, *(when_s for when_s, _ in self._queue)])
        step_s = self._manner.byte_s
        self._queue += [(start_s + (n + 1) * step_s, data[n : n + 1]) for n in range(len(data))]


def network_manner(wrapped: bool, password: str, idle_s: float = IDLE_S) -> Manner:
    """Return how a network port speaks: without a baud rate; TCP 9715 hangs up when idle."""
    return Manner(0, wrapped=wrapped, password=password, idle_s=idle_s if wrapped else 0.0)


def dice_of(seed: int) -> random.Random:
    """Return the dice of an emulator, so that a run can be repeated."""
    return random.Random(seed)
