"""Serial ports from /sys/class/tty: what is behind each, and a name that stays.

Owns which ttys are ports at all: consoles, pseudo-terminals and chips that the board lacks are not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fringed.finding.reading import entries, links_to, number, target_name, text
from fringed.finding.usb import UsbDevice, device_above, identity, usb_devices

PLATFORM = "board"


@dataclass(frozen=True)
class SerialPort:
    """A port; `id` is what `fringed install-service` takes, `by_port` why that is a USB port's number."""

    node: str
    id: str
    driver: str
    description: str
    usb: UsbDevice | None = None
    interface: str = ""
    by_port: str = ""
    latency_ms: int | None = None
    latency_file: str = ""
    links: tuple[str, ...] = ()

    @property
    def setting(self) -> str:
        """The port in a configuration: the notation that the drivers of serial devices take."""
        if self.usb is None:
            return self.node
        several = self.id.endswith(f"-if{self.interface}")
        if several:
            return f"usb:location={self.usb.port}:1.{int(self.interface or '0', 16)}"
        return f"usb:location={self.usb.port}" if self.by_port else f"usb:serial={self.usb.serial}"

    @property
    def stable(self) -> str:
        """A name that stays when other devices come and go; the node where none does."""
        return self.links[0] if self.links else self.node


def serial_ports(root: Path, listed: Iterable[tuple[str, str]] = ()) -> list[SerialPort]:
    """Return the ports below `root`, and those that `listed` (node and description, from pyserial) has beside them."""
    devices = usb_devices(root)
    found = [port for path in entries(root / "sys/class/tty") if (port := _port(root, path, devices)) is not None]
    known = {port.node for port in found}
    found += [
        SerialPort(node, node, "", description, links=links_to(root, node))
        for node, description in listed
        if node not in known
    ]
    return _with_interfaces(found)


def _port(root: Path, entry: Path, devices: Sequence[UsbDevice]) -> SerialPort | None:
    node = f"/dev/{entry.name}"
    folder = entry.resolve()
    device_folder = folder / "device"
    if not device_folder.exists():
        return None
    usb, interface = device_above(folder, devices)
    driver = target_name(device_folder / "driver") or target_name(device_folder.resolve().parent / "driver")
    if usb is None:
        if not _has_chip(folder):
            return None
        return SerialPort(node, node, driver, f"{PLATFORM} port", links=links_to(root, node))
    name, why = identity(usb, devices)
    timer = device_folder.resolve() / "latency_timer"
    return SerialPort(
        node, name, driver, usb.model, usb, interface, why,
        number(timer), f"/{timer.relative_to(root.resolve())}" if timer.exists() else "", links_to(root, node),
    )  # fmt: skip


def _has_chip(folder: Path) -> bool:
    """Tell whether a port that is on no USB has a chip: type 0 is a number that the driver only reserved."""
    kind = text(folder / "type")
    return kind not in ("", "0")


def _with_interfaces(ports: list[SerialPort]) -> list[SerialPort]:
    """Add the interface to the ids of adapters with several ports."""
    shared = Counter(port.id for port in ports)
    return [replace(port, id=f"{port.id}-if{port.interface}") if shared[port.id] > 1 else port for port in ports]
