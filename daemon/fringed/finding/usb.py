"""USB devices from /sys/bus/usb/devices, and which of them are alike.

Owns identities: a serial number where no other device has it too, else the port that a device is plugged into.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fringed.finding.reading import entries, number, text

_DEVICE = re.compile(r"\d+-\d+(\.\d+)*")
_PCI = re.compile(r"[0-9a-f]{4,}:[0-9a-f]{2}:[0-9a-f]{2}\.[0-7]")
PLAIN_SERIAL = re.compile(r"[A-Za-z0-9._+@=-]{1,64}")
"""What a serial number may consist of to be matched by a rule of udev as it stands."""
HUB = "09"


@dataclass(frozen=True)
class UsbDevice:
    """A device in its port; `interfaces` are class, subclass and protocol as six hexadecimal digits."""

    port: str
    vendor_id: str
    product_id: str
    serial: str
    manufacturer: str
    product: str
    speed_mbps: float
    interfaces: tuple[str, ...]
    node: str
    path: str
    folder: Path

    @property
    def model(self) -> str:
        """`0403:6001 FTDI FT232R`: what it is, the same for all of its kind."""
        return " ".join(part for part in (self.ids, self.manufacturer, self.product) if part)

    @property
    def ids(self) -> str:
        """`0403:6001`."""
        return f"{self.vendor_id}:{self.product_id}"


def usb_devices(root: Path) -> list[UsbDevice]:
    """Return every device but the hubs, by port."""
    folders = [path for path in entries(root / "sys/bus/usb/devices") if _DEVICE.fullmatch(path.name)]
    return [_device(folder) for folder in folders if text(folder / "bDeviceClass") != HUB]


def device_above(folder: Path, devices: Sequence[UsbDevice]) -> tuple[UsbDevice | None, str]:
    """Return the USB device that a folder of /sys belongs to, and the number of the interface, such as "00"."""
    interface = ""
    for above in (folder, *folder.parents):
        interface = interface or text(above / "bInterfaceNumber")
        for device in devices:
            if above == device.folder:
                return device, interface
    return None, ""


def identity(device: UsbDevice, devices: Sequence[UsbDevice]) -> tuple[str, str]:
    """Return by what a device is told from all others, and why by its port where it is that."""
    shared = Counter(other.serial for other in devices)[device.serial]
    if not device.serial:
        return device.port, "it has no serial number"
    if shared > 1:
        return device.port, f"{shared} devices have the serial number {device.serial}"
    if not PLAIN_SERIAL.fullmatch(device.serial):
        return device.port, f"its serial number {device.serial!r} has characters that a rule cannot match"
    return device.serial, ""


def _device(link: Path) -> UsbDevice:
    folder = link.resolve()
    bus, device = number(folder / "busnum") or 0, number(folder / "devnum") or 0
    return UsbDevice(
        port=link.name,
        vendor_id=text(folder / "idVendor"),
        product_id=text(folder / "idProduct"),
        serial=text(folder / "serial"),
        manufacturer=text(folder / "manufacturer"),
        product=text(folder / "product"),
        speed_mbps=_speed(text(folder / "speed")),
        interfaces=_interfaces(folder),
        node=f"/dev/bus/usb/{bus:03}/{device:03}",
        path=_path(folder),
        folder=folder,
    )


def _interfaces(folder: Path) -> tuple[str, ...]:
    kinds = ("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol")
    return tuple(
        "".join(text(interface / kind) for kind in kinds) for interface in entries(folder, f"{folder.name}:*")
    )  # fmt: skip


def _path(folder: Path) -> str:
    """Return the place as udev's path_id writes it, without configuration and interface; it outlasts renumbered buses.

    Only controllers on PCI have one here: others are named by their port.
    """
    controller = next((part for part in reversed(folder.parts) if _PCI.fullmatch(part)), "")
    return f"pci-{controller}-usb-0:{folder.name.partition('-')[2]}" if controller else ""


def _speed(words: str) -> float:
    try:
        return float(words)
    except ValueError:
        return 0.0
