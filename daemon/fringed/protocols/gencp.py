"""GenCP, the control protocol of USB3 Vision: read and write a camera's memory.

Owns the bytes of commands and acknowledges, both ways, and which acknowledge belongs to which request.
Must not know USB, time or what an address means. Constants: GenCP 1.x as the AIA's own dissector for
Wireshark (packet-u3v.c) lists them.

    command      `<IHHHH` prefix, flags 0x4000, command, length, request id; then the payload
    acknowledge  `<IHHHH` prefix, status, command, length, request id; then the payload
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from fringed.errors import ProtocolError

PREFIX = b"U3VC"
HEADER = struct.Struct("<IHHHH")
PREFIX_VALUE = int.from_bytes(PREFIX, "little")
REQUEST_ACK = 0x4000
READ_COMMAND, READ_ACK = 0x0800, 0x0801
WRITE_COMMAND, WRITE_ACK = 0x0802, 0x0803
PENDING_ACK = 0x0805
_READ, _ADDRESS, _TWO = struct.Struct("<QHH"), struct.Struct("<Q"), struct.Struct("<HH")
WRITE_OVERHEAD = HEADER.size + _ADDRESS.size
MAX_PAYLOAD = 0xFFFF

SUCCESS = 0x0000
STATUS = {
    SUCCESS: "success",
    0x8001: "not implemented",
    0x8002: "invalid parameter",
    0x8003: "invalid address",
    0x8004: "write protected",
    0x8005: "bad alignment",
    0x8006: "access denied",
    0x8007: "busy",
    0x800B: "message time-out",
    0x800E: "invalid header",
    0x800F: "wrong configuration",
    0x8FFF: "general error",
    0xA001: "resend not supported",
    0xA002: "stream endpoint halted",
    0xA003: "payload size not aligned",
    0xA004: "stream registers inconsistent",
    0xA100: "data discarded",
}
STATUS_OF = {name: code for code, name in STATUS.items()}


def status_name(code: int) -> str:
    """Return what a status code means, with the number."""
    return f"{STATUS.get(code, 'unknown status')} (0x{code:04X})"


@dataclass(frozen=True)
class ReadRequest:
    """Read `count` bytes at `address`."""

    request_id: int
    address: int
    count: int


@dataclass(frozen=True)
class WriteRequest:
    """Write `data` at `address`."""

    request_id: int
    address: int
    data: bytes


@dataclass(frozen=True)
class ReadDone:
    """The bytes that were asked for."""

    request_id: int
    data: bytes


@dataclass(frozen=True)
class WriteDone:
    """How many bytes were written; None where the device does not tell."""

    request_id: int
    count: int | None


@dataclass(frozen=True)
class Pending:
    """The device is still at it: wait up to `timeout_ms` more."""

    request_id: int
    timeout_ms: int


@dataclass(frozen=True)
class Refusal:
    """The device refused `command`; `status` is one of STATUS."""

    request_id: int
    command: int
    status: int

    @property
    def reason(self) -> str:
        """The status in words."""
        return status_name(self.status)


Request = ReadRequest | WriteRequest
Acknowledge = ReadDone | WriteDone | Pending | Refusal


def encode_request(request: Request) -> bytes:
    """Return the bytes of a command.

    Raises
    ------
    ProtocolError
        an address, a count or data that the command cannot carry.
    """
    if not 0 <= request.address < 2**64:
        raise ProtocolError(f"the address {request.address:#x} is asked; 0 to 2**64 - 1 exist")
    if isinstance(request, ReadRequest):
        if not 0 < request.count <= MAX_PAYLOAD:
            raise ProtocolError(f"{request.count} bytes are asked in one command; it reads 1 to {MAX_PAYLOAD}")
        return _framed(REQUEST_ACK, READ_COMMAND, request.request_id, _READ.pack(request.address, 0, request.count))
    return _framed(REQUEST_ACK, WRITE_COMMAND, request.request_id, _ADDRESS.pack(request.address) + request.data)


def encode_acknowledge(acknowledge: Acknowledge) -> bytes:
    """Return the bytes of an acknowledge."""
    request_id = acknowledge.request_id
    if isinstance(acknowledge, ReadDone):
        return _framed(SUCCESS, READ_ACK, request_id, acknowledge.data)
    if isinstance(acknowledge, WriteDone):
        told = b"" if acknowledge.count is None else _TWO.pack(0, acknowledge.count)
        return _framed(SUCCESS, WRITE_ACK, request_id, told)
    if isinstance(acknowledge, Pending):
        return _framed(SUCCESS, PENDING_ACK, request_id, _TWO.pack(0, acknowledge.timeout_ms))
    return _framed(acknowledge.status, acknowledge.command + 1, request_id, b"")


def _framed(flags: int, command: int, request_id: int, payload: bytes) -> bytes:
    if len(payload) > MAX_PAYLOAD:
        raise ProtocolError(f"{len(payload)} bytes are to be sent in one message; it takes up to {MAX_PAYLOAD}")
    return HEADER.pack(PREFIX_VALUE, flags, command, len(payload), request_id) + payload


def pieces(count: int, limit: int) -> Iterator[tuple[int, int]]:
    """Yield (offset, length) of the pieces of `count` bytes, each at most `limit`.

    >>> list(pieces(10, 4))
    [(0, 4), (4, 4), (8, 2)]
    """
    if limit < 1:
        raise ProtocolError(f"the device takes {limit} bytes in a message; 1 at least are needed: read its manual")
    for offset in range(0, count, limit):
        yield offset, min(limit, count - offset)


@dataclass(frozen=True)
class _Message:
    flags: int
    command: int
    request_id: int
    payload: bytes


class _Framer:
    """Messages out of chunks of any size; what is in front of a prefix is dropped and counted."""

    def __init__(self) -> None:
        self.discarded = 0
        self._buffer = bytearray()

    def reset(self) -> None:
        """Forget what is incomplete."""
        self.discarded += len(self._buffer)
        self._buffer.clear()

    def push(self, data: bytes) -> None:
        """Take bytes."""
        self._buffer += data

    def pop(self) -> _Message | None:
        """Return the next complete message, if there is one."""
        self._skip_noise()
        if len(self._buffer) < HEADER.size:
            return None
        _, flags, command, length, request_id = HEADER.unpack_from(self._buffer)
        if len(self._buffer) < HEADER.size + length:
            return None
        payload = bytes(self._buffer[HEADER.size : HEADER.size + length])
        del self._buffer[: HEADER.size + length]
        return _Message(flags, command, request_id, payload)

    def _skip_noise(self) -> None:
        at = self._buffer.find(PREFIX)
        if at < 0:  # keep the beginning of a prefix that may go on in the next chunk
            kept = next((n for n in (3, 2, 1) if self._buffer.endswith(PREFIX[:n])), 0)
            at = len(self._buffer) - kept
        self.discarded += at
        del self._buffer[:at]


class AcknowledgeDecoder:
    """What a camera answers."""

    def __init__(self) -> None:
        self._framer = _Framer()

    @property
    def discarded(self) -> int:
        """How many bytes were no part of a message."""
        return self._framer.discarded

    def reset(self) -> None:
        """Forget a message that never became complete."""
        self._framer.reset()

    def feed(self, data: bytes) -> list[Acknowledge]:
        """Return the acknowledges that `data` completes; what follows a broken one comes with the next call.

        Raises
        ------
        ProtocolError
            a message that is no acknowledge.
        """
        self._framer.push(data)
        found: list[Acknowledge] = []
        while (message := self._framer.pop()) is not None:
            found.append(_acknowledge(message))
        return found


class RequestDecoder:
    """What a camera is asked: the other end, for emulators."""

    def __init__(self) -> None:
        self._framer = _Framer()

    def feed(self, data: bytes) -> list[Request]:
        """Return the requests that `data` completes; raises ProtocolError for a message that is none."""
        self._framer.push(data)
        found: list[Request] = []
        while (message := self._framer.pop()) is not None:
            found.append(_request(message))
        return found


def _acknowledge(message: _Message) -> Acknowledge:
    command, payload, request_id = message.command, message.payload, message.request_id
    if command not in (READ_ACK, WRITE_ACK, PENDING_ACK):
        raise ProtocolError(
            f"the camera answered with command 0x{command:04X}; 0x0801 (read), 0x0803 (written) and 0x0805 (pending) "
            "are acknowledges: is it a USB3 Vision camera?"
        )
    if message.flags != SUCCESS:
        return Refusal(request_id, command - 1, message.flags)
    if command == READ_ACK:
        return ReadDone(request_id, payload)
    if command == WRITE_ACK and not payload:
        return WriteDone(request_id, None)
    if len(payload) != _TWO.size:
        raise ProtocolError(f"the camera's acknowledge 0x{command:04X} carries {len(payload)} bytes; it has 4")
    value = _TWO.unpack(payload)[1]
    return WriteDone(request_id, value) if command == WRITE_ACK else Pending(request_id, value)


def _request(message: _Message) -> Request:
    payload, request_id = message.payload, message.request_id
    if message.flags != REQUEST_ACK:
        raise ProtocolError(f"a command with the flags 0x{message.flags:04X}; 0x4000 (acknowledge) is expected")
    if message.command == READ_COMMAND and len(payload) == _READ.size:
        address, _, count = _READ.unpack(payload)
        return ReadRequest(request_id, address, count)
    if message.command == WRITE_COMMAND and len(payload) > _ADDRESS.size:
        return WriteRequest(request_id, _ADDRESS.unpack_from(payload)[0], payload[_ADDRESS.size :])
    raise ProtocolError(
        f"a command 0x{message.command:04X} with {len(payload)} bytes; 0x0800 (read) has 12, 0x0802 (write) 9 or more"
    )
