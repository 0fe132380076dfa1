"""A TCP connection to a device.

Owns the socket; knows nothing of what the bytes mean.
"""

from __future__ import annotations

import select
import socket
from contextlib import suppress

from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, UsageError

_CHUNK = 4096
_WRITE_S = 2.0
_ALIVE = ((socket.TCP_KEEPIDLE, 5), (socket.TCP_KEEPINTVL, 2), (socket.TCP_KEEPCNT, 3))
"""A peer that lost its power is noticed after 11 s even where nobody writes."""


class TcpPort:
    """A connection to `host`:`port`."""

    def __init__(self, host: str, port: int, connect_timeout_s: float = 3.0) -> None:
        if not host or not 0 < port < 65536:
            raise UsageError(
                f"there is no TCP port {host!r}:{port}; a host's name and a port from 1 to 65535 are needed"
            )
        self._host, self._number, self._patience_s = host, port, connect_timeout_s
        self._socket: socket.socket | None = None

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"tcp://{self._host}:{self._number}"

    def open(self) -> None:
        """Connect.

        Raises
        ------
        DeviceAbsent
            no such host, nobody listens there, or no way to it.
        """
        if self._socket is not None:
            return
        try:
            connection = socket.create_connection((self._host, self._number), self._patience_s)
        except socket.gaierror as error:
            raise DeviceAbsent(
                f"there is no host {self._host!r} ({error.strerror}): correct it, or use its address"
            ) from error
        except ConnectionRefusedError as error:
            raise DeviceAbsent(
                f"{self._host} is there, and nobody listens on TCP {self._number}: enable that port in the device's "
                "network settings, or correct the number"
            ) from error
        except TimeoutError as error:
            raise DeviceAbsent(
                f"{self.name} does not answer within {self._patience_s:g} s: check its power, cable and address"
            ) from error
        except OSError as error:
            raise DeviceAbsent(
                f"there is no way to {self.name} ({error}): check the network's cable and address"
            ) from error
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in _ALIVE:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
        connection.settimeout(_WRITE_S)
        self._socket = connection

    def close(self) -> None:
        """Hang up; a read under way in another thread ends."""
        connection, self._socket = self._socket, None
        if connection is None:
            return
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
        connection.close()

    def write(self, data: bytes) -> None:
        """Send all of `data`; raises DeviceAbsent or DeviceStalled."""
        connection = self._require()
        try:
            connection.sendall(data)
        except TimeoutError as error:
            raise DeviceStalled(
                f"{self.name} takes no more bytes since {_WRITE_S:g} s: it hangs, or the network does"
            ) from error
        except OSError as error:
            raise self._lost(str(error)) from error

    def read(self, timeout_s: float) -> bytes:
        """Return what has come; nothing after the time-out. Raises DeviceAbsent when the other side hung up."""
        connection = self._require()
        try:
            ready, _, _ = select.select([connection], [], [], max(0.0, timeout_s))
            if not ready:
                return b""
            data = connection.recv(_CHUNK)
        except (OSError, ValueError) as error:  # ValueError: closed meanwhile by another thread
            raise self._lost(str(error)) from error
        if not data:
            raise self._lost("the other side hung up")
        return data

    def _require(self) -> socket.socket:
        if self._socket is None:
            raise DeviceAbsent(f"{self.name} is closed: open it")
        return self._socket

    def _lost(self, why: str) -> DeviceError:
        closed = self._socket is None
        self.close()
        return DeviceAbsent(f"{self.name} was closed" if closed else f"{self.name} is lost: {why}; it is tried again")
