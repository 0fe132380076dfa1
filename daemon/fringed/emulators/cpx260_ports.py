"""The emulated projector's sockets: a pseudo-terminal under a stable link, and a TCP listener with one connection.

Owns file handles and unplugging; knows nothing of what the bytes mean. Nothing here blocks.
"""

from __future__ import annotations

import os
import socket
import tty
from contextlib import suppress
from pathlib import Path

_AGAIN_S = 0.01


class PtyPort:
    """A pseudo-terminal; `link` leads to the end that the driver opens."""

    def __init__(self, link: Path) -> None:
        self._link, self._master = link, -1
        self._again_s = 0.0

    @property
    def name(self) -> str:
        """The link's path."""
        return str(self._link)

    def plug(self) -> None:
        """Make the pseudo-terminal and its link; harmless when there."""
        if self._master >= 0:
            return
        self._master, slave = os.openpty()
        tty.setraw(slave)
        device = os.ttyname(slave)
        os.close(slave)  # whoever has it open would count as another program on that port
        os.set_blocking(self._master, False)
        fresh = self._link.with_name(self._link.name + ".new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(device)
        fresh.replace(self._link)

    def unplug(self) -> None:
        """Take both away."""
        if self._master < 0:
            return
        self._link.unlink(missing_ok=True)
        os.close(self._master)
        self._master = -1

    def handles(self, now_s: float) -> list[int]:
        """Return what to wait for; nothing while nobody has the other end open, or it would wake all the time."""
        return [self._master] if self._master >= 0 and now_s >= self._again_s else []

    def read(self, now_s: float) -> bytes:
        """Return what came."""
        if self._master < 0:
            return b""
        try:
            return os.read(self._master, 4096)
        except BlockingIOError:
            return b""
        except OSError:  # nobody has the other end open
            self._again_s = now_s + _AGAIN_S
            return b""

    def write(self, data: bytes) -> None:
        """Send; what a full line does not take is lost, as on a wire."""
        with suppress(OSError):
            os.write(self._master, data)

    def connected(self) -> bool:
        """Whether a fresh connection began; a line has none."""
        return False

    def hang_up(self) -> None:
        """Do nothing: a line has no connection."""


class TcpServer:
    """A listener on 127.0.0.1 with one connection; a second one is turned away."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._listener: socket.socket | None = None
        self._peer: socket.socket | None = None
        self._fresh = False

    @property
    def name(self) -> str:
        """Its address, with the port that it got where 0 was asked for."""
        return f"tcp://127.0.0.1:{self._number}"

    @property
    def number(self) -> int:
        """Its port."""
        return self._number

    def plug(self) -> None:
        """Listen; harmless when it does."""
        if self._listener is None:
            self._listener = socket.create_server(("127.0.0.1", self._number))
            self._listener.setblocking(False)
            self._number = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Hang up and listen no more."""
        self.hang_up()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def handles(self, now_s: float) -> list[int]:
        """Return what to wait for."""
        return [each.fileno() for each in (self._listener, self._peer) if each is not None]

    def read(self, now_s: float) -> bytes:
        """Accept a connection, and return what came on it."""
        self._accept()
        if self._peer is None:
            return b""
        try:
            data = self._peer.recv(4096)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self.hang_up()
        return data

    def write(self, data: bytes) -> None:
        """Send, if somebody is there."""
        if self._peer is not None:
            with suppress(OSError):
                self._peer.sendall(data)

    def connected(self) -> bool:
        """Whether a fresh connection began since it was asked last."""
        fresh, self._fresh = self._fresh, False
        return fresh

    def hang_up(self) -> None:
        """End the connection."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def _accept(self) -> None:
        if self._listener is None:
            return
        with suppress(BlockingIOError):
            peer, _ = self._listener.accept()
            if self._peer is not None:
                peer.close()
                return
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._peer, self._fresh = peer, True
