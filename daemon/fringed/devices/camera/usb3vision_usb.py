"""USB3 Vision over PyUSB: find a camera, talk to its control endpoint, fetch transfers of its stream.

Owns everything that is USB: descriptors, endpoints, error numbers. Knows no register and no pixel.
"""

from __future__ import annotations

import errno
import importlib
from array import array
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, NoReturn

import usb.core
import usb.util

from fringed.errors import ConfigurationError, DeviceAbsent, DeviceError, DeviceStalled, Problem, ProtocolError
from fringed.hookspecs import Clock
from fringed.protocols.gencp import WRITE_OVERHEAD, pieces
from fringed.protocols.gencp_conversation import Conversation
from fringed.protocols.u3v_registers import CLASS, CONTROL_PROTOCOL, STREAM_PROTOCOL, SUBCLASS

_GONE = {errno.ENODEV, errno.ENXIO, errno.ENOENT, errno.ESHUTDOWN}
_READ_BYTES = 1 << 16
_TRIES = 3
_GET_STATUS, _STATUS_MS = 0, 100
_PERMISSION = "this user may not use it: install the udev rules (`fringed doctor` says how) and plug it in again"


class TransferLost(Exception):
    """A transfer that the host could not take: larger than asked for, or broken off."""


@dataclass(frozen=True)
class _Endpoints:
    command: int
    answer: int
    stream: int
    interfaces: tuple[int, int]


def load_backend(place: str) -> Any:
    """Return what `module:callable` makes; None, PyUSB's own choice, for an empty place."""
    if not place:
        return None
    module, _, name = place.partition(":")
    try:
        return getattr(importlib.import_module(module), name)()
    except (ImportError, AttributeError, TypeError) as error:
        problem = Problem("camera.options.backend", repr(place), f"module:callable that makes a backend ({error})")
        raise ConfigurationError("1 problem:", (problem,)) from error


class Usb3VisionLink:
    """One camera's control and stream endpoints."""

    def __init__(self, serial: str, backend: Any, clock: Clock, timeout_s: float) -> None:
        self._serial, self._backend, self._clock, self._timeout_s = serial, backend, clock, timeout_s
        self._device: Any = None
        self._ends: _Endpoints | None = None
        self._conversation = Conversation()
        self._buffers: dict[int, array[int]] = {}
        self.max_command = self.max_answer = 0
        self.name = f"USB3 Vision camera {serial}".strip()

    def open(self) -> None:
        """Find the camera and claim it.

        Raises
        ------
        DeviceAbsent
            there is none, or not that one, or somebody else has it, or the permission is missing.
        """
        self.close()
        with self._named("be opened"):
            device = self._find()
            self._device, self._ends = device, _endpoints(device)
            for interface in self._ends.interfaces:
                usb.util.claim_interface(device, interface)
            for end in (self._ends.answer, self._ends.command, self._ends.stream):
                device.clear_halt(end)
        self._conversation = Conversation()
        self.max_command = self.max_answer = 64  # every camera takes that much; SBRM tells how much more
        self._drain()

    def allow(self, max_command: int, max_answer: int, response_s: float) -> None:
        """Take what the camera says of itself: its longest messages in bytes, and how long an answer may take."""
        # A camera that says less than one register, or more than a message can be, is not believed.
        self.max_command, self.max_answer = (max(32, min(size, 1 << 16)) for size in (max_command, max_answer))
        self._timeout_s = max(self._timeout_s, min(2 * response_s, 10.0))

    def close(self) -> None:
        """Release it; harmless when closed."""
        device, self._device = self._device, None
        self._buffers.clear()
        if device is not None:
            with suppress(usb.core.USBError):
                usb.util.dispose_resources(device)

    def read(self, address: int, count: int) -> bytes:
        """Return `count` bytes of the camera's memory."""
        limit = max(1, self.max_answer - 12)
        return b"".join(
            self._exchange(self._conversation.read(address + offset, length), True)
            for offset, length in pieces(count, limit)
        )

    def write(self, address: int, data: bytes) -> None:
        """Write into the camera's memory."""
        for offset, length in pieces(len(data), max(4, self.max_command - WRITE_OVERHEAD)):
            self._exchange(self._conversation.write(address + offset, data[offset : offset + length]), False)

    def transfer(self, size: int, timeout_s: float) -> memoryview | None:
        """Return the stream's next transfer, valid until the next call; None after `timeout_s`.

        Raises
        ------
        DeviceAbsent
            the camera has vanished.
        TransferLost
            what came could not be taken.
        """
        device, ends = self._require()
        buffer = self._buffers.get(size)
        if buffer is None:
            buffer = self._buffers[size] = array("B", bytes(size))
        try:
            count = device.read(ends.stream, buffer, max(1, round(timeout_s * 1000)))
        except usb.core.USBTimeoutError:
            return None
        except usb.core.USBError as error:
            if error.errno in (errno.EOVERFLOW, errno.EIO, errno.EPIPE, errno.EPROTO, errno.EILSEQ):
                self.reset_stream()
                raise TransferLost(str(error)) from error
            self._translate(error, "deliver a frame")
        return memoryview(buffer)[:count]

    def check(self) -> None:
        """See that the camera is still there, by the status that every USB device tells."""
        device, _ = self._require()
        with self._named("tell its status"):
            device.ctrl_transfer(usb.util.CTRL_IN, _GET_STATUS, 0, 0, 2, _STATUS_MS)

    def reset_stream(self) -> None:
        """Clear a halt of the stream's endpoint."""
        device, ends = self._require()
        with self._named("clear its stream"):
            device.clear_halt(ends.stream)

    def _find(self) -> Any:
        seen, others = [], []
        for device in usb.core.find(find_all=True, backend=self._backend):
            if not _is_camera(device):
                others.append(f"{device.idVendor:04x}:{device.idProduct:04x}")
                continue
            serial = _serial_of(device, needed=bool(self._serial))
            if not self._serial or serial == self._serial:
                seen.append((serial, device))
            else:
                others.append(f"camera {serial}")
        if len(seen) == 1:
            return seen[0][1]
        if seen:
            found = ", ".join(_serial_of(device, needed=False) or "?" for _, device in seen)
            raise DeviceAbsent(
                f"{len(seen)} USB3 Vision cameras are there ({found}): name one in camera.options.serial"
            )
        which = f"with the serial number {self._serial!r} " if self._serial else ""
        listed = ", ".join(others) if others else "nothing else"
        raise DeviceAbsent(
            f"no USB3 Vision camera (interface class EF, subclass 05) {which}is plugged in; on the bus: {listed}. "
            "Check its cable, its power and camera.options.serial"
        )

    def _exchange(self, command: bytes, repeatable: bool) -> bytes:
        """Send a command and return its answer; what only reads is sent again when nothing comes."""
        device, ends = self._require()
        for attempt in range(_TRIES):
            try:
                device.write(ends.command, command, round(self._timeout_s * 1000))
                answer = self._await(device, ends)
            except usb.core.USBTimeoutError:
                answer = None
            except usb.core.USBError as error:
                if error.errno != errno.EPIPE or attempt == _TRIES - 1:
                    self._conversation.give_up()
                    self._translate(error, "answer on its control endpoint")
                with self._named("clear its control endpoint"):  # halted: the command was not taken
                    device.clear_halt(ends.command)
                    device.clear_halt(ends.answer)
                continue
            if answer is not None:
                return answer
            if not repeatable:
                break
        self._conversation.give_up()
        raise DeviceStalled(
            f"the {self.name} does not answer on its control endpoint within {self._timeout_s:g} s: plug it in again, "
            "or raise camera.options.control_timeout_ms"
        )

    def _await(self, device: Any, ends: _Endpoints) -> bytes | None:
        deadline, extended = self._clock.now() + self._timeout_s, 0.0
        while (left := deadline - self._clock.now()) > 0:
            answer = self._conversation.feed(bytes(device.read(ends.answer, _READ_BYTES, max(1, round(left * 1000)))))
            if answer is not None:
                return answer
            more = self._conversation.pending_ms / 1000
            if more and extended < 10 * self._timeout_s:  # a device may ask for time, but not for ever
                extended += more
                deadline = self._clock.now() + more + self._timeout_s
        return None

    def _drain(self) -> None:
        """Drop answers to somebody else's questions."""
        device, ends = self._require()
        for _ in range(8):
            try:
                device.read(ends.answer, _READ_BYTES, 1)
            except usb.core.USBTimeoutError:
                return
            except usb.core.USBError as error:
                self._translate(error, "be read")

    def _require(self) -> tuple[Any, _Endpoints]:
        if self._device is None or self._ends is None:
            raise DeviceAbsent(f"the {self.name} is closed or has vanished: open it")
        return self._device, self._ends

    @contextmanager
    def _named(self, doing: str) -> Iterator[None]:
        try:
            yield
        except usb.core.NoBackendError as error:
            raise DeviceAbsent("no USB library is installed: install libusb 1.0 (Debian: libusb-1.0-0)") from error
        except usb.core.USBError as error:
            self._translate(error, doing)

    def _translate(self, error: Any, doing: str) -> NoReturn:
        if error.errno in _GONE:
            raise DeviceAbsent(f"the {self.name} was unplugged: plug it in again") from error
        if error.errno in (errno.EACCES, errno.EPERM):
            raise DeviceAbsent(f"the {self.name} cannot {doing}: {_PERMISSION}") from error
        if error.errno == errno.EBUSY:
            raise DeviceAbsent(f"the {self.name} is in use by another program: close its maker's viewer") from error
        if isinstance(error, usb.core.USBTimeoutError) or error.errno == errno.EPIPE:
            raise DeviceStalled(f"the {self.name} does not {doing} ({error}): plug it in again") from error
        raise DeviceError(f"the {self.name} cannot {doing}: {error}; check the cable, the port and the hub") from error


def _is_camera(device: Any) -> bool:
    try:
        return any(_role(interface) is not None for configuration in device for interface in configuration)
    except usb.core.USBError:
        return False  # gone, or its descriptors cannot be read


def _role(interface: Any) -> int | None:
    if (interface.bInterfaceClass, interface.bInterfaceSubClass) != (CLASS, SUBCLASS):
        return None
    return int(interface.bInterfaceProtocol)


def _serial_of(device: Any, needed: bool) -> str:
    """Return its serial number; empty, where it is not needed, if it cannot be read."""
    try:
        return str(device.serial_number or "").strip()
    except (ValueError, usb.core.USBError) as error:
        if not needed or getattr(error, "errno", None) in _GONE:
            return ""
        raise DeviceAbsent(f"a USB3 Vision camera's serial number cannot be read ({error}): {_PERMISSION}") from error


def _endpoints(device: Any) -> _Endpoints:
    found: dict[tuple[int, bool], int] = {}
    interfaces: dict[int, int] = {}
    for interface in device.get_active_configuration():
        role = _role(interface)
        if role in (CONTROL_PROTOCOL, STREAM_PROTOCOL) and role not in interfaces:
            interfaces[role] = interface.bInterfaceNumber
            for end in interface:
                inward = usb.util.endpoint_direction(end.bEndpointAddress) == usb.util.ENDPOINT_IN
                found.setdefault((role, inward), end.bEndpointAddress)
    wanted = ((CONTROL_PROTOCOL, False), (CONTROL_PROTOCOL, True), (STREAM_PROTOCOL, True))
    if any(key not in found for key in wanted):
        raise ProtocolError(
            f"the camera has the interfaces {sorted(interfaces)} with {len(found)} endpoints; control (0, in and out) "
            "and stream (2, in) are needed: is it a USB3 Vision camera, and in its imaging mode?"
        )
    command, answer, stream = (found[key] for key in wanted)
    return _Endpoints(command, answer, stream, (interfaces[CONTROL_PROTOCOL], interfaces[STREAM_PROTOCOL]))
