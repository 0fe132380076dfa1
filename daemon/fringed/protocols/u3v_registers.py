"""Where USB3 Vision cameras keep what they say of themselves: ABRM, SBRM, SIRM and the manifest table.

Owns addresses and layouts, from the AIA's dissector for Wireshark (packet-u3v.c); reads and writes nothing.
"""

from __future__ import annotations

import io
import lzma
import struct
import zipfile
import zlib
from dataclasses import dataclass

from fringed.errors import ProtocolError

# ABRM, from address 0.
VENDOR, MODEL, FAMILY, DEVICE_VERSION = 0x004, 0x044, 0x084, 0x0C4
SERIAL_NUMBER, USER_NAME = 0x144, 0x184
TEXT_BYTES = 64
RESPONSE_TIME_MS, MANIFEST, SBRM = 0x1CC, 0x1D0, 0x1D8
TIME_STAMP, TIME_STAMP_LATCH, TIME_STAMP_INCREMENT = 0x1F0, 0x1F8, 0x1FC
ABRM_BYTES = 0x210

# From the address that SBRM holds.
MAX_COMMAND_BYTES, MAX_ACKNOWLEDGE_BYTES = 0x14, 0x18
STREAM_CHANNELS, SIRM = 0x1C, 0x20
SBRM_BYTES = 0x44

# From the address that SBRM + 0x20 holds.
STREAM_INFO, STREAM_CONTROL = 0x00, 0x04
REQUIRED_PAYLOAD, REQUIRED_LEADER, REQUIRED_TRAILER = 0x08, 0x10, 0x14
LEADER_SIZE, PAYLOAD_SIZE, PAYLOAD_COUNT, FINAL1_SIZE, FINAL2_SIZE, TRAILER_SIZE = 0x18, 0x1C, 0x20, 0x24, 0x28, 0x2C
SIRM_BYTES = 0x30
STREAM_ENABLE = 1

CLASS, SUBCLASS, CONTROL_PROTOCOL, EVENT_PROTOCOL, STREAM_PROTOCOL = 0xEF, 0x05, 0x00, 0x01, 0x02

ENTRY = struct.Struct("<IIQQ20s20x")
PLAIN, ZIPPED = 0, 1
MAX_XML_BYTES = 64 << 20
_UNREADABLE = (
    zipfile.BadZipFile, zlib.error, struct.error, lzma.LZMAError,
    RuntimeError, EOFError, ValueError, LookupError, OSError,
)  # fmt: skip
"""What `zipfile` raises for archives that are damaged, encrypted or packed in some other way."""


@dataclass(frozen=True)
class ManifestEntry:
    """Where a GenICam description lies; `zipped` says how."""

    address: int
    size: int
    zipped: bool
    version: int = 0


def text_of(raw: bytes) -> str:
    """Return a string register's text, up to its first zero."""
    return raw.split(b"\0")[0].decode("utf-8", "replace").strip()


def alignment_of(stream_info: int) -> int:
    """Return the alignment, in bytes, of the transfer sizes."""
    shift = stream_info >> 24
    if shift > 20:
        raise ProtocolError(
            f"the camera's stream interface asks for an alignment of 2**{shift}; up to 2**20 makes sense"
        )
    return 1 << shift


def encode_entry(entry: ManifestEntry, sha1: bytes = b"") -> bytes:
    """Return the 64 bytes of a manifest entry."""
    schema = (ZIPPED if entry.zipped else PLAIN) << 10
    return ENTRY.pack(entry.version, schema, entry.address, entry.size, sha1)


def decode_entry(raw: bytes) -> ManifestEntry:
    """Return a manifest entry; raises ProtocolError for one that cannot be."""
    if len(raw) != ENTRY.size:
        raise ProtocolError(f"a manifest entry of {len(raw)} bytes came; it has {ENTRY.size}")
    version, schema, address, size, _ = ENTRY.unpack(raw)
    kind = schema >> 10 & 0x1F
    if kind not in (PLAIN, ZIPPED) or not 0 < size <= MAX_XML_BYTES:
        raise ProtocolError(
            f"the manifest names a description of kind {kind} with {size} bytes; 0 (plain) or 1 (zip) and up to "
            f"{MAX_XML_BYTES} bytes can be read"
        )
    return ManifestEntry(address, size, kind == ZIPPED, version)


def description_text(raw: bytes, zipped: bool) -> str:
    """Return the description's XML; raises ProtocolError for a broken archive or text."""
    try:
        if zipped:
            with zipfile.ZipFile(io.BytesIO(raw)) as archive:
                names = [name for name in archive.namelist() if name.lower().endswith(".xml")]
                if not names or archive.getinfo(names[0]).file_size > MAX_XML_BYTES:
                    raise ProtocolError(
                        f"the camera's archive holds {archive.namelist()[:5]}; one XML file is expected"
                    )
                raw = archive.read(names[0])
        return raw.rstrip(b"\0").decode("utf-8-sig")
    except ProtocolError:
        raise
    except _UNREADABLE as error:
        raise ProtocolError(f"the camera's description cannot be read: {error}; read it again or update it") from error
