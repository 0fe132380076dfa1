"""GenICam's pixel formats: which one a camera is to send, and what its bytes are. Arrays in, arrays out.

Codes and names are those of the GenICam Pixel Format Naming Convention [V: Aravis' headers].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from fringed.data import Array, CameraChannel
from fringed.errors import ProtocolError, UsageError

Layout = Literal["bytes", "words", "lsb", "gige"]


@dataclass(frozen=True)
class PixelFormat:
    """A format: `bits` of a number, how they are laid out, and `colours`: "mono", "RGB", "BGR", or a Bayer tile.

    Layouts: "bytes", "words" (16 bits, little-endian, right-aligned), "lsb" (packed without gaps from the least
    significant bit: "10p", "12p"), "gige" (two numbers in three bytes: "10Packed", "12Packed").
    """

    name: str
    code: int
    bits: int
    layout: Layout
    colours: str = "mono"

    @property
    def channels(self) -> int:
        """Numbers of one pixel."""
        return 3 if self.colours in ("RGB", "BGR") else 1


def _table() -> tuple[PixelFormat, ...]:
    formats = [
        PixelFormat("Mono8", 0x01080001, 8, "bytes"),
        PixelFormat("Mono10p", 0x010A0046, 10, "lsb"),
        PixelFormat("Mono10Packed", 0x010C0004, 10, "gige"),
        PixelFormat("Mono10", 0x01100003, 10, "words"),
        PixelFormat("Mono12p", 0x010C0047, 12, "lsb"),
        PixelFormat("Mono12Packed", 0x010C0006, 12, "gige"),
        PixelFormat("Mono12", 0x01100005, 12, "words"),
        PixelFormat("Mono16", 0x01100007, 16, "words"),
    ]
    for order, place in (("RGB", 0), ("BGR", 1)):
        formats += [
            PixelFormat(f"{order}8", 0x02180014 + place, 8, "bytes", order),
            PixelFormat(f"{order}8Packed", 0x02180014 + place, 8, "bytes", order),  # its name before 2012
            PixelFormat(f"{order}10", 0x02300018 + place, 10, "words", order),
            PixelFormat(f"{order}12", 0x0230001A + place, 12, "words", order),
        ]
    formats.append(PixelFormat("RGB16", 0x02300033, 16, "words", "RGB"))
    for place, tile in enumerate(("GR", "RG", "GB", "BG")):
        formats += [
            PixelFormat(f"Bayer{tile}8", 0x01080008 + place, 8, "bytes", tile),
            PixelFormat(f"Bayer{tile}10", 0x0110000C + place, 10, "words", tile),
            PixelFormat(f"Bayer{tile}12", 0x01100010 + place, 12, "words", tile),
            PixelFormat(f"Bayer{tile}12Packed", 0x010C002A + place, 12, "gige", tile),
            PixelFormat(f"Bayer{tile}16", 0x0110002E + place, 16, "words", tile),
        ]
    for tile, code10 in (("BG", 0x010A0052), ("GB", 0x010A0054), ("GR", 0x010A0056), ("RG", 0x010A0058)):
        formats.append(PixelFormat(f"Bayer{tile}10p", code10, 10, "lsb", tile))
        formats.append(PixelFormat(f"Bayer{tile}12p", code10 + 0x00020001, 12, "lsb", tile))
    return tuple(formats)


FORMATS = _table()
BY_NAME = {one.name: one for one in FORMATS}
BY_CODE = {one.code: one for one in FORMATS}
PLANES = ("red", "green", "blue")

# OpenCV's names by the tile's first row and second row; the tile is named by its first row here.
_DEMOSAIC = {
    "RG": cv2.COLOR_BayerRGGB2RGB,
    "GR": cv2.COLOR_BayerGRBG2RGB,
    "GB": cv2.COLOR_BayerGBRG2RGB,
    "BG": cv2.COLOR_BayerBGGR2RGB,
}


def choose(names: Sequence[str], bits: int, channel: CameraChannel) -> tuple[PixelFormat, CameraChannel]:
    """Return the camera's format for `channel` at `bits`, and the channel that it gives.

    A camera without colours gives "white" where one colour is asked for: it sees the light of every colour.

    Raises
    ------
    UsageError
        the camera has no such format; it lists those that it has.
    """
    known = [BY_NAME[name] for name in names if name in BY_NAME]
    fitting = [one for one in known if one.bits == bits]
    colour = [one for one in fitting if one.colours != "mono"]
    colour.sort(key=lambda one: (one.channels == 1, one.layout == "words"))  # demosaicked by the camera; fewer bytes
    mono = [one for one in fitting if one.colours == "mono"]
    mono.sort(key=lambda one: one.layout == "words")
    if channel != "white" and colour:
        return colour[0], channel
    sees_colour = any(one.colours != "mono" for one in known)
    if mono and channel != "rgb" and (channel == "white" or not sees_colour):
        return mono[0], "white"
    have = ", ".join(f"{one.name} ({one.bits} bits)" for one in known) or ", ".join(names) or "none that is named"
    raise UsageError(
        f"the camera has no pixel format for channel {channel!r} with {bits} bits; it has {have}: set camera.bits and "
        "camera.channel to one of these"
    )


def image_of(data: Array, size_px: tuple[int, int], form: PixelFormat, channel: str) -> Array:
    """Return the image in `data`, bytes as the camera sent them: `(height, width)`, or `(height, width, 3)` for "rgb".

    uint8 up to 8 bits, uint16 above. `data` may be longer than the image: cameras pad.

    Raises
    ------
    ProtocolError
        `data` is too short for an image of that size and format.
    """
    width, height = size_px
    numbers = _unpacked(data, width * height * form.channels, form)
    if form.channels == 3:
        colours = numbers.reshape(height, width, 3)
        if form.colours == "BGR":
            colours = colours[:, :, ::-1]
    else:
        plane = numbers.reshape(height, width)
        if form.colours == "mono":
            return plane
        colours = np.asarray(cv2.cvtColor(plane, _DEMOSAIC[form.colours]))
    return np.ascontiguousarray(colours if channel == "rgb" else colours[:, :, PLANES.index(channel)])


def _unpacked(data: Array, count: int, form: PixelFormat) -> Array:
    size = {
        "bytes": count, "words": 2 * count, "lsb": -(-count * form.bits // 8), "gige": -(-count // 2) * 3,
    }[form.layout]  # fmt: skip
    if data.size < size:
        raise ProtocolError(
            f"the camera delivered {data.size} bytes; {count} numbers in {form.name} are {size}: open it again"
        )
    data = data[:size]
    if form.layout == "bytes":
        return data.copy()
    if form.layout == "words":
        return data.view("<u2").astype(np.uint16)
    return (_from_gige if form.layout == "gige" else _from_lsb)(data, form.bits)[:count]


def _from_gige(data: Array, bits: int) -> Array:
    """Two numbers in three bytes: high bits of the first, low bits of both, high bits of the second."""
    first, low, second = data.reshape(-1, 3).astype(np.uint16).T
    few = bits - 8
    mask = (1 << few) - 1
    return np.stack([first << few | low & mask, second << few | low >> 4 & mask], 1).reshape(-1).astype(np.uint16)


def _from_lsb(data: Array, bits: int) -> Array:
    """Numbers packed without gaps, the least significant bit first."""
    together = {10: 4, 12: 2}[bits]  # numbers in a whole number of bytes
    group = together * bits // 8
    padded = np.zeros(-(-data.size // group) * group, np.uint8)
    padded[: data.size] = data
    parts = padded.reshape(-1, group).astype(np.uint16)
    numbers = np.empty((len(parts), together), np.uint16)
    for place in range(together):
        byte, shift = divmod(place * bits, 8)
        numbers[:, place] = (parts[:, byte] >> shift | parts[:, byte + 1] << (8 - shift)) & ((1 << bits) - 1)
    return numbers.reshape(-1)
