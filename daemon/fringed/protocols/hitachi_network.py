"""HITACHI's framing on TCP 9715 and its authentication, sans-I/O.

Published for the CP-X265; whether the CP-X260 has a network port at all is unknown. TCP 23 takes the serial frames
as they are. TCP 9715 wraps them: `02 0D | 13 bytes | checksum | id`, the sum of all from 02 to the checksum being
0 modulo 256; the reply is followed by the same id. Where a password is set, the projector sends a nonce of 8 bytes
on connection, and 32 hexadecimal characters, the MD5 of nonce and password, precede the first frame.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from fringed.errors import ProtocolError, UsageError
from fringed.protocols.hitachi import FRAME_SIZE, Event, ReplyDecoder, decode_command, decode_reply, encode_command
from fringed.protocols.hitachi_commands import Command

RAW_PORT, FRAMED_PORT = 23, 9715
NONCE_SIZE = 8
DIGEST_SIZE = 32
IDLE_S = 30.0
"""The projector hangs up after so long without a command."""
_START = bytes([0x02, FRAME_SIZE])
WRAPPED_SIZE = len(_START) + FRAME_SIZE + 2


@dataclass(frozen=True)
class Reply:
    """An event, and the id of the command that it answers."""

    event: Event
    id: int


def checksum(data: bytes) -> int:
    """Return the byte that brings the sum to 0 modulo 256."""
    return -sum(data) & 0xFF


def wrap_command(command: Command, id: int) -> bytes:
    """Return the 17 bytes of a command on TCP 9715; raises UsageError for an id outside 0 to 255."""
    if not 0 <= id <= 0xFF:
        raise UsageError(f"the connection id {id} does not fit a byte; allowed is 0 to 255")
    data = _START + encode_command(command)
    return data + bytes([checksum(data), id])


def unwrap_command(data: bytes) -> tuple[Command, int]:
    """Return command and id of 17 bytes; raises ProtocolError for what none is."""
    if len(data) != WRAPPED_SIZE or not data.startswith(_START):
        raise ProtocolError(f"a command on TCP 9715 is 17 bytes from 02 0d; seen {len(data)}: {data.hex(' ')}")
    if sum(data[:-1]) & 0xFF:
        raise ProtocolError(f"the checksum of {data.hex(' ')} is {data[-2]:02x}; expected {checksum(data[:-2]):02x}")
    return decode_command(data[2:-2]), data[-1]


def answer_nonce(nonce: bytes, password: str) -> bytes:
    """Return the 32 characters that precede the first frame.

    Raises
    ------
    ProtocolError
        a nonce of another length.
    UsageError
        a password that is not ASCII.
    """
    if len(nonce) != NONCE_SIZE:
        raise ProtocolError(f"the projector's nonce has {len(nonce)} bytes; expected {NONCE_SIZE}")
    if not password.isascii():
        raise UsageError("the projector's password holds characters beyond ASCII; set another one on its web page")
    return hashlib.md5(nonce + password.encode("ascii"), usedforsecurity=False).hexdigest().encode("ascii")


class NetworkDecoder(ReplyDecoder):
    """Replies of TCP 9715: as on the serial line, each followed by its id."""

    def next_reply(self) -> Reply | None:
        """Return the next reply; None when more bytes are needed. Raises ProtocolError as `next_event` does."""
        reply = self._next_reply(trailer=1)
        if reply is None:
            return None
        event = decode_reply(reply)
        answered = self._buffer[len(reply)]
        del self._buffer[: len(reply) + 1]
        return Reply(event, answered)
