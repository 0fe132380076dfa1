"""A USB bus in memory, as a backend of PyUSB: emulated USB3 Vision cameras, and devices of other kinds.

bus = EmulatedUsb([EmulatedU3vCamera(picture)])
usb.core.find(backend=bus)
"""

from __future__ import annotations

import errno
import time
from array import array
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from fringed.emulators.u3v_camera import EmulatedU3vCamera
from fringed.protocols import u3v_registers as reg

CONTROL_IN, CONTROL_OUT, STREAM_IN = 0x81, 0x01, 0x82
_POLL_S = 0.0005
_INTERFACES = (
    (reg.CONTROL_PROTOCOL, (CONTROL_IN, CONTROL_OUT)),
    (reg.STREAM_PROTOCOL, (STREAM_IN,)),
)


class OtherDevice:
    """A USB device that is no camera of this kind: a webcam by default (class 0E)."""

    def __init__(self, interface_class: int = 0x0E, subclass: int = 0x01, serial: str = "WEBCAM") -> None:
        self.interface_class, self.subclass, self.serial = interface_class, subclass, serial
        self.plugged = True


Attached = EmulatedU3vCamera | OtherDevice


class EmulatedUsb(IBackend):  # type: ignore[misc]  # PyUSB has no types
    """The bus. `claimed_elsewhere` and `forbidden` make the next opening fail as for a busy or locked device."""

    def __init__(self, devices: Sequence[Attached]) -> None:
        self.devices = list(devices)
        self.claimed_elsewhere = False
        self.forbidden = False
        self.opened = 0

    def enumerate_devices(self) -> Iterator[Attached]:
        """Yield what is plugged in."""
        yield from [device for device in self.devices if device.plugged]

    def get_parent(self, dev: Attached) -> None:
        """Nothing: each hangs on the root."""

    def get_device_descriptor(self, dev: Attached) -> SimpleNamespace:
        """Return the device's descriptor."""
        camera = isinstance(dev, EmulatedU3vCamera)
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x300, bDeviceClass=0xEF, bDeviceSubClass=2, bDeviceProtocol=1,
            bMaxPacketSize0=9, idVendor=0xF1A6 if camera else 0x046D, idProduct=1, bcdDevice=0x100, iManufacturer=1,
            iProduct=2, iSerialNumber=3, bNumConfigurations=1, address=self.devices.index(dev) + 1, bus=1,
            port_number=self.devices.index(dev) + 1, port_numbers=(self.devices.index(dev) + 1,), speed=4,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: Attached, config: int) -> SimpleNamespace:
        """Return the only configuration."""
        if config:
            raise IndexError("one configuration")
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=0, bNumInterfaces=len(_interfaces(dev)), bConfigurationValue=1,
            iConfiguration=0, bmAttributes=0x80, bMaxPower=112, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: Attached, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return an interface's descriptor."""
        interfaces = _interfaces(dev)
        if alt or intf >= len(interfaces):
            raise IndexError("no such interface")
        one, two, (protocol, endpoints) = *_classes(dev), interfaces[intf]
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=intf, bAlternateSetting=0, bNumEndpoints=len(endpoints),
            bInterfaceClass=one, bInterfaceSubClass=two, bInterfaceProtocol=protocol, iInterface=0,
            extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: Attached, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return a bulk endpoint's descriptor."""
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=_interfaces(dev)[intf][1][ep], bmAttributes=2,
            wMaxPacketSize=1024, bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: Attached) -> Attached:
        """Open a device; it is its own handle."""
        _require(dev)
        if self.forbidden:
            raise USBError("Access denied (insufficient permissions)", -3, errno.EACCES)
        self.opened += 1
        return dev

    def close_device(self, dev_handle: Attached) -> None:
        """Close a device."""
        self.opened -= 1

    def get_configuration(self, dev_handle: Attached) -> int:
        """Return the configuration in force."""
        _require(dev_handle)
        return 1

    def set_configuration(self, dev_handle: Attached, config_value: int) -> None:
        """Do nothing."""
        _require(dev_handle)

    def claim_interface(self, dev_handle: Attached, intf: int) -> None:
        """Claim an interface, unless somebody else has."""
        _require(dev_handle)
        if self.claimed_elsewhere:
            raise USBError("Resource busy", -6, errno.EBUSY)

    def release_interface(self, dev_handle: Attached, intf: int) -> None:
        """Do nothing."""
        _require(dev_handle)

    def clear_halt(self, dev_handle: Attached, ep: int) -> None:
        """Do nothing: a stalled endpoint recovers when its fault is over."""
        _require(dev_handle)

    def ctrl_transfer(  # noqa: PLR0917  (PyUSB's)
        self,
        dev_handle: Attached,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array[int],
        timeout: int,
    ) -> int:
        """Return the status (request 0), or a string descriptor."""
        _require(dev_handle)
        if bRequest == 0:
            return _into(data, bytes(2))
        index = wValue & 0xFF
        serial = dev_handle.identity.serial if isinstance(dev_handle, EmulatedU3vCamera) else dev_handle.serial
        text = b"\x09\x04" if index == 0 else ("fringed", "emulated", serial)[index - 1].encode("utf-16-le")
        return _into(data, bytes([len(text) + 2, 3]) + text)

    def bulk_write(self, dev_handle: Attached, ep: int, intf: int, data: array[int], timeout: int) -> int:
        """Take a command."""
        camera = _camera(dev_handle)
        if camera.faults.take("stalled"):
            raise USBError("Pipe error", -9, errno.EPIPE)
        camera.command(data.tobytes())
        return len(data)

    def bulk_read(self, dev_handle: Attached, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        """Give an acknowledge, or a transfer of the stream."""
        camera = _camera(dev_handle)
        if ep == STREAM_IN:
            found = camera.transfer(timeout / 1000)
        else:
            deadline = time.monotonic() + timeout / 1000
            while (found := camera.answer()) is None and camera.plugged and time.monotonic() < deadline:
                time.sleep(_POLL_S)
        _require(dev_handle)
        if found is None:
            raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        return _into(buff, found)


def _into(buffer: array[int], data: bytes) -> int:
    """Fill a transfer's buffer; what is longer overflows, as it does on a real bus."""
    view = memoryview(buffer).cast("B")
    if len(data) > len(view):
        raise USBError("Overflow", -8, errno.EOVERFLOW)
    view[: len(data)] = data
    return len(data)


def _classes(dev: Attached) -> tuple[int, int]:
    if isinstance(dev, EmulatedU3vCamera):
        return reg.CLASS, reg.SUBCLASS
    return dev.interface_class, dev.subclass


def _interfaces(dev: Attached) -> tuple[tuple[int, tuple[int, ...]], ...]:
    return _INTERFACES if isinstance(dev, EmulatedU3vCamera) else ((0, (0x81,)),)


def _require(dev: Attached) -> None:
    if not dev.plugged:
        raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def _camera(handle: Any) -> EmulatedU3vCamera:
    _require(handle)
    assert isinstance(handle, EmulatedU3vCamera)
    return handle
