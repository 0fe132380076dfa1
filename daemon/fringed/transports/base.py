"""What every transport offers to a driver."""

from __future__ import annotations

from typing import Protocol


class Transport(Protocol):
    """Bytes to and from one device. Used by one thread; `close` may be called by another one."""

    @property
    def name(self) -> str:
        """What messages call it, such as `/dev/ttyUSB0` or `tcp://10.0.0.5:23`."""
        ...

    def open(self) -> None:
        """Open the port; harmless when open.

        Raises
        ------
        DeviceAbsent
            there is none, somebody else has it, or the permission is missing: it says which, and what to do.
        """

    def close(self) -> None:
        """Release the port; harmless when closed."""

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises
        ------
        DeviceAbsent
            the port is closed or has vanished.
        DeviceStalled
            the device takes no more bytes.
        """

    def read(self, timeout_s: float) -> bytes:
        """Return what has come, one byte at least; nothing after `timeout_s` seconds without any.

        Raises
        ------
        DeviceAbsent
            the port is closed or has vanished.
        """
        ...
