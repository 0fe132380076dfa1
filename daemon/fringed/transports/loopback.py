"""Two ends of a cable in memory: what one writes, the other one reads. For tests and emulators in one process."""

from __future__ import annotations

import queue
import threading

from fringed.errors import DeviceAbsent

_PATIENCE_S = 0.05


class Loopback:
    """One end; `pair` makes both. An end that is unplugged is gone for both until it is plugged again."""

    def __init__(self, name: str, incoming: queue.SimpleQueue[bytes], outgoing: queue.SimpleQueue[bytes]) -> None:
        self._name, self._incoming, self._outgoing = name, incoming, outgoing
        self._open, self._plugged = False, threading.Event()
        self._plugged.set()

    @classmethod
    def pair(cls, name: str = "loopback") -> tuple[Loopback, Loopback]:
        """Return both ends of a cable, closed."""
        there, back = queue.SimpleQueue[bytes](), queue.SimpleQueue[bytes]()
        near, far = cls(name, back, there), cls(name, there, back)
        far._plugged = near._plugged
        return near, far

    @property
    def name(self) -> str:
        """What messages call it."""
        return self._name

    def open(self) -> None:
        """Open this end; raises DeviceAbsent while the cable is unplugged."""
        if not self._plugged.is_set():
            raise DeviceAbsent(f"{self._name} is unplugged")
        self._open = True

    def close(self) -> None:
        """Close this end."""
        self._open = False

    def unplug(self) -> None:
        """Take the cable away."""
        self._plugged.clear()

    def plug(self) -> None:
        """Put the cable back; what was under way is lost."""
        for side in (self._incoming, self._outgoing):
            while not side.empty():
                side.get_nowait()
        self._plugged.set()

    def write(self, data: bytes) -> None:
        """Send bytes; raises DeviceAbsent when closed or unplugged."""
        self._require()
        self._outgoing.put(bytes(data))

    def read(self, timeout_s: float) -> bytes:
        """Return what has come; nothing after the time-out. Raises DeviceAbsent when closed or unplugged."""
        left = timeout_s
        while True:
            self._require()
            wait = min(left, _PATIENCE_S)
            try:
                return self._incoming.get(timeout=wait) if wait > 0 else self._incoming.get_nowait()
            except queue.Empty:
                left -= wait
                if left <= 0:
                    return b""

    def _require(self) -> None:
        if not self._plugged.is_set():
            self._open = False
            raise DeviceAbsent(f"{self._name} was unplugged")
        if not self._open:
            raise DeviceAbsent(f"{self._name} is closed: open it")
