"""Frames of the DuncanTech MS3100's serial line, and how to find them among noise.

A frame is `02 | size LSB | size MSB | command | data | checksum`; the size counts command and data, the checksum
is the two's complement of their sum: as in EDT's libpdv, which cites the maker's manual. Knows no command.
"""

from __future__ import annotations

from dataclasses import dataclass

from fringed.errors import ProtocolError, UsageError

STX = 0x02
HEADER = 3
MAX_SIZE = 256  # what a size field may say before it is taken for noise


@dataclass(frozen=True)
class Frame:
    """What one frame carries."""

    command: int
    data: bytes = b""

    def encode(self) -> bytes:
        """Return its bytes; raises UsageError for numbers that do not fit."""
        if not 0 <= self.command <= 0xFF or len(self.data) >= MAX_SIZE:
            raise UsageError(
                f"command {self.command} with {len(self.data)} bytes of data is no frame; a command is one byte, "
                f"its data are {MAX_SIZE - 1} bytes at most"
            )
        body = bytes((self.command,)) + self.data
        return bytes((STX,)) + len(body).to_bytes(2, "little") + body + bytes((checksum(body),))


def checksum(body: bytes) -> int:
    """Return the two's complement of the sum of command and data."""
    return -sum(body) & 0xFF


class FrameDecoder:
    """Find frames in what a port delivers, in chunks of any size; `discarded` counts the bytes that were none."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.discarded = 0
        self.mismatches = 0

    @property
    def pending(self) -> int:
        """How many bytes wait for the rest of their frame."""
        return len(self._buffer)

    def feed(self, chunk: bytes) -> tuple[Frame, ...]:
        """Return the frames that are complete now; whatever is no frame is skipped."""
        self._buffer += chunk
        found: list[Frame] = []
        while True:
            frame = self._next()
            if frame is None:
                return tuple(found)
            found.append(frame)

    def finish(self) -> tuple[Frame, ...]:
        """Return the frames hidden behind a beginning that will not be completed, and forget the rest."""
        found: list[Frame] = []
        while self._buffer:
            self._skip(1)
            found += self.feed(b"")
        return tuple(found)

    def _next(self) -> Frame | None:
        while True:
            start = self._buffer.find(STX)
            self._skip(len(self._buffer) if start < 0 else start)
            if len(self._buffer) < HEADER:
                return None
            size = int.from_bytes(self._buffer[1:HEADER], "little")
            if not 1 <= size <= MAX_SIZE:
                self._skip(1)
                continue
            if len(self._buffer) < HEADER + size + 1:
                return None
            body = bytes(self._buffer[HEADER : HEADER + size])
            if self._buffer[HEADER + size] == checksum(body):
                del self._buffer[: HEADER + size + 1]
                return Frame(body[0], body[1:])
            self.mismatches += 1
            self._skip(1)

    def _skip(self, count: int) -> None:
        del self._buffer[:count]
        self.discarded += count


def decode_frame(data: bytes) -> Frame:
    """Return the one frame that `data` is.

    Raises
    ------
    ProtocolError
        it is none, or more than one.
    """
    if len(data) < HEADER + 2 or data[0] != STX:
        raise ProtocolError(
            f"{data.hex(' ') or 'no byte'} is no MS3100 frame; it begins with 02 and has 5 bytes or more"
        )
    size = int.from_bytes(data[1:HEADER], "little")
    if not 1 <= size <= MAX_SIZE or len(data) != HEADER + size + 1:
        raise ProtocolError(
            f"a frame states a size of {size} and has {len(data) - HEADER - 1}; see {data[:16].hex(' ')}"
        )
    body = data[HEADER:-1]
    if data[-1] != checksum(body):
        raise ProtocolError(f"checksum {data[-1]:02X} where {checksum(body):02X} is right in {data[:16].hex(' ')}")
    return Frame(body[0], body[1:])
