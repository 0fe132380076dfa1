"""HITACHI's serial protocol, sans-I/O: commands to frames, bytes to events.

A frame is 13 bytes: `BE EF 03 06 00 | CRC hi lo | action LE16 | type LE16 | setting LE16`. The CRC is
CRC-16/MODBUS over the frame with its CRC field zero, high byte first. Replies have one to three bytes and no
checksum at all, so a reply that cannot be meant is never skipped silently: it raises ProtocolError, and reading goes
on only after an explicit `resynchronise`.

Knows no port, no clock, no thread; `hitachi_commands` has the codes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fringed.errors import ProtocolError, UsageError
from fringed.protocols.hitachi_commands import Command, entry_of

HEADER = bytes.fromhex("BEEF030600")
FRAME_SIZE = 13
GAP_S = 0.040
"""At least so long between a reply and the next command."""

_BODY = struct.Struct("<HHH")
_ACK, _NAK, _CANNOT, _DATA, _REFUSED = 0x06, 0x15, 0x1C, 0x1D, 0x1F
_SIZES = {_ACK: 1, _NAK: 1, _CANNOT: 3, _DATA: 3, _REFUSED: 3}
_AUTHENTICATION = b"\x04\x00"


@dataclass(frozen=True)
class Ack:
    """The command was understood and is done."""


@dataclass(frozen=True)
class Nak:
    """The command was not understood: send it again."""


@dataclass(frozen=True)
class CannotExecute:
    """Understood, and not possible now."""


@dataclass(frozen=True)
class Data:
    """The answer to a get, 0 to 65535."""

    value: int


@dataclass(frozen=True)
class AuthenticationError:
    """A network port wants the password, or another one."""


Event = Ack | Nak | CannotExecute | Data | AuthenticationError


def crc16(data: bytes) -> int:
    """Return CRC-16/MODBUS: polynomial 0xA001 reflected, start 0xFFFF, no final xor.

    >>> hex(crc16(b"123456789"))
    '0x4b37'
    """
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def encode_command(command: Command) -> bytes:
    """Return the 13 bytes of a command.

    >>> encode_command(Command(1, 0x6000, 1)).hex(" ")
    'be ef 03 06 00 ba d2 01 00 00 60 01 00'

    Raises
    ------
    UsageError
        a field that 16 bits do not hold.
    """
    fields = {"action": command.action, "type": command.type, "setting": command.setting}
    for name, value in fields.items():
        if not 0 <= value <= 0xFFFF:
            raise UsageError(f"the {name} {value} does not fit a HITACHI command; allowed is 0 to 65535")
    body = _BODY.pack(*fields.values())
    return HEADER + crc16(HEADER + b"\0\0" + body).to_bytes(2, "big") + body


def encode_named(name: str) -> bytes:
    """Return the frame of a command by its name in the table; raises UsageError where there is none."""
    return encode_command(entry_of(name).command)


def decode_command(frame: bytes) -> Command:
    """Return the command in 13 bytes.

    Raises
    ------
    ProtocolError
        another length or header, or a CRC that does not fit.
    """
    if len(frame) != FRAME_SIZE or not frame.startswith(HEADER):
        raise ProtocolError(f"a HITACHI command is 13 bytes from BE EF 03 06 00; seen {len(frame)}: {_hex(frame)}")
    wanted = crc16(HEADER + b"\0\0" + frame[7:])
    if int.from_bytes(frame[5:7], "big") != wanted:
        raise ProtocolError(f"the CRC of {_hex(frame)} is {_hex(frame[5:7])}; expected {wanted:04x}")
    return Command(*_BODY.unpack(frame[7:]))


def encode_reply(event: Event) -> bytes:
    """Return the bytes of a reply, as a projector sends them."""
    match event:
        case Ack():
            return bytes([_ACK])
        case Nak():
            return bytes([_NAK])
        case CannotExecute():
            return bytes([_CANNOT, 0, 0])
        case Data(value):
            return bytes([_DATA]) + value.to_bytes(2, "little")
        case AuthenticationError():
            return bytes([_REFUSED]) + _AUTHENTICATION


def decode_reply(reply: bytes) -> Event:
    """Return what one whole reply says; raises ProtocolError for what none is."""
    code, rest = reply[:1], reply[1:]
    if reply == bytes([_ACK]):
        return Ack()
    if reply == bytes([_NAK]):
        return Nak()
    if reply == bytes([_CANNOT, 0, 0]):
        return CannotExecute()
    if code == bytes([_DATA]) and len(rest) == 2:
        return Data(int.from_bytes(rest, "little"))
    if code == bytes([_REFUSED]) and rest == _AUTHENTICATION:
        return AuthenticationError()
    if code == bytes([_REFUSED]):
        raise ProtocolError(
            f"the projector refused with {_hex(reply)}: busy, or a code that nobody published; known is 1f 04 00 "
            "(authentication). Try again"
        )
    raise ProtocolError(
        f"the projector answered {_hex(reply)}; a reply begins with 06, 15, 1c 00 00, 1d or 1f. Another device on "
        "this port, another baud rate than 19200, or power-on noise: discard what comes until it is quiet"
    )


class ReplyDecoder:
    """Bytes in, events out, however they are cut."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> None:
        """Take bytes as they come."""
        self._buffer += data

    @property
    def pending(self) -> bytes:
        """What has not become an event yet."""
        return bytes(self._buffer)

    def next_event(self) -> Event | None:
        """Return the next event; None when more bytes are needed.

        Raises
        ------
        ProtocolError
            the next bytes are no reply. It is raised again until `resynchronise`.
        """
        reply = self._next_reply(0)
        if reply is None:
            return None
        event = decode_reply(reply)
        del self._buffer[: len(reply)]
        return event

    def resynchronise(self) -> bytes:
        """Forget every byte that is not an event yet, and return them for the trace."""
        dropped = bytes(self._buffer)
        self._buffer.clear()
        return dropped

    def _next_reply(self, trailer: int) -> bytes | None:
        if not self._buffer:
            return None
        size = _SIZES.get(self._buffer[0])
        if size is None:
            return bytes(self._buffer[:8])
        return bytes(self._buffer[:size]) if len(self._buffer) >= size + trailer else None


class CommandReader:
    """The projector's side: bytes in, commands out; noise before a header is dropped."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> None:
        """Take bytes as they come."""
        self._buffer += data

    def next_command(self) -> Command | None:
        """Return the next command; None when more bytes are needed.

        Raises
        ------
        ProtocolError
            a frame whose CRC does not fit: it is dropped, and the projector answers NAK.
        """
        start = self._buffer.find(HEADER)
        if start < 0:
            keep = next((n for n in range(4, 0, -1) if self._buffer.endswith(HEADER[:n])), 0)
            del self._buffer[: len(self._buffer) - keep]
            return None
        del self._buffer[:start]
        if len(self._buffer) < FRAME_SIZE:
            return None
        frame = bytes(self._buffer[:FRAME_SIZE])
        del self._buffer[:FRAME_SIZE]
        return decode_command(frame)


def _hex(data: bytes) -> str:
    return data.hex(" ") or "nothing"
