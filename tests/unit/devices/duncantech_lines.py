"""Lines to an emulated MS3100: in memory, and over a pseudo-terminal to the emulator's own process."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import termios
import time
import tty
from collections import deque
from pathlib import Path
from typing import Any

from fringed.devices.camera.duncantech_control import ControlSettings, DuncanTechControl
from fringed.emulators.ms3100_camera import EmulatedMs3100
from fringed.errors import DeviceAbsent
from fringed.protocols.duncantech import Dialect

PATIENCE_S = 0.03  # a silent line in memory is silent for good


class MemoryLine:
    """A transport whose other end is the emulated camera itself: answers are there at once, late ones after a while."""

    name = "memory"

    def __init__(self, camera: EmulatedMs3100, late_s: float = 1.3 * PATIENCE_S) -> None:
        self.camera, self.sent = camera, bytearray()
        self.plugged, self.opened = True, False
        self.opens = 0
        self._late_s = late_s
        self._due: deque[tuple[float, bytes]] = deque()

    def open(self) -> None:
        if not self.plugged:
            raise DeviceAbsent("memory: there is no such port")
        self.opened = True
        self.opens += 1

    def close(self) -> None:
        self.opened = False

    def unplug(self, comes_back: bool) -> None:
        self.plugged, self.opened = comes_back, False
        self._due.clear()

    def write(self, data: bytes) -> None:
        self._require()
        self.sent += data
        for answer in self.camera.feed(data):
            if answer.then_unplug:
                self.unplug(comes_back=True)
                return
            self._due.append((time.monotonic() + (self._late_s if answer.delay_s else 0.0), answer.data))

    def read(self, timeout_s: float) -> bytes:
        self._require()
        if self._due and self._due[0][0] <= time.monotonic() + timeout_s:
            due_s, data = self._due.popleft()
            time.sleep(max(0.0, due_s - time.monotonic()))
            return data
        time.sleep(timeout_s)
        return b""

    def _require(self) -> None:
        if not self.opened:
            raise DeviceAbsent("memory: the port has vanished")


class PtyPort:
    """The smallest serial port: raw, non-blocking, one rate."""

    def __init__(self, path: Path, baud: int = 9600) -> None:
        self.name, self._baud, self._fd = str(path), baud, -1

    def open(self) -> None:
        if self._fd >= 0:
            return
        try:
            self._fd = os.open(self.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise DeviceAbsent(f"{self.name} cannot be opened: {error}") from error
        tty.setraw(self._fd)
        modes = termios.tcgetattr(self._fd)
        modes[4] = modes[5] = getattr(termios, f"B{self._baud}")
        termios.tcsetattr(self._fd, termios.TCSANOW, modes)

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def write(self, data: bytes) -> None:
        self._guarded(lambda: os.write(self._fd, data))

    def read(self, timeout_s: float) -> bytes:
        if self._fd < 0:
            raise DeviceAbsent(f"{self.name} is closed")
        if not select.select([self._fd], [], [], max(timeout_s, 0.0))[0]:
            return b""
        data: bytes = self._guarded(lambda: os.read(self._fd, 4096))
        if not data:
            raise DeviceAbsent(f"{self.name} has vanished")
        return data

    def _guarded(self, action: Any) -> Any:
        try:
            return action()
        except OSError as error:
            raise DeviceAbsent(f"{self.name} has vanished: {error}") from error


class EmulatorProcess:
    """`python -m fringed.emulators.ms3100` and its JSON lines; end it with `close`."""

    def __init__(self, link: Path, *arguments: str) -> None:
        command = [sys.executable, "-m", "fringed.emulators.ms3100", "--pty", str(link), *arguments]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        self.events: list[dict[str, Any]] = []

    def order(self, **what: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(what) + "\n")
        self.process.stdin.flush()

    def next(self, event: str) -> dict[str, Any]:
        """Return the next event of that name; the others are kept in `events`."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.events.append(json.loads(line))
            if self.events[-1]["event"] == event:
                return self.events[-1]
        raise AssertionError(f"the emulator ended without {event!r}: {self.events}")

    def state(self) -> dict[str, Any]:
        self.order(do="state")
        return self.next("state")

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait(10)
        self.process.stdout.close()


def memory_control(unverified: bool = True, **dialect: Any) -> tuple[DuncanTechControl, MemoryLine]:
    """Return an open control of an emulated camera, and its line."""
    told = Dialect(unverified=unverified, **dialect)
    line = MemoryLine(EmulatedMs3100(Dialect(unverified=True, **dialect)))
    control = DuncanTechControl(line, ControlSettings(told, reply_timeout_s=PATIENCE_S))
    control.open()
    return control, line
