"""A machine's /sys, /dev and /proc as a folder, with the devices of a lab: adapters, cameras, displays.

Owns the layout that the kernel gives such devices; what is read from it is tested elsewhere.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

HOST = "devices/pci0000:00/0000:00:14.0"
FTDI, FT2232, PROLIFIC, HITACHI_EDID = ("0403", "6001"), ("0403", "6010"), ("067b", "2303"), b"HIT"
CLASSES = ("tty", "drm", "video4linux")
SERIAL_INTERFACE, U3V_CONTROL, U3V_STREAM, UVC = (
    ("ff", "ff", "ff"),
    ("ef", "05", "00"),
    ("ef", "05", "02"),
    ("0e", "01", "00"),
)


@dataclass
class FakeMachine:
    """A root folder that is filled piece by piece."""

    root: Path
    numbers: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for folder in ("sys/class/tty", "sys/class/drm", "sys/class/video4linux", "sys/bus/usb/devices", "dev", "proc"):
            (self.root / folder).mkdir(parents=True, exist_ok=True)

    def write(self, path: str, text: str | bytes) -> Path:
        target = self.root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(text if isinstance(text, bytes) else text.encode())
        return target

    def link(self, path: str, target: str) -> None:
        """Make a link below the root that points relatively to another path below it."""
        place = self.root / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(os.path.relpath(self.root / target, place.parent))

    def node(self, path: str, mode: int = 0o660) -> Path:
        made = self.write(path, "")
        made.chmod(mode)
        return made

    def device(self, path: str, subsystem: str, attributes: Mapping[str, str], uevent: str = "") -> str:
        """Make one device's folder in /sys and return it."""
        place = f"sys/{path}"
        for name, value in attributes.items():
            self.write(f"{place}/{name}", value + "\n")
        self.write(f"{place}/uevent", uevent)
        kind = "class" if subsystem in CLASSES else "bus"
        (self.root / f"sys/{kind}/{subsystem}").mkdir(parents=True, exist_ok=True)
        if not (self.root / place / "subsystem").exists():
            self.link(f"{place}/subsystem", f"sys/{kind}/{subsystem}")
        return place

    def usb(self, port: str, ids: tuple[str, str], serial: str | None = None, **more: str) -> str:
        """Plug a device in; `more` are attributes of the kernel, such as speed="5000"."""
        bus = port.partition("-")[0]
        number = self.numbers[bus] = self.numbers.get(bus, 1) + 1
        hub = f"{HOST}/usb{bus}"
        if not (self.root / "sys" / hub).exists():
            attributes = {"idVendor": "1d6b", "idProduct": "0002", "bDeviceClass": "09", "busnum": bus, "devnum": "1"}
            self.device(HOST, "pci", {"class": "0x0c0330"}, "PCI_SLOT_NAME=0000:00:14.0\n")
            self.device(hub, "usb", attributes, "DEVTYPE=usb_device\n")
            self.link(f"sys/bus/usb/devices/usb{bus}", f"sys/{hub}")
        chain = port.partition("-")[2].split(".")
        above = "/".join(f"{bus}-{'.'.join(chain[: k + 1])}" for k in range(len(chain) - 1))
        path = "/".join(part for part in (hub, above, port) if part)
        attributes = {"idVendor": ids[0], "idProduct": ids[1], "bcdDevice": "0600", "bDeviceClass": "00", "busnum": bus,
                      "devnum": str(number), "speed": "12", "devpath": ".".join(chain)} | more  # fmt: skip
        if serial is not None:
            attributes["serial"] = serial
        minor = (int(bus) - 1) * 128 + number - 1
        name = f"bus/usb/{int(bus):03}/{number:03}"
        product = f"{ids[0]}/{ids[1]}/600"
        self.device(path, "usb", attributes | {"dev": f"189:{minor}"},
                    f"MAJOR=189\nMINOR={minor}\nDEVNAME={name}\nDEVTYPE=usb_device\nPRODUCT={product}\n")  # fmt: skip
        self.write(f"sys/{path}/descriptors", bytes((18, 1)).ljust(18, b"\0") + bytes((9, 2)).ljust(9, b"\0"))
        self.link(f"sys/bus/usb/devices/{port}", f"sys/{path}")
        self.node(f"dev/{name}", 0o664)
        return path

    def interface(self, device: str, number: int, kind: tuple[str, str, str], driver: str = "") -> str:
        port = device.rsplit("/", 1)[1]
        path = f"{device}/{port}:1.{number}"
        attributes = {"bInterfaceNumber": f"{number:02}", "bInterfaceClass": kind[0], "bInterfaceSubClass": kind[1],
                      "bInterfaceProtocol": kind[2]}  # fmt: skip
        self.device(path, "usb", attributes, "DEVTYPE=usb_interface\n")
        self.link(f"sys/bus/usb/devices/{port}:1.{number}", f"sys/{path}")
        with (self.root / "sys" / device / "descriptors").open("ab") as descriptors:
            descriptors.write(bytes((9, 4, number, 0, 2, *bytes.fromhex("".join(kind)), 0)))
        if driver:
            (self.root / f"sys/bus/usb/drivers/{driver}").mkdir(parents=True, exist_ok=True)
            self.link(f"sys/{path}/driver", f"sys/bus/usb/drivers/{driver}")
        return path

    def tty_usb(self, device: str, name: str, number: int = 0, latency_ms: int | None = None) -> str:
        """Give a USB adapter a port `ttyUSBn`, as the usb-serial drivers do."""
        driver = "ftdi_sio" if latency_ms is not None else "pl2303"
        port = f"{self.interface(device, number, SERIAL_INTERFACE, driver)}/{name}"
        self.device(port, "usb-serial", {} if latency_ms is None else {"latency_timer": str(latency_ms)})
        self.link(f"sys/{port}/driver", f"sys/bus/usb/drivers/{driver}")
        return self._tty(port, name, 188, int(name[6:]))

    def tty_acm(self, device: str, name: str) -> str:
        return self._tty(self.interface(device, 0, ("02", "02", "01"), "cdc_acm"), name, 166, int(name[6:]))

    def tty_board(self, name: str, kind: int) -> None:
        """Make a port of the main board; kind 0 has no chip behind it."""
        self.device("devices/platform/serial8250", "platform", {})
        number = int(name[4:])
        self._tty("devices/platform/serial8250", name, 4, 64 + number)
        self.write(f"sys/devices/platform/serial8250/tty/{name}/type", f"{kind}\n")

    def _tty(self, parent: str, name: str, major: int, minor: int) -> str:
        path = f"{parent}/tty/{name}"
        self.device(path, "tty", {"dev": f"{major}:{minor}"}, f"MAJOR={major}\nMINOR={minor}\nDEVNAME={name}\n")
        self.link(f"sys/class/tty/{name}", f"sys/{path}")
        self.link(f"sys/{path}/device", f"sys/{parent}")
        self.node(f"dev/{name}")
        return path

    def camera_u3v(self, port: str, serial: str | None, speed: str = "5000") -> str:
        path = self.usb(port, ("2676", "ba02"), serial, speed=speed, product="Bridge 3", manufacturer="Maker")
        self.write(f"sys/{path}/power/control", "auto\n")
        self.interface(path, 0, U3V_CONTROL)
        self.interface(path, 1, U3V_STREAM)
        return path

    def webcam(self, port: str, serial: str | None, first: int = 0) -> str:
        path = self.usb(port, ("046d", "082d"), serial, speed="480", product="HD Pro Webcam", manufacturer="Logi")
        interface = self.interface(path, 0, UVC, "uvcvideo")
        for index in (0, 1):
            name = f"video{first + index}"
            place = f"{interface}/video4linux/{name}"
            self.device(place, "video4linux", {"name": "HD Pro Webcam", "index": str(index), "dev": f"81:{index}"},
                        f"MAJOR=81\nMINOR={first + index}\nDEVNAME={name}\n")  # fmt: skip
            self.link(f"sys/class/video4linux/{name}", f"sys/{place}")
            self.link(f"sys/{place}/device", f"sys/{interface}")
            self.node(f"dev/{name}")
        return path

    def connector(self, name: str, modes: tuple[str, ...] = (), edid: bytes = b"", card: str = "card0") -> None:
        """Make an output of a graphics card; with modes, a display is connected."""
        base = "devices/pci0000:00/0000:00:02.0"
        if not (self.root / f"sys/{base}/drm/{card}").exists():
            self.device(base, "pci", {})
            self.device(f"{base}/drm/{card}", "drm", {"dev": "226:0"}, f"MAJOR=226\nMINOR=0\nDEVNAME=dri/{card}\n")
            self.link(f"sys/class/drm/{card}", f"sys/{base}/drm/{card}")
            (self.root / "sys/bus/pci/drivers/i915").mkdir(parents=True, exist_ok=True)
            self.link(f"sys/{base}/driver", "sys/bus/pci/drivers/i915")
            self.link(f"sys/{base}/drm/{card}/device", f"sys/{base}")
            self.node(f"dev/dri/{card}")
        place = f"{base}/drm/{card}/{card}-{name}"
        status = {"status": "connected" if modes else "disconnected", "enabled": "enabled" if modes else "disabled"}
        self.device(place, "drm", status | {"dpms": "On"})
        self.write(f"sys/{place}/modes", "".join(f"{mode}\n" for mode in modes))
        self.write(f"sys/{place}/edid", edid)
        self.link(f"sys/class/drm/{card}-{name}", f"sys/{place}")


def edid(maker: bytes = HITACHI_EDID, product: int = 0x1234, serial: int = 77, name: bytes = b"CP-X260") -> bytes:
    """Return the 128 bytes by which a display says what it is (VESA E-EDID 1.3), with a right checksum."""
    letters = [value - 64 for value in maker]
    packed = letters[0] << 10 | letters[1] << 5 | letters[2]
    head = b"\x00" + b"\xff" * 6 + b"\x00" + struct.pack(">H", packed) + struct.pack("<HI", product, serial)
    body = head.ljust(54, b"\x01") + b"\x01" * 18 + b"\x00\x00\x00\xfc\x00" + (name + b"\n").ljust(13, b" ")
    body = body.ljust(127, b"\x00")
    return body + bytes([-sum(body) & 0xFF])


def lab(root: Path) -> FakeMachine:
    """Return a machine with two FTDI adapters, two alike without serial numbers, a double one, cameras, a projector."""
    machine = FakeMachine(root)
    machine.tty_usb(machine.usb("1-1", FTDI, "FTA1", product="FT232R USB UART", manufacturer="FTDI"), "ttyUSB0", 0, 16)
    machine.tty_usb(machine.usb("1-2", FTDI, "FTB2", product="FT232R USB UART", manufacturer="FTDI"), "ttyUSB1", 0, 1)
    machine.usb("1-3", ("05e3", "0608"), bDeviceClass="09")
    machine.tty_usb(machine.usb("1-3.1", PROLIFIC, product="USB-Serial Controller"), "ttyUSB2")
    machine.tty_usb(machine.usb("1-3.2", PROLIFIC, product="USB-Serial Controller"), "ttyUSB3")
    double = machine.usb("1-4", FT2232, "FTD4", product="Dual RS232", manufacturer="FTDI")
    machine.tty_usb(double, "ttyUSB4", 0, 16)
    machine.tty_usb(double, "ttyUSB5", 1, 16)
    machine.tty_acm(machine.usb("1-5", ("2341", "0043"), "ACM01", product="Board"), "ttyACM0")
    machine.webcam("1-6", "WEB6")
    machine.camera_u3v("2-1", "CAM0001")
    machine.tty_board("ttyS0", 4)
    machine.connector("HDMI-A-1", ("1024x768", "1024x768", "800x600"), edid())
    machine.connector("DP-1")
    machine.write("sys/module/usbcore/parameters/usbfs_memory_mb", "16\n")
    return machine
