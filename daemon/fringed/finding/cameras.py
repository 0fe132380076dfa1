"""Cameras: USB3 Vision (class EF, subclass 05) by their interfaces, and V4L2 from /sys/class/video4linux.

Owns which of a webcam's nodes delivers pictures; GigE Vision cameras are found by asking the network, not here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fringed.finding.reading import entries, links_to, text
from fringed.finding.usb import UsbDevice, device_above, identity, usb_devices

U3V, V4L2 = "usb3-vision", "v4l2"
_U3V_KIND = "ef05"


@dataclass(frozen=True)
class FoundCamera:
    """A camera; `id` is its serial number or USB port, `by_port` why it is the latter."""

    kind: str
    node: str
    id: str
    description: str
    usb: UsbDevice | None = None
    by_port: str = ""
    links: tuple[str, ...] = ()

    @property
    def stable(self) -> str:
        """A name that stays when other devices come and go; the node where none does."""
        return self.links[0] if self.links else self.node


def cameras(root: Path) -> list[FoundCamera]:
    """Return the cameras below `root`."""
    devices = usb_devices(root)
    found = [_u3v(root, device, devices) for device in devices if _is_u3v(device)]
    found += [
        _v4l2(root, path, devices)
        for path in entries(root / "sys/class/video4linux", "video*")
        if text(path / "index") in ("", "0")  # the further nodes of a webcam deliver metadata
    ]
    shared = Counter((camera.kind, camera.id) for camera in found)
    return [replace(item, id=item.node) if shared[item.kind, item.id] > 1 else item for item in found]


def _is_u3v(device: UsbDevice) -> bool:
    return any(kind.startswith(_U3V_KIND) for kind in device.interfaces)


def _u3v(root: Path, device: UsbDevice, devices: Sequence[UsbDevice]) -> FoundCamera:
    name, why = identity(device, devices)
    return FoundCamera(U3V, device.node, name, device.model, device, why, links_to(root, device.node))


def _v4l2(root: Path, path: Path, devices: Sequence[UsbDevice]) -> FoundCamera:
    node, title = f"/dev/{path.name}", text(path / "name")
    usb, _ = device_above(path.resolve(), devices)
    name, why = identity(usb, devices) if usb is not None else (node, "")
    described = title if usb is None else f"{usb.ids} {title}"
    return FoundCamera(V4L2, node, name, described, usb, why, links_to(root, node))
