r"""The first bytes of a recording, before HDF5's own: who wrote it, its summary, and what makes it whole.

HDF5 leaves a user block of 4096 bytes (or a larger power of two) at the start alone. There stands

    fringed-recording 1 <length> <XXH3-64 of the JSON>\n<JSON>\n

with the summary that listings show, the file's size, the extents of its large arrays, and the XXH3-64 of
everything else. So a listing reads one block of a file, and a truncated, damaged or foreign file is found
before HDF5 parses any of it. Owns that text; opens no file.
"""

from __future__ import annotations

import re
from typing import Any

import msgspec
import xxhash

from fringed.errors import RecordingError

FORMAT = 1
BLOCK_BYTES = 4096
LARGE_BYTES = 64 * 1024  # arrays from here on have a checksum of their own only, see `meta_xxh3`
_FIRST_LINE = re.compile(rb"fringed-recording (\d{1,9}) (\d{1,9}) ([0-9a-f]{16})\n")
_BYTES_OF_AN_EXTENT = 32
_BYTES_OF_A_SUMMARY = 3400  # four texts of 120 bytes, six each where JSON escapes them, and the rest
_TEXT_MAX = 120


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """What a listing shows of a recording."""

    id: str
    kind: str
    created: str = ""
    scan: str = ""
    role: str = ""
    bytes: int = 0
    simulated: bool = False
    replayed: bool = False
    summary: str = ""


class Preface(msgspec.Struct, frozen=True, kw_only=True):
    """The JSON of a user block of `block` bytes. `extents` are (offset, bytes) of the large arrays, in order."""

    summary: Summary
    block: int = BLOCK_BYTES
    extents: list[tuple[int, int]] = []
    meta_xxh3: str = ""


def block_bytes(large_arrays: int) -> int:
    """Return the size of a user block with room for that many extents."""
    size = BLOCK_BYTES
    while size < _BYTES_OF_A_SUMMARY + large_arrays * _BYTES_OF_AN_EXTENT:
        size *= 2
    return size


def clipped(text: Any) -> str:
    """Return `text` short enough for the block; the tree holds it whole."""
    return str(text).encode()[:_TEXT_MAX].decode(errors="ignore")


def encode(preface: Preface) -> bytes:
    """Return the block, `preface.block` bytes long."""
    body = msgspec.json.encode(preface)
    line = f"fringed-recording {FORMAT} {len(body)} {xxhash.xxh3_64_hexdigest(body)}\n".encode()
    return (line + body + b"\n").ljust(preface.block, b"\0")


def length(start: bytes, name: str) -> int:
    """Return how many bytes of the file `decode` needs, from its first ones.

    Raises
    ------
    RecordingError
        a foreign file, or one of another format version.
    """
    match = _matched(start, name)
    return match.end() + int(match[2])


def _matched(start: bytes, name: str) -> re.Match[bytes]:
    match = _FIRST_LINE.match(start)
    if match is None:
        what = "an empty file" if not start else "zeros" if not any(start) else repr(start[:16])
        raise RecordingError(
            f"{name} is not a recording of this station: it begins with {what}, not with 'fringed-recording'; "
            "import foreign images with a capture.toml"
        )
    if int(match[1]) != FORMAT:
        raise RecordingError(
            f"{name} is of recording format {int(match[1])}; this release reads format {FORMAT}: "
            "install the release that wrote it"
        )
    return match


def decode(block: bytes, name: str) -> Preface:
    """Read a block.

    Raises
    ------
    RecordingError
        a foreign, truncated or damaged block.
    """
    match = _matched(block, name)
    end = match.end() + int(match[2])
    body = block[match.end() : end]
    if len(block) < end or xxhash.xxh3_64_hexdigest(body).encode() != match[3]:
        raise RecordingError(f"{name} is truncated or damaged in its first {end} bytes; restore it from a copy")
    try:
        return msgspec.json.decode(body, type=Preface)
    except ValueError as error:
        raise RecordingError(f"{name} has a summary that cannot be read: {error}") from error
