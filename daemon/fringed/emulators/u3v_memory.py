"""An emulated USB3 Vision camera's memory: bootstrap registers, feature registers, and the description of them.

Owns the addresses and the XML; knows no time and no stream.
"""

from __future__ import annotations

import io
import struct
import zipfile
from dataclasses import dataclass

from fringed.protocols import u3v_registers as reg
from fringed.protocols.gencp import STATUS_OF
from fringed.protocols.u3v_pixels import BY_NAME

SBRM_AT, SIRM_AT, MANIFEST_AT, FEATURES_AT, XML_AT = 0x10000, 0x20000, 0x30000, 0x40000, 0x100000
INCREMENT_NS = 8  # a tick of 125 MHz
ALIGNMENT_BITS = 2

WIDTH, HEIGHT, PIXEL_FORMAT, PAYLOAD = (FEATURES_AT + offset for offset in (0x00, 0x04, 0x08, 0x0C))
EXPOSURE_TICKS, GAIN, TRIGGER, TRIGGER_SOURCE = (FEATURES_AT + offset for offset in (0x10, 0x14, 0x18, 0x1C))
ACQUISITION, TRIGGER_SOFTWARE, PERIOD_US, EXPOSURE_AUTO = (FEATURES_AT + offset for offset in (0x20, 0x24, 0x28, 0x30))
BLACK_LEVEL, TEMPERATURE, ACTIVATION, GAMMA = (FEATURES_AT + offset for offset in (0x34, 0x38, 0x3C, 0x40))
TICK_US = 0.5
SOURCES = ("Software", "Line0", "Line1")


@dataclass(frozen=True)
class EmulatedIdentity:
    """What the camera says it is, and what it can; features that are `hidden` are not described, as by a bridge."""

    serial: str = "EMU-0001"
    vendor: str = "fringed"
    model: str = "Emulated U3V"
    width: int = 1392
    height: int = 1040
    formats: tuple[str, ...] = ("Mono8", "Mono10", "Mono12", "RGB8", "RGB10", "RGB12")
    zipped: bool = True
    max_transfer: int = 1024
    hidden: tuple[str, ...] = ()


class Refused(Exception):
    """The camera refuses a request; `status` says why."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.status = STATUS_OF[reason]


class CameraMemory:
    """Bytes at addresses; what a write sets off is its owner's business."""

    def __init__(self, identity: EmulatedIdentity) -> None:
        self.identity = identity
        xml = description(identity).encode()
        if identity.zipped:
            xml = _zipped(xml)
        entry = reg.encode_entry(reg.ManifestEntry(XML_AT, len(xml), identity.zipped, 0x01000000))
        self._regions = {
            0: bytearray(reg.ABRM_BYTES),
            SBRM_AT: bytearray(reg.SBRM_BYTES + 0x10),
            SIRM_AT: bytearray(reg.SIRM_BYTES),
            MANIFEST_AT: bytearray(struct.pack("<Q", 1) + entry),
            FEATURES_AT: bytearray(0x100),
            XML_AT: bytearray(xml),
        }
        self._boot()

    def read(self, address: int, count: int) -> bytes:
        """Return bytes; raises Refused for an address that the camera has not."""
        region, offset = self._find(address, count)
        return bytes(region[offset : offset + count])

    def write(self, address: int, data: bytes) -> None:
        """Write bytes; raises Refused for what is missing or protected."""
        region, offset = self._find(address, len(data))
        protected = address >= XML_AT or MANIFEST_AT <= address < FEATURES_AT or address == PAYLOAD
        if protected or (address < SBRM_AT and address != reg.TIME_STAMP_LATCH):
            raise Refused("write protected")
        region[offset : offset + len(data)] = data

    def whole(self, address: int, size: int = 4) -> int:
        """Return a register's number."""
        return int.from_bytes(self.read(address, size), "little")

    def put(self, address: int, value: int | float | str, size: int = 4) -> None:
        """Set a register from inside, protected or not."""
        region, offset = self._find(address, size)
        if isinstance(value, str):
            raw = value.encode()[: size - 1].ljust(size, b"\0")
        elif isinstance(value, float):
            raw = struct.pack("<f" if size == 4 else "<d", value)
        else:
            raw = value.to_bytes(size, "little")
        region[offset : offset + size] = raw

    def gain_db(self) -> float:
        """Return the gain that was set."""
        return float(struct.unpack("<f", self.read(GAIN, 4))[0])

    def _find(self, address: int, count: int) -> tuple[bytearray, int]:
        for start, region in self._regions.items():
            if start <= address and address + count <= start + len(region):
                return region, address - start
        raise Refused("invalid address")

    def _boot(self) -> None:
        me = self.identity
        texts = {reg.VENDOR: me.vendor, reg.MODEL: me.model, reg.DEVICE_VERSION: "1.0", reg.SERIAL_NUMBER: me.serial}
        for address, text in texts.items():
            self.put(address, text, reg.TEXT_BYTES)
        self.put(0, 0x00010002)
        self.put(reg.RESPONSE_TIME_MS, 50)
        self.put(reg.MANIFEST, MANIFEST_AT, 8)
        self.put(reg.SBRM, SBRM_AT, 8)
        self.put(reg.TIME_STAMP_INCREMENT, INCREMENT_NS, 8)
        for offset in (reg.MAX_COMMAND_BYTES, reg.MAX_ACKNOWLEDGE_BYTES):
            self.put(SBRM_AT + offset, me.max_transfer)
        self.put(SBRM_AT + reg.STREAM_CHANNELS, 1)
        self.put(SBRM_AT + reg.SIRM, SIRM_AT, 8)
        self.put(SIRM_AT + reg.STREAM_INFO, ALIGNMENT_BITS << 24)
        self.put(SIRM_AT + reg.REQUIRED_LEADER, 52)
        self.put(SIRM_AT + reg.REQUIRED_TRAILER, 32)
        for address, number in ((WIDTH, me.width), (HEIGHT, me.height), (EXPOSURE_TICKS, 16000)):
            self.put(address, number)
        self.put(PIXEL_FORMAT, BY_NAME[me.formats[0]].code)
        self.put(EXPOSURE_AUTO, 2)
        self.put(GAMMA, 1)
        self.put(TEMPERATURE, 41.5)


def _zipped(xml: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("camera.xml", xml)
    return buffer.getvalue()


def _register(name: str, address: int, mode: str = "RW", kind: str = "IntReg", more: str = "") -> str:
    return (
        f'<{kind} Name="{name}"><Address>0x{address:X}</Address><Length>4</Length>'
        f"<AccessMode>{mode}</AccessMode><pPort>Device</pPort>{more}</{kind}>"
    )


def _choice(name: str, entries: dict[str, int], register: str) -> str:
    listed = "".join(f'<EnumEntry Name="{key}"><Value>{value}</Value></EnumEntry>' for key, value in entries.items())
    return f'<Enumeration Name="{name}">{listed}<pValue>{register}</pValue></Enumeration>'


def _whole(name: str, greatest: int) -> str:
    return f'<Integer Name="{name}"><pValue>{name}Reg</pValue><Min>1</Min><Max>{greatest}</Max></Integer>'


def _command(name: str, value: int, register: str) -> str:
    return f'<Command Name="{name}"><pValue>{register}</pValue><CommandValue>{value}</CommandValue></Command>'


def description(identity: EmulatedIdentity) -> str:
    """Return the GenICam description of the emulated camera, with a node of each kind that is read."""
    on_off = {"Off": 0, "On": 1}
    parts = (
        _whole("Width", identity.width),
        _register("WidthReg", WIDTH),
        _whole("Height", identity.height),
        _register("HeightReg", HEIGHT),
        _choice("PixelFormat", {name: BY_NAME[name].code for name in identity.formats}, "PixelFormatReg"),
        _register("PixelFormatReg", PIXEL_FORMAT),
        _register("PayloadSize", PAYLOAD, "RO"),
        '<Float Name="ExposureTime"><pValue>ExposureUs</pValue><Min>10</Min><Max>10000000</Max></Float>',
        f'<Converter Name="ExposureUs"><FormulaTo>FROM / {TICK_US}</FormulaTo><FormulaFrom>TO * {TICK_US}</FormulaFrom>'
        "<pValue>ExposureReg</pValue></Converter>",
        _register("ExposureReg", EXPOSURE_TICKS),
        _choice("ExposureAuto", {"Off": 0, "Once": 1, "Continuous": 2}, "ExposureAutoReg"),
        _register("ExposureAutoReg", EXPOSURE_AUTO),
        '<Float Name="Gain"><pValue>GainReg</pValue><Min>0</Min><Max>24</Max></Float>',
        _register("GainReg", GAIN, kind="FloatReg"),
        _choice("TriggerSelector", {"FrameStart": 0, "AcquisitionStart": 1}, "TriggerSelectorReg"),
        _register("TriggerSelectorReg", TRIGGER, kind="MaskedIntReg", more="<LSB>8</LSB><MSB>11</MSB>"),
        _choice("TriggerMode", on_off, "TriggerModeReg"),
        _register("TriggerModeReg", TRIGGER, kind="MaskedIntReg", more="<Bit>0</Bit>"),
        _choice("TriggerSource", {name: index for index, name in enumerate(SOURCES)}, "TriggerSourceReg"),
        _register("TriggerSourceReg", TRIGGER_SOURCE),
        _choice("TriggerActivation", {"RisingEdge": 0, "FallingEdge": 1}, "TriggerActivationReg"),
        _register("TriggerActivationReg", ACTIVATION),
        '<Boolean Name="GammaEnable"><pValue>GammaReg</pValue></Boolean>',
        _register("GammaReg", GAMMA),
        '<Integer Name="BlackLevel"><pValue>BlackLevelReg</pValue><Min>0</Min><Max>64</Max></Integer>',
        _register("BlackLevelReg", BLACK_LEVEL),
        _register("DeviceTemperature", TEMPERATURE, "RO", "FloatReg"),
        _command("TriggerSoftware", 1, "TriggerSoftwareReg"),
        _register("TriggerSoftwareReg", TRIGGER_SOFTWARE, "WO"),
        _choice("AcquisitionMode", {"Continuous": 0}, "AcquisitionModeReg"),
        _register("AcquisitionModeReg", ACQUISITION, kind="MaskedIntReg", more="<LSB>8</LSB><MSB>11</MSB>"),
        _command("AcquisitionStart", 1, "AcquisitionReg"),
        _command("AcquisitionStop", 0, "AcquisitionReg"),
        _register("AcquisitionReg", ACQUISITION, kind="MaskedIntReg", more="<Bit>0</Bit>"),
        '<SwissKnife Name="AcquisitionResultingFrameRate"><pVariable Name="PERIOD">PeriodUs</pVariable>'
        "<Formula>1000000 / PERIOD</Formula></SwissKnife>",
        _register("PeriodUs", PERIOD_US, "RO"),
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<RegisterDescription ModelName="Emulated" VendorName="fringed" '
        'SchemaMajorVersion="1" SchemaMinorVersion="1" xmlns="http://www.genicam.org/GenApi/Version_1_1">\n'
        + "\n".join(part for part in parts if not any(f'Name="{name}"' in part for name in identity.hidden))
        + "\n</RegisterDescription>\n"
    )
