"""Wireshark's dissector of USB3 Vision, written by the standard's makers, reads what driver and emulator say.

Skipped where `tshark` is not installed.
"""

import shutil
import struct
import subprocess

import pytest

from fringed.data import CameraSettings
from fringed.devices.camera.usb3vision import Usb3VisionCamera
from fringed.devices.camera.usb3vision_options import Usb3VisionOptions
from fringed.emulators.u3v import CONTROL_IN, CONTROL_OUT, STREAM_IN, EmulatedUsb
from fringed.emulators.u3v_camera import EmulatedU3vCamera
from fringed.emulators.u3v_memory import EmulatedIdentity

pytestmark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
URB = struct.Struct("<QcBBBHccqiiII8siiII")  # usbmon's header of 64 bytes
BULK, CONTROL = 3, 2
USBMON = 220  # LINKTYPE_USB_LINUX_MMAPPED


class Capture:
    """USB traffic as usbmon would have seen it."""

    def __init__(self):
        self.packets, self.number = [], 0

    def exchange(self, kind, end, data, inward, setup=None):
        """Note a transfer: submitted and completed."""
        self.number += 1
        for moment in (b"S", b"C"):
            carried = data if (moment == b"C") == inward else b""
            waits = -115 if moment == b"S" else 0
            asks = b"\0" if setup and moment == b"S" else b"-"
            header = URB.pack(
                self.number, moment, kind, end, 5, 1, asks, b"\0" if carried else b"<", 1, len(self.packets), waits,
                len(data), len(carried), setup or bytes(8), 0, 0, 0, 0,
            )  # fmt: skip
            self.packets.append(header + carried)

    def describe(self):
        """Note how the computer asked for the descriptors: they tell what the endpoints are for."""
        device = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x300, 0xEF, 2, 1, 9, 0xF1A6, 1, 0x100, 1, 2, 3, 1)
        parts = b""
        for number, protocol, ends in ((0, 0, (CONTROL_IN, CONTROL_OUT)), (1, 2, (STREAM_IN,))):
            parts += struct.pack("<BBBBBBBBB", 9, 4, number, 0, len(ends), 0xEF, 5, protocol, 0)
            parts += b"".join(struct.pack("<BBBBHB", 7, 5, end, 2, 1024, 0) for end in ends)
        configuration = struct.pack("<BBHBBBBB", 9, 2, 9 + len(parts), 2, 1, 0, 0x80, 112) + parts
        for kind, data in ((1, device), (2, configuration)):
            self.exchange(CONTROL, 0x80, data, True, struct.pack("<BBHHH", 0x80, 6, kind << 8, 0, len(data)))

    def save(self, path):
        records = b"".join(struct.pack("<IIII", 1, at, len(one), len(one)) + one for at, one in enumerate(self.packets))
        path.write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, USBMON) + records)


class TappedUsb(EmulatedUsb):
    """The bus with a capture beside it."""

    def __init__(self, devices, capture):
        super().__init__(devices)
        self.capture = capture

    def bulk_write(self, dev_handle, ep, intf, data, timeout):
        self.capture.exchange(BULK, ep, data.tobytes(), False)
        return super().bulk_write(dev_handle, ep, intf, data, timeout)

    def bulk_read(self, dev_handle, ep, intf, buff, timeout):
        count = super().bulk_read(dev_handle, ep, intf, buff, timeout)
        self.capture.exchange(BULK, ep, bytes(buff[:count]), True)
        return count


def tshark(path, *arguments):
    done = subprocess.run(["tshark", "-r", path, *arguments], capture_output=True, text=True, timeout=100, check=True)
    return done.stdout.splitlines()


@pytest.fixture
def captured(tmp_path):
    capture = Capture()
    capture.describe()
    emulated = EmulatedU3vCamera(identity=EmulatedIdentity(width=40, height=30))
    emulated.faults.pending = 1
    camera = Usb3VisionCamera(Usb3VisionOptions(transfer_bytes=1024), backend=TappedUsb([emulated], capture))
    camera.open()
    camera.arm(CameraSettings(exposure_us=1000.0, trigger="software", bits=10))
    camera.trigger()
    frame = camera.read(5.0)
    camera.close()
    path = tmp_path / "u3v.pcap"
    capture.save(path)
    return path, capture, frame


def test_every_transfer_is_recognised_and_none_is_malformed(captured):
    path, capture, _ = captured
    assert tshark(path, "-Y", "_ws.malformed or _ws.expert") == []
    carried = [packet for packet in capture.packets if packet[9] == BULK and len(packet) > URB.size]
    assert len(tshark(path, "-Y", "u3v")) == len(carried)


def test_wireshark_reads_what_was_meant(captured):
    path, _, frame = captured
    text = "\n".join(tshark(path, "-Y", "u3v"))
    for word in ("[Manufacturer_Name]", "[SBRM_Address]", "PENDING_ACK", "[SI_Control]", "[SI_Payload_Transfer_Size]"):
        assert word in text
    names = ("prefix", "block_id", "payload_type", "pixel_format", "sizex", "sizey", "valid_payload_size", "status")
    fields = [part for name in names for part in ("-e", f"u3v.stream.{name}")]
    leader, trailer = tshark(path, "-Y", "u3v.stream.prefix", "-T", "fields", "-E", "separator=,", *fields)
    assert [int(value, 0) for value in leader.split(",")[:6]] == [0x4C563355, 0, 1, 0x01100003, 40, 30]
    prefix, block, *_, height, valid, status = trailer.split(",")
    assert [int(value, 0) for value in (prefix, block, height, valid, status)] == [0x54563355, 0, 30, 2400, 0]
    assert frame.image.shape == (30, 40)
