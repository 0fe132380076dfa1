"""Displays from /sys/class/drm: the connectors of graphics cards, what is plugged in and what it says of itself.

Owns the few fields of an EDID that tell one display from another (VESA E-EDID 1.3, sections 3.4 and 3.10.3).
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from fringed.finding.reading import data, entries, target_name, text

_CONNECTOR = re.compile(r"(card\d+)-(.+)")
_EDID_HEAD = b"\x00\xff\xff\xff\xff\xff\xff\x00"
_NAME_TAG = b"\x00\x00\x00\xfc\x00"


@dataclass(frozen=True)
class Edid:
    """What a display says of itself; empty and 0 where it does not."""

    maker: str
    product: int
    serial: int
    name: str


@dataclass(frozen=True)
class Connector:
    """An output of a graphics card; `modes` in the display's order of preference, without duplicates."""

    name: str
    id: str
    card: str
    node: str
    driver: str
    connected: bool
    enabled: bool
    modes: tuple[str, ...] = ()
    display: str = ""


def connectors(root: Path) -> list[Connector]:
    """Return every connector of every card."""
    found = [
        _connector(path, match[1], match[2])
        for path in entries(root / "sys/class/drm")
        if (match := _CONNECTOR.fullmatch(path.name)) is not None
    ]
    shared = Counter(connector.id for connector in found)
    return [replace(item, id=item.name) if shared[item.id] > 1 else item for item in found]


def cards(root: Path) -> list[str]:
    """Return the nodes of the graphics cards that can show pictures, such as `/dev/dri/card0`."""
    return [f"/dev/dri/{path.name}" for path in entries(root / "dev/dri", "card*")]


def parse_edid(block: bytes) -> Edid | None:
    """Return what 128 bytes say; None where they are no EDID or their checksum is wrong."""
    if len(block) < 128 or block[:8] != _EDID_HEAD or sum(block[:128]) & 0xFF:
        return None
    (packed,) = struct.unpack_from(">H", block, 8)
    maker = "".join(chr(64 + (packed >> shift & 31)) for shift in (10, 5, 0))
    product, serial = struct.unpack_from("<HI", block, 10)
    name = ""
    for start in range(54, 126, 18):
        if block[start : start + 5] == _NAME_TAG:
            name = block[start + 5 : start + 18].partition(b"\n")[0].decode("ascii", "replace").strip()
    return Edid(maker, product, serial, name)


def _connector(path: Path, card: str, name: str) -> Connector:
    folder = path.resolve()
    connected = text(folder / "status") == "connected"
    edid = parse_edid(data(folder / "edid")) if connected else None
    known = f"{edid.maker}{edid.product:04X}-{edid.serial}" if edid and edid.serial else name
    return Connector(
        name=name,
        id=known,
        card=card,
        node=f"/dev/dri/{card}",
        driver=target_name(folder.parent / "device" / "driver"),
        connected=connected,
        enabled=text(folder / "enabled") == "enabled",
        modes=tuple(dict.fromkeys(text(folder / "modes").split())),
        display=f"{edid.maker} {edid.name or f'{edid.product:04X}'}" if edid else "",
    )
