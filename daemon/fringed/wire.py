"""Messages <-> lists of bytes: `[topic][header][buffer]*`.

Owns the format of every message on every socket; does no I/O and knows no socket. The header is JSON:
`v` the version, `kind` the type's name, `seq` the topic's sequence number, `body` its fields, and
`buffers` the path, dtype, shape and XXH3-64 of each array. Buffers are raw arrays, C order, little
endian. Unknown header keys are ignored. Decoding yields read-only NumPy views without copying.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import msgspec
import numpy as np
import xxhash

from fringed.data import RECORDED, Array, PatternFrame
from fringed.errors import DataError, VersionMismatch, WireError
from fringed.messages import MESSAGES
from fringed.tree import join, split

VERSION = 1
MAX_HEADER_BYTES = 32 * 1024 * 1024
MAX_BUFFERS = 4096
DTYPES = frozenset({"|b1", "|u1", "|i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f4", "<f8"})
KINDS: dict[str, type[Any]] = {cls.__name__: cls for cls in (*RECORDED, *MESSAGES, PatternFrame)}

# What `stream` carries. A subscriber names any prefix.
TOPIC_STATE = "state"
TOPIC_EVENT = "event"
TOPIC_PREVIEW = "preview"
TOPIC_FRAME_SET = "frameset"
TOPIC_PRODUCT = "product"
TOPICS = (TOPIC_STATE, TOPIC_EVENT, TOPIC_PREVIEW, TOPIC_FRAME_SET, *(
    f"{TOPIC_PRODUCT}/{name}"
    for name in (
        "phase-map", "board-view", "calibration", "verification", "range-image", "registration", "model", "truth",
        "mesh", "artifact",
    )
))  # fmt: skip

Buffer = Any  # bytes, bytearray, memoryview, zmq.Frame or an array: whatever exports a buffer


class _BufferHeader(msgspec.Struct):
    path: str
    dtype: str
    shape: list[int]
    xxh3: str


class _Version(msgspec.Struct):
    v: int


class _Header(msgspec.Struct):
    kind: str
    v: int = 0
    seq: int = 0
    body: dict[str, Any] = {}
    buffers: list[_BufferHeader] = []


@dataclass(frozen=True)
class Envelope:
    """A decoded message: its topic, its type's name, its sequence number and the object."""

    topic: str
    kind: str
    seq: int
    content: Any


@dataclass(frozen=True)
class Encoded:
    """An object encoded once, to be sent under any topic and number without encoding it again."""

    kind: str
    body: dict[str, Any]
    headers: tuple[dict[str, Any], ...]
    buffers: tuple[Array, ...]

    def frames(self, topic: str, seq: int = 0) -> list[Buffer]:
        """Return the message's parts; the buffers are the arrays themselves, not copies."""
        head = {"v": VERSION, "kind": self.kind, "seq": seq, "body": self.body, "buffers": self.headers}
        return [topic.encode(), msgspec.json.encode(head), *self.buffers]

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return sum(buffer.nbytes for buffer in self.buffers)


def topic_of(content: Any) -> str:
    """Return the topic on which `stream` announces a frame set or product."""
    name = type(content).__name__
    if name == "FrameSet":
        return TOPIC_FRAME_SET
    kebab = "".join(f"-{c.lower()}" if c.isupper() else c for c in name).lstrip("-")
    return f"{TOPIC_PRODUCT}/{kebab}"


def checksum(array: Array) -> str:
    """Return the XXH3-64 of an array's bytes as sixteen hexadecimal digits."""
    return str(xxhash.xxh3_64_hexdigest(array.data.cast("B") if array.nbytes else b""))


def prepare(content: Any) -> Encoded:
    """Encode `content` (any type of `KINDS`) once.

    Raises
    ------
    WireError
        a type, dtype, value or number of arrays that the wire does not carry.
    """
    kind = type(content).__name__
    if KINDS.get(kind) is not type(content):
        raise WireError(f"{kind} does not travel; the wire carries {', '.join(sorted(KINDS))}")
    arrays: dict[str, Array] = {}
    try:
        body = split(content, "", arrays)
    except DataError as error:
        raise WireError(f"{kind}: {error}") from error
    if len(arrays) > MAX_BUFFERS:
        raise WireError(f"{kind} holds {len(arrays)} arrays; a message carries at most {MAX_BUFFERS}")
    headers, buffers = [], []
    for path, array in arrays.items():
        array = np.asarray(array, order="C")
        array = array.astype(array.dtype.newbyteorder("<"), copy=False)
        if array.dtype.str not in DTYPES:
            raise WireError(f"{kind}.{path} is of type {array.dtype}; the wire carries {', '.join(sorted(DTYPES))}")
        headers.append(
            {"path": path, "dtype": array.dtype.str, "shape": list(array.shape), "xxh3": checksum(array)}
        )  # fmt: skip
        buffers.append(array)
    return Encoded(kind, body, tuple(headers), tuple(buffers))


def encode(content: Any, topic: str = "", seq: int = 0) -> list[Buffer]:
    """Encode `content` as one message of `[topic, header, *buffers]`."""
    return prepare(content).frames(topic, seq)


def decode(frames: Sequence[Buffer], verify: bool = True) -> Envelope:
    """Decode one message; arrays are read-only views of the given buffers.

    Raises
    ------
    VersionMismatch
        the message is of another protocol version.
    WireError
        anything else that is not a message of this protocol.
    """
    topic, header = peek(frames)
    arrays: dict[str, Array] = {}
    if len(frames) - 2 != len(header.buffers):
        raise WireError(f"{len(frames) - 2} buffers came; the header describes {len(header.buffers)}")
    for described, raw in zip(header.buffers, frames[2:], strict=True):
        arrays[described.path] = _array(described, raw, verify)
    if header.kind not in KINDS:
        raise WireError(f"a message of kind {header.kind[:40]!r}; this version knows {', '.join(sorted(KINDS))}")
    try:
        content = join(header.body, KINDS[header.kind], arrays, KINDS)
    except DataError as error:
        raise WireError(f"{header.kind}: {error}") from error
    return Envelope(topic, header.kind, header.seq, content)


def peek(frames: Sequence[Buffer]) -> tuple[str, _Header]:
    """Return topic and header without touching the buffers."""
    if not 2 <= len(frames) <= MAX_BUFFERS + 2:
        raise WireError(
            f"a message has a topic, a header and at most {MAX_BUFFERS} buffers; this has {len(frames)} parts"
        )
    if len(frames[1]) > MAX_HEADER_BYTES:
        raise WireError(f"a header of {len(frames[1])} bytes; at most {MAX_HEADER_BYTES} are allowed")
    try:
        topic = bytes(frames[0]).decode()
        header = msgspec.json.decode(bytes(frames[1]), type=_Header)
    except (ValueError, RecursionError) as error:
        _check_version(bytes(frames[1]))
        raise WireError(f"not a message of this protocol: {error}") from error
    if header.v != VERSION:
        _check_version(bytes(frames[1]))
    return topic, header


def _check_version(header: bytes) -> None:
    """Raise VersionMismatch where a header, whatever else it holds, names another version."""
    try:
        version = msgspec.json.decode(header, type=_Version).v
    except (ValueError, RecursionError) as error:
        raise WireError(f"a message without a protocol version: {error}") from error
    if version != VERSION:
        raise VersionMismatch(
            f"a message of protocol version {version}; this side speaks {VERSION}: install the same release on both"
        )


def _array(described: _BufferHeader, raw: Buffer, verify: bool) -> Array:
    if described.dtype not in DTYPES or any(n < 0 for n in described.shape) or len(described.shape) > 32:
        what = f"dtype {described.dtype[:20]!r} of shape {described.shape[:8]}"
        raise WireError(f"buffer {described.path[:80]!r}: {what}; the wire carries {', '.join(sorted(DTYPES))}")
    dtype = np.dtype(described.dtype)
    view = memoryview(raw)
    if view.nbytes != prod(described.shape) * dtype.itemsize:
        raise WireError(
            f"buffer {described.path[:80]!r} has {view.nbytes} bytes; {described.dtype} of {described.shape} has "
            f"{prod(described.shape) * dtype.itemsize}"
        )
    try:
        flat = np.frombuffer(view, dtype) if view.nbytes else np.zeros(0, dtype)
        array: Array = flat.reshape(described.shape)
    except (ValueError, OverflowError, MemoryError) as error:
        raise WireError(f"buffer {described.path[:80]!r} of shape {described.shape[:8]}: {error}") from error
    array.flags.writeable = False
    if verify and checksum(array) != described.xxh3:
        raise WireError(f"buffer {described.path[:80]!r} does not match its checksum; it was damaged on its way")
    return array
