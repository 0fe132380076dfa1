"""A serial port, held exclusively.

Owns the port's handle and settings; knows nothing of what the bytes mean. Every failure says what the system said,
and what to do about it.
"""

from __future__ import annotations

import errno
import fcntl
import getpass
import grp
import os
import stat
import termios
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial

from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, UsageError
from fringed.transports.serial_finding import find_port, holders

_WRITE_S = 2.0
_GONE = "was unplugged, or its adapter failed; it is tried again"


@dataclass(frozen=True)
class SerialSettings:
    """How the line is set: 19200 8N1 unless told otherwise."""

    baud: int = 19200
    data_bits: int = 8
    parity: str = "N"
    stop_bits: int = 1

    def __str__(self) -> str:
        return f"{self.baud} {self.data_bits}{self.parity}{self.stop_bits}"


class SerialPort:
    """A serial port by path, USB serial number or location; see `serial_finding`."""

    def __init__(self, name: str, settings: SerialSettings | None = None) -> None:
        self._name, self._settings = name, settings or SerialSettings()
        self._port: Any = None
        if self._settings.baud <= 0:
            raise UsageError(f"a serial port at {self._settings.baud} baud cannot be; allowed is above 0, often 19200")

    @property
    def name(self) -> str:
        """The name that it was given."""
        return self._name

    def open(self) -> None:
        """Open it, exclusively.

        Raises
        ------
        DeviceAbsent
            no such port, another program has it, or this user may not open it.
        DeviceError
            no serial port, or one that refuses the settings.
        """
        if self._port is not None:
            return
        device = find_port(self._name)
        _require_alone(device)
        chosen = self._settings
        try:
            port = serial.Serial(
                device, chosen.baud, chosen.data_bits, chosen.parity, chosen.stop_bits,
                timeout=0, write_timeout=_WRITE_S, exclusive=True,
            )  # fmt: skip
        except ValueError as error:
            raise DeviceError(f"{device} refuses {chosen}: {error}. Projectors want 19200 8N1") from error
        except (OSError, termios.error) as error:  # SerialException is an OSError
            raise _explained(error, device, chosen) from error
        with suppress(OSError, termios.error):
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        self._port = port

    def close(self) -> None:
        """Release it; a read under way in another thread ends."""
        port, self._port = self._port, None
        if port is None:
            return
        with suppress(OSError, termios.error, TypeError):
            fcntl.ioctl(port.fileno(), termios.TIOCNXCL)
        with suppress(OSError, termios.error):
            port.cancel_read()
        with suppress(OSError, termios.error):
            port.close()

    def write(self, data: bytes) -> None:
        """Send all of `data`; raises DeviceAbsent or DeviceStalled."""
        port = self._require()
        try:
            port.write(data)
        except serial.SerialTimeoutException as error:
            raise DeviceStalled(
                f"{self._name} takes no more bytes since {_WRITE_S:g} s: check the cable, and that nothing holds CTS"
            ) from error
        except (OSError, termios.error, TypeError) as error:
            raise self._lost(error) from error

    def read(self, timeout_s: float) -> bytes:
        """Return what has come; nothing after the time-out. Raises DeviceAbsent when it has vanished."""
        port = self._require()
        try:
            port.timeout = max(0.0, timeout_s)
            first: bytes = port.read(1)
            return first + port.read(port.in_waiting) if first else b""
        except (OSError, termios.error, TypeError) as error:  # TypeError: closed meanwhile by another thread
            raise self._lost(error) from error

    def _require(self) -> Any:
        port = self._port
        if port is None:
            raise DeviceAbsent(f"{self._name} is closed: open it")
        return port

    def _lost(self, error: Exception) -> DeviceAbsent:
        closed = self._port is None
        self.close()
        return DeviceAbsent(f"{self._name} was closed" if closed else f"{self._name} {_GONE} ({error})")


def _require_alone(device: str) -> None:
    """Raise DeviceAbsent where another program has `device` open: two readers share the replies at random."""
    others = _others(device)
    if others:
        raise _taken(device, others)


def _others(device: str) -> list[str]:
    try:
        return holders(device)
    except OSError:  # gone meanwhile: opening it says so
        return []


def _taken(device: str, others: list[str]) -> DeviceAbsent:
    who = ", ".join(others) or "another program, which this user may not see"
    return DeviceAbsent(f"{device} is taken by {who}: end it, or name another port")


def _explained(error: Exception, device: str, settings: SerialSettings) -> DeviceError:
    number = getattr(error, "errno", None) or next((part for part in error.args if isinstance(part, int)), None)
    if number in (errno.EACCES, errno.EPERM):
        return _forbidden(device)
    if number in (errno.EBUSY, errno.EAGAIN):
        return _taken(device, _others(device))
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.EIO):
        return DeviceAbsent(f"{device} {_GONE} ({error})")
    if "Could not configure port" in str(error):
        return DeviceError(f"{device} is no serial port, or refuses {settings} ({error}): name another one")
    return DeviceError(f"{device} does not open ({error})")


def _forbidden(device: str) -> DeviceAbsent:
    try:
        facts = Path(device).stat()
        mode = stat.filemode(facts.st_mode)
    except OSError:
        return DeviceAbsent(f"no permission to open {device}: ask who administers this machine")
    group = _group(facts.st_gid)
    user = _user()
    return DeviceAbsent(
        f"no permission to open {device} ({mode}, group {group}), and {user} is not in that group: "
        f"`sudo usermod -aG {group} {user}` and log in again, or SupplementaryGroups={group} in the service's unit"
    )


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return str(os.getuid())
