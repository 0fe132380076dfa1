"""Serial ports told apart by what stays the same."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from fringed.errors import DeviceAbsent, UsageError
from fringed.transports.serial_finding import find_port, list_adapters


def port(device, serial=None, location=None, vid=None, pid=None, product=None):
    return SimpleNamespace(device=device, serial_number=serial, location=location, vid=vid, pid=pid, product=product)


PORTS = [
    port("/dev/ttyUSB2", None, "1-1.3:1.0", 0x067B, 0x2303, "USB-Serial Controller"),
    port("/dev/ttyUSB0", "A50285BI", "1-1.1:1.0", 0x0403, 0x6001, "FT232R"),
    port("/dev/ttyUSB1", "A50285BJ", "1-1.2:1.0", 0x0403, 0x6001, "FT232R"),
    port("/dev/ttyUSB3", None, "1-1.4:1.0", 0x067B, 0x2303, "USB-Serial Controller"),
    port("/dev/ttyS0"),
]


@pytest.mark.parametrize(
    ("name", "device"),
    [
        ("usb:serial=A50285BJ", "/dev/ttyUSB1"),
        ("usb:location=1-1.4", "/dev/ttyUSB3"),
        ("usb:location=1-1.3:1.0", "/dev/ttyUSB2"),
        ("usb:id=0403:6001,location=1-1.1", "/dev/ttyUSB0"),
    ],
)
def test_identical_adapters_are_told_apart(name, device):
    assert find_port(name, lambda: PORTS) == device


def test_two_that_fit_are_listed_with_what_tells_them_apart():
    with pytest.raises(DeviceAbsent, match=r"2 serial ports fit usb:id=067B:2303: /dev/ttyUSB2 \(location=1-1.3:1.0,"):
        find_port("usb:id=067B:2303", lambda: PORTS)


def test_none_that_fits_lists_those_that_are_there():
    with pytest.raises(
        DeviceAbsent, match=r"no serial port fits usb:serial=X; there are: /dev/ttyS0 \(not USB\); /dev/t"
    ):
        find_port("usb:serial=X", lambda: PORTS)
    with pytest.raises(DeviceAbsent, match=r"no /dev/nonsense; there are: none\. Plug it in"):
        find_port("/dev/nonsense", lambda: [])


def test_a_link_that_leads_nowhere_is_called_that(tmp_path):
    link = tmp_path / "projector"
    link.symlink_to(tmp_path / "gone")
    with pytest.raises(DeviceAbsent, match=r"\(a link that leads nowhere\)"):
        find_port(str(link), lambda: [])


def test_other_notations_are_refused_with_those_that_are_allowed():
    with pytest.raises(UsageError, match="has 'colour'; allowed are serial=…, location=…, id=…"):
        find_port("usb:colour=red")
    with pytest.raises(UsageError, match="'COM3' is no name of one: give a path"):
        find_port("COM3")
    with pytest.raises(UsageError, match="has 'serial'"):
        find_port("usb:serial=")


def test_adapters_are_listed_by_device():
    assert [each.device for each in list_adapters(lambda: PORTS)] == sorted(each.device for each in PORTS)
