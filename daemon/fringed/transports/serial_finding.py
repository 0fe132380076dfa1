"""Find a serial port by what stays the same: its path, its USB serial number, or the place it is plugged into.

Owns the notation; opens nothing. `/dev/ttyUSB0` changes with the order of plugging in. A link that udev keeps, a
serial number or a location does not: `usb:serial=A50285BI`, `usb:location=1-1.4`, `usb:id=0403:6001`, and these
joined by commas.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from fringed.errors import DeviceAbsent, UsageError

PREFIX = "usb:"
KEYS = ("serial", "location", "id")
_NO_LINES = (0, 1)  # plain files, and /dev/null and its like, which everybody has open


@dataclass(frozen=True)
class SerialAdapter:
    """What can be told of one serial port without opening it; empty where it has none."""

    device: str
    serial: str = ""
    location: str = ""
    id: str = ""
    product: str = ""

    def __str__(self) -> str:
        told = [f"{key}={value}" for key in KEYS if (value := getattr(self, key))]
        return f"{self.device} ({', '.join(told) or self.product or 'not USB'})"


Listing = Callable[[], Iterable[Any]]


def list_adapters(listing: Listing = list_ports.comports) -> list[SerialAdapter]:
    """Return every serial port of this machine, sorted by device."""
    return sorted((_adapter(port) for port in listing()), key=lambda each: each.device)


def find_port(name: str, listing: Listing = list_ports.comports) -> str:
    """Return the device's path for `name`, a path or `usb:key=value,…`.

    Raises
    ------
    UsageError
        a notation that is none of these.
    DeviceAbsent
        no port, or more than one, fits; it lists those that are there.
    """
    if not name.startswith(PREFIX):
        return _existing(name, listing)
    wanted = _wanted(name)
    there = list_adapters(listing)
    found = [each for each in there if all(_fits(each, key, value) for key, value in wanted.items())]
    if len(found) == 1:
        return found[0].device
    if found:
        raise DeviceAbsent(
            f"{len(found)} serial ports fit {name}: {_told(found)}. Add what tells them apart: usb:serial=…, or "
            "usb:location=… for adapters without a serial number"
        )
    raise DeviceAbsent(f"no serial port fits {name}; there are: {_told(there)}. Plug it in, or correct the name")


def _existing(name: str, listing: Listing) -> str:
    if not name.startswith("/"):
        raise UsageError(
            f"the serial port {name!r} is no name of one: give a path such as /dev/serial/by-id/…, or "
            f"{PREFIX}serial=…, {PREFIX}location=…, {PREFIX}id=0403:6001"
        )
    if not Path(name).exists():
        dangling = " (a link that leads nowhere)" if Path(name).is_symlink() else ""
        raise DeviceAbsent(
            f"there is no {name}{dangling}; there are: {_told(list_adapters(listing))}. Plug it in, or correct the name"
        )
    return name


def _wanted(name: str) -> dict[str, str]:
    pairs = [part.partition("=") for part in name.removeprefix(PREFIX).split(",")]
    wrong = [key for key, _, value in pairs if key not in KEYS or not value]
    if wrong:
        raise UsageError(f"the serial port {name!r} has {wrong[0]!r}; allowed are {', '.join(f'{k}=…' for k in KEYS)}")
    return {key: value for key, _, value in pairs}


def _fits(adapter: SerialAdapter, key: str, value: str) -> bool:
    seen = str(getattr(adapter, key))
    if key == "location":  # 1-1.4 means the adapter there, whichever of its interfaces
        return seen == value or seen.partition(":")[0] == value
    return seen.lower() == value.lower() if key == "id" else seen == value


def _adapter(port: Any) -> SerialAdapter:
    known = port.vid is not None and port.pid is not None
    return SerialAdapter(
        port.device, port.serial_number or "", port.location or "",
        f"{port.vid:04x}:{port.pid:04x}" if known else "", port.product or "",
    )  # fmt: skip


def _told(adapters: list[SerialAdapter]) -> str:
    return "; ".join(map(str, adapters)) or "none"


def holders(device: str) -> list[str]:
    """Return the other programs that have `device` open, as `name (pid)`, as far as this user may see them."""
    number = Path(device).stat().st_rdev
    if os.major(number) in _NO_LINES:
        return []
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and int(process.name) != os.getpid() and _holds(process, number):
            found.append(f"{_program(process)} (pid {process.name})")
    return found


def _holds(process: Path, number: int) -> bool:
    try:
        return any(_number(handle) == number for handle in (process / "fd").iterdir())
    except OSError:
        return False


def _number(handle: Path) -> int | None:
    try:
        if not str(handle.readlink()).startswith("/dev/"):
            return None
        return handle.stat().st_rdev
    except OSError:
        return None


def _program(process: Path) -> str:
    try:
        return (process / "comm").read_text().strip()
    except OSError:
        return "a program"
