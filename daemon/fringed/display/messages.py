"""What the daemon and the display process say to each other, and how it is framed.

Owns the messages and their bytes: a length (4 bytes, little-endian), then MessagePack. No I/O. The memory with the
patterns travels beside `Load` as a file descriptor.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from fringed.errors import ProtocolError

LENGTH_BYTES = 4
LONGEST = 1 << 22
"""Bytes of one message; a `Load` of 10,000 patterns is about 200 KB."""

Backend = Literal["auto", "kmsdrm", "x11", "wayland", "dummy"]


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """What the window is to be: the process's one argument, as JSON."""

    display: int | str
    size_px: tuple[int, int]
    backend: Backend
    assumed_hz: float
    idle_text: str
    grid_after_s: float
    connector: str
    drm_folder: str
    vsync_required: bool
    parent: int


class Load(msgspec.Struct, frozen=True, tag="load"):
    """Take these patterns: place in the memory and shape of each; the memory's descriptor comes beside this."""

    token: int
    length: int
    table: tuple[tuple[int, tuple[int, int, int]], ...]


class Show(msgspec.Struct, frozen=True, tag="show"):
    """Show pattern `index` of those that were loaded last."""

    token: int
    index: int


class Idle(msgspec.Struct, frozen=True, tag="idle"):
    """Show darkness, and the idle picture a while later."""

    token: int


class Ping(msgspec.Struct, frozen=True, tag="ping"):
    """Say that you are there."""

    token: int


class Quit(msgspec.Struct, frozen=True, tag="quit"):
    """Close the window and leave."""


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """The window is open; what it is and what was measured.

    `interval_s` and `jitter_s`: flips one after the other. `depth`: flips that the driver queues, so many more were
    needed before one was confirmed; -1 where flips do not follow the display's refresh (`period_s` is then assumed).
    """

    backend: str
    display: int
    name: str
    renderer: str
    period_s: float
    interval_s: float
    jitter_s: float
    depth: int
    connector: str
    warnings: tuple[str, ...] = ()


class Done(msgspec.Struct, frozen=True, tag="done"):
    """What was asked for under `token` has happened; `flip_s` on the machine's monotonic clock, 0 where none."""

    token: int
    flip_s: float = 0.0


class Refused(msgspec.Struct, frozen=True, tag="refused"):
    """What was asked for under `token` cannot be; the window stays."""

    token: int
    text: str


class Gone(msgspec.Struct, frozen=True, tag="gone"):
    """There is no display, or no more, or not the one that was asked for; the process ends."""

    text: str


Command = Load | Show | Idle | Ping | Quit
Answer = Ready | Done | Refused | Gone
Message = Command | Answer

_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)


def encode(message: Message) -> bytes:
    """Return the message's frame.

    Raises
    ------
    ProtocolError
        it is longer than any message may be.
    """
    body = _encoder.encode(message)
    if len(body) > LONGEST:
        raise ProtocolError(f"a message of {len(body)} bytes; at most {LONGEST} are allowed: load fewer patterns")
    return len(body).to_bytes(LENGTH_BYTES, "little") + body


class Decoder:
    """Bytes in, in pieces of any size; messages out."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that are complete now.

        Raises
        ------
        ProtocolError
            these bytes are no message; nothing after them can be understood.
        """
        self._buffer += data
        found: list[Message] = []
        while len(self._buffer) >= LENGTH_BYTES:
            length = int.from_bytes(self._buffer[:LENGTH_BYTES], "little")
            if length > LONGEST:
                raise ProtocolError(f"a message of {length} bytes is announced; at most {LONGEST} are allowed")
            if len(self._buffer) < LENGTH_BYTES + length:
                break
            body = bytes(self._buffer[LENGTH_BYTES : LENGTH_BYTES + length])
            del self._buffer[: LENGTH_BYTES + length]
            try:
                found.append(_decoder.decode(body))
            except msgspec.MsgspecError as error:
                raise ProtocolError(f"{length} bytes are no message of the display process: {error}") from error
        return found
