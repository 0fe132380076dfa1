"""An MS3100's serial line as a process: `python -m fringed.emulators.ms3100 --pty LINK`.

It answers on a pseudo-terminal, which LINK points to, at the pace of its baud rate, and scrambles what a port of
another rate sends. Orders come as JSON lines on stdin: `{"fault": "drop", "count": 2}`, `{"do": "unplug"}`,
`{"do": "plug"}`, `{"do": "state"}`, `{"do": "quit"}`. What happens goes as JSON lines to stdout: "ready", "settings"
after every change, "unplugged", "plugged", "state", "error". The end of stdin ends it, unless --detached is given.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import sys
import termios
import time
import tty
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

from fringed.emulators.ms3100_camera import Answer, EmulatedMs3100
from fringed.errors import FringedError, UsageError

BITS_PER_BYTE = 10  # 8N1
_FOREVER_S = 3600.0
_ALONE_S = 0.01  # how often to look whether somebody has opened the other end


class PacedPty:
    """A pseudo-terminal that a link points to, and that sends no faster than a serial line."""

    def __init__(self, link: Path, baud: int, pace: bool = True) -> None:
        self._link, self._baud = link, baud
        self._speed = getattr(termios, f"B{baud}", None)
        if self._speed is None:
            raise UsageError(f"a terminal has no rate of {baud} baud; use 9600, 19200, 38400, 57600 or 115200")
        self._byte_s = BITS_PER_BYTE / baud if pace else 0.0
        self._fd, self._theirs = -1, ""
        self._due: deque[tuple[float, bytes]] = deque()
        self._free_s = 0.0
        self._alone_until_s = 0.0
        self._cut = False

    def plug(self) -> str:
        """Make the terminal, point the link to it, and return its own name; raises UsageError for a taken path."""
        if self._fd < 0:
            if self._link.exists() and not self._link.is_symlink():
                raise UsageError(f"{self._link} exists and is no link; choose another path for --pty")
            self._fd, theirs = os.openpty()
            self._theirs = os.ttyname(theirs)
            tty.setraw(theirs)
            modes = termios.tcgetattr(theirs)
            modes[4] = modes[5] = self._speed
            termios.tcsetattr(theirs, termios.TCSANOW, modes)
            os.close(theirs)  # or this process would be the one that has the port open
            os.set_blocking(self._fd, False)
            fresh = self._link.with_name(f".{self._link.name}.{os.getpid()}")
            fresh.symlink_to(self._theirs)
            fresh.replace(self._link)
        return self._theirs

    def unplug(self) -> None:
        """Take terminal and link away; harmless when there is none."""
        if self._fd >= 0:
            self._link.unlink(missing_ok=True)
            os.close(self._fd)
        self._fd, self._cut = -1, False
        self._due.clear()

    def waits_for(self) -> list[int]:
        """Return the handle to wait for; none while nobody has the other end open, which would never wait."""
        return [self._fd] if self._fd >= 0 and time.monotonic() >= self._alone_until_s else []

    def receive(self) -> bytes:
        """Return what has come, scrambled if it was sent at another rate."""
        try:
            data = os.read(self._fd, 4096) if self._fd >= 0 else b""
        except BlockingIOError:
            data = b""
        except OSError:  # nobody has the other end open
            data, self._alone_until_s = b"", time.monotonic() + _ALONE_S
        if not data:
            return b""
        self._free_s = max(self._free_s, time.monotonic()) + len(data) * self._byte_s
        if termios.tcgetattr(self._fd)[5] != self._speed:
            return bytes((byte >> 1 | 0xA0) & 0xFD for byte in data)
        return data

    def queue(self, answer: Answer) -> None:
        """Put an answer on the line, byte after byte."""
        self._free_s = max(self._free_s, time.monotonic()) + answer.delay_s
        data = answer.data[: len(answer.data) // 2] if answer.then_unplug else answer.data
        for byte in data:
            self._free_s += self._byte_s
            self._due.append((self._free_s, bytes((byte,))))
        self._cut = self._cut or answer.then_unplug

    def wait_s(self) -> float:
        """Return how long nothing has to be sent."""
        due = [self._due[0][0]] if self._due else []
        alone = [self._alone_until_s] if self._fd >= 0 and not self.waits_for() else []
        return max(0.0, min(due + alone) - time.monotonic()) if due or alone else _FOREVER_S

    def send(self) -> bool:
        """Send what is due; return whether the cable has to come out now."""
        now, ready = time.monotonic(), bytearray()
        while self._due and self._due[0][0] <= now:
            ready += self._due.popleft()[1]
        if ready and self._fd >= 0:
            with suppress(OSError):  # nobody reads: a serial line loses its bytes too
                os.write(self._fd, ready)
        return self._cut and not self._due


class Process:
    """The camera, its line and its orders, until the end of stdin or "quit"."""

    def __init__(self, line: PacedPty, camera: EmulatedMs3100, line_us: float, detached: bool) -> None:
        self._line, self._camera, self._line_us = line, camera, line_us
        self._listening, self._running = not detached, True
        self._orders = b""
        camera.changed = lambda _: self._settings("settings")

    def run(self) -> None:
        """Serve until told to end; the link is gone afterwards."""
        try:
            self._say("ready", port=self._line.plug())
            self._settings("settings")
            while self._running:
                self._step()
        finally:
            self._line.unplug()

    def _step(self) -> None:
        wanted = [0] * self._listening + self._line.waits_for()
        ready, _, _ = select.select(wanted, [], [], self._line.wait_s())
        if 0 in ready and self._listening:
            self._take_orders()
        if set(ready) & set(self._line.waits_for()):
            for answer in self._camera.feed(self._line.receive()):
                self._line.queue(answer)
        if self._line.send():
            self._unplug()

    def _take_orders(self) -> None:
        chunk = os.read(0, 65536)
        self._running = bool(chunk)
        *lines, self._orders = (self._orders + chunk).split(b"\n")
        for line in filter(None, map(bytes.strip, lines)):
            try:
                self._obey(json.loads(line))
            except (ValueError, TypeError, AttributeError, FringedError) as error:
                self._say("error", message=f"{line.decode(errors='replace')[:200]}: {error}")

    def _obey(self, order: dict[str, Any]) -> None:
        if "fault" in order:
            self._camera.order(str(order["fault"]), int(order.get("count", 1)))
            return
        match order.get("do"):
            case "unplug":
                self._unplug()
            case "plug":
                self._camera.restart_line()
                self._say("plugged", port=self._line.plug())
            case "state":
                self._settings("state")
            case "quit":
                self._running = False
            case other:
                raise UsageError(f"{other!r} cannot be done; use unplug, plug, state or quit")

    def _unplug(self) -> None:
        self._line.unplug()
        self._say("unplugged")

    def _settings(self, event: str) -> None:
        ccds = {
            colour: {**ccd, "integration_us": ccd["lines"] * self._line_us}
            for colour, ccd in self._camera.settings().items()
        }
        self._say(event, ccds=ccds, counts=vars(self._camera.counts))

    def _say(self, event: str, **what: Any) -> None:
        try:
            sys.stdout.write(json.dumps({"event": event, **what}) + "\n")
            sys.stdout.flush()
        except BrokenPipeError:
            self._running = False


def main(arguments: list[str] | None = None) -> None:
    """Run the emulator as the command line says."""
    parser = argparse.ArgumentParser(prog="python -m fringed.emulators.ms3100", description="an emulated MS3100")
    parser.add_argument("--pty", type=Path, required=True, help="the link that a driver opens as its serial port")
    parser.add_argument("--baud", type=int, default=9600)
    parser.add_argument("--no-pace", action="store_true", help="answer as fast as possible")
    parser.add_argument("--line-us", type=float, default=125.0, help="what a line lasts, in microseconds")
    parser.add_argument("--seed", type=int, default=0, help="what garbled bytes and junk look like")
    parser.add_argument("--detached", action="store_true", help="take no orders, and do not end with stdin")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    line = PacedPty(options.pty, options.baud, not options.no_pace)
    Process(line, EmulatedMs3100(seed=options.seed), options.line_us, options.detached).run()


if __name__ == "__main__":
    try:
        main()
    except UsageError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
