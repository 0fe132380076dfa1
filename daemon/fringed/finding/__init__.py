"""What is plugged into this machine: serial ports, USB devices, displays, cameras, and what is installed for them.

Owns reading /sys, /dev, /proc and /etc below a root folder, which tests replace by one of their own; opens no device
and changes nothing.
"""

from fringed.finding.cameras import FoundCamera, cameras
from fringed.finding.displays import Connector, connectors
from fringed.finding.installed import Installed, installed
from fringed.finding.machine import Machine, this_machine
from fringed.finding.permissions import Access, Holder, User, access, current_user, holders
from fringed.finding.ports import SerialPort, serial_ports
from fringed.finding.usb import UsbDevice, usb_devices

__all__ = [
    "Access", "Connector", "FoundCamera", "Holder", "Installed", "Machine", "SerialPort", "UsbDevice", "User", "access",
    "cameras", "connectors", "current_user", "holders", "installed", "serial_ports", "this_machine", "usb_devices",
]  # fmt: skip
