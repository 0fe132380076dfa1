"""Pixel formats by the PFNC: bytes to images and back.

Owns the formats that can be read: monochrome and RGB of 8, 10, 12 and 16 bits, unpacked (`Mono12`), packed
least significant bit first (`Mono12p`) and packed the GigE Vision way (`Mono12Packed`). Codes: EMVA's PFNC,
as the AIA's dissector for Wireshark lists them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fringed.data import Array, UInt8Array
from fringed.errors import ProtocolError

Packing = Literal["none", "lsb", "gev"]


@dataclass(frozen=True)
class PixelFormat:
    """A format: `code` and `name` of the PFNC, `channels` 1 or 3, how bits are packed, and whether blue is first."""

    code: int
    name: str
    bits: int
    channels: int = 1
    packing: Packing = "none"
    reverse: bool = False

    @property
    def bits_per_pixel(self) -> int:
        """How many bits a pixel takes on the bus: the code's second byte."""
        return self.code >> 16 & 0xFF

    def payload_bytes(self, width: int, height: int, padding: int = 0) -> int:
        """Return how many bytes an image has; `padding` is a line's."""
        return -(-width * height * self.bits_per_pixel // 8) + padding * height


FORMATS = (
    PixelFormat(0x01080001, "Mono8", 8),
    PixelFormat(0x01100003, "Mono10", 10),
    PixelFormat(0x010A0046, "Mono10p", 10, packing="lsb"),
    PixelFormat(0x010C0004, "Mono10Packed", 10, packing="gev"),
    PixelFormat(0x01100005, "Mono12", 12),
    PixelFormat(0x010C0047, "Mono12p", 12, packing="lsb"),
    PixelFormat(0x010C0006, "Mono12Packed", 12, packing="gev"),
    PixelFormat(0x01100007, "Mono16", 16),
    PixelFormat(0x02180014, "RGB8", 8, 3),
    PixelFormat(0x02180015, "BGR8", 8, 3, reverse=True),
    PixelFormat(0x02300018, "RGB10", 10, 3),
    PixelFormat(0x02300019, "BGR10", 10, 3, reverse=True),
    PixelFormat(0x021E005C, "RGB10p", 10, 3, "lsb"),
    PixelFormat(0x021E0048, "BGR10p", 10, 3, "lsb", reverse=True),
    PixelFormat(0x0230001A, "RGB12", 12, 3),
    PixelFormat(0x0230001B, "BGR12", 12, 3, reverse=True),
    PixelFormat(0x0224005D, "RGB12p", 12, 3, "lsb"),
    PixelFormat(0x02240049, "BGR12p", 12, 3, "lsb", reverse=True),
    PixelFormat(0x02300033, "RGB16", 16, 3),
)
BY_CODE = {one.code: one for one in FORMATS}
BY_NAME = {one.name: one for one in FORMATS}


def format_of(code: int) -> PixelFormat:
    """Return the format of a PFNC code; raises ProtocolError for one that cannot be read."""
    if code not in BY_CODE:
        names = ", ".join(BY_NAME)
        raise ProtocolError(
            f"the camera sends the pixel format 0x{code:08X}; these can be read: {names}: set one of them"
        )
    return BY_CODE[code]


def decode_image(payload: UInt8Array, pixels: PixelFormat, size_px: tuple[int, int], padding: int = 0) -> Array:
    """Return the image `(height, width)` or `(height, width, 3)` in red, green, blue; uint8 up to 8 bits, else uint16.

    Images of 8 bits without padding are views of `payload`.

    Raises
    ------
    ProtocolError
        too few bytes.
    """
    width, height = size_px
    needed = pixels.payload_bytes(width, height, padding)
    if len(payload) < needed:
        raise ProtocolError(
            f"{len(payload)} bytes came; {width} x {height} pixels of {pixels.name} have {needed}: "
            "read back the camera's width, height and pixel format"
        )
    if padding:
        payload = payload[:needed].reshape(height, -1)[:, :-padding].ravel()
    count = width * height * pixels.channels
    if pixels.packing == "lsb":
        values = _from_lsb(payload, count, pixels.bits)
    elif pixels.packing == "gev":
        values = _from_gev(payload, count, pixels.bits)
    elif pixels.bits <= 8:
        values = payload[:count]
    else:
        values = payload[: 2 * count].view("<u2").astype(np.uint16, copy=False)
    if pixels.channels == 1:
        return values.reshape(height, width)
    image = values.reshape(height, width, 3)
    return np.ascontiguousarray(image[:, :, ::-1]) if pixels.reverse else image


def encode_image(image: Array, pixels: PixelFormat) -> UInt8Array:
    """Return the bytes of `image`, whose numbers fit `pixels.bits`: the other way round, for emulators."""
    values = np.ascontiguousarray(image[..., ::-1] if pixels.reverse else image).ravel()
    if pixels.packing == "lsb":
        return _to_lsb(values.astype(np.uint16), pixels.bits)
    if pixels.packing == "gev":
        return _to_gev(values.astype(np.uint16), pixels.bits)
    return values.astype(np.uint8 if pixels.bits <= 8 else "<u2").view(np.uint8)


def _groups(payload: UInt8Array, count: int, bits: int, group: tuple[int, int]) -> UInt8Array:
    """Return whole groups of `group` (pixels, bytes) as rows, filled up with zeros."""
    pixels, size = group
    rows = -(-count // pixels)
    used = payload[: min(len(payload), rows * size)]
    if len(used) < rows * size:
        used = np.concatenate((used, np.zeros(rows * size - len(used), np.uint8)))
    return used.reshape(rows, size)


def _from_lsb(payload: UInt8Array, count: int, bits: int) -> Array:
    pixels, size = (4, 5) if bits == 10 else (2, 3)
    rows = _groups(payload, count, bits, (pixels, size))
    values = np.empty((len(rows), pixels), np.uint16)
    for index in range(pixels):
        byte, shift = divmod(index * bits, 8)
        word = rows[:, byte] | rows[:, byte + 1].astype(np.uint16) << np.uint16(8)
        values[:, index] = word >> np.uint16(shift) & np.uint16(2**bits - 1)
    return values.ravel()[:count]


def _to_lsb(values: Array, bits: int) -> UInt8Array:
    pixels, size = (4, 5) if bits == 10 else (2, 3)
    rows = -(-len(values) // pixels)
    filled = np.zeros(rows * pixels, np.uint16)
    filled[: len(values)] = values
    table = filled.reshape(rows, pixels)
    out = np.zeros((rows, size), np.uint8)
    for index in range(pixels):
        byte, shift = divmod(index * bits, 8)
        word = table[:, index].astype(np.uint32) << np.uint32(shift)
        out[:, byte] |= (word & 0xFF).astype(np.uint8)
        out[:, byte + 1] |= (word >> np.uint32(8) & 0xFF).astype(np.uint8)
    return out.ravel()[: -(-len(values) * bits // 8)]


def _from_gev(payload: UInt8Array, count: int, bits: int) -> Array:
    rows = _groups(payload, count, bits, (2, 3)).astype(np.uint16)
    low = np.uint16(bits - 8)
    mask = np.uint16(2 ** (bits - 8) - 1)
    values = np.empty((len(rows), 2), np.uint16)
    values[:, 0] = rows[:, 0] << low | rows[:, 1] & mask
    values[:, 1] = rows[:, 2] << low | rows[:, 1] >> np.uint16(4) & mask
    return values.ravel()[:count]


def _to_gev(values: Array, bits: int) -> UInt8Array:
    filled = np.zeros(-(-len(values) // 2) * 2, np.uint16)
    filled[: len(values)] = values
    first, second = filled[0::2], filled[1::2]
    low, mask = np.uint16(bits - 8), np.uint16(2 ** (bits - 8) - 1)
    middle = first & mask | (second & mask) << np.uint16(4)
    out = np.stack((first >> low, middle, second >> low), axis=1).astype(np.uint8)
    return out.ravel()[: -(-len(values) * 12 // 8)]
