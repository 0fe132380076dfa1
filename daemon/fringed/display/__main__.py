"""`python -m fringed.display`: the display process, started by the projector driver "window".

Owns the process: its end together with the daemon's, its socket, its loop. Standard input
is the lifeline: the daemon holds the other end of that pipe and never writes; when it closes, the kernel kills.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import select
import signal
import socket
import sys
from collections import deque
from typing import Any

import msgspec

from fringed.display import listing
from fringed.display.environment import ENVIRONMENT
from fringed.display.messages import Decoder, Done, Gone, Idle, Load, Ping, Quit, Ready, Refused, Setup, Show
from fringed.display.messages import encode as framed
from fringed.errors import DeviceAbsent, FringedError

TICK_S = 0.02
EXIT_STATION_GONE = 3
_F_SETSIG = 10  # of fcntl(2); Python does not name it
_CHUNK = 1 << 16


def hang_on(lifeline: int) -> None:
    """Have the kernel kill this process when the other end of `lifeline` closes, even while it hangs or is stopped."""
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, _F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)


class Loop:
    """Take commands, answer them, and look after the window meanwhile."""

    def __init__(self, link: socket.socket, window: Any, size_px: tuple[int, int]) -> None:
        self._link, self._window, self._size_px = link, window, size_px
        self._decoder = Decoder()
        self._descriptors: deque[int] = deque()

    def run(self) -> int:
        """Serve until told to quit, or the daemon or the display has gone; return the exit status."""
        try:
            self._say(self._window.open())
            while True:
                self._window.tick()
                if not select.select([self._link], [], [], TICK_S)[0]:
                    continue
                data, descriptors, _, _ = socket.recv_fds(self._link, _CHUNK, 8)
                self._descriptors.extend(descriptors)
                if not data:
                    return EXIT_STATION_GONE
                for command in self._decoder.feed(data):
                    if isinstance(command, Quit):
                        return 0
                    if isinstance(command, Load | Show | Idle | Ping):
                        self._do(command)
        except DeviceAbsent as error:
            self._say(Gone(error.message))
            return 1

    def _do(self, command: Load | Show | Idle | Ping) -> None:
        try:
            self._say(Done(command.token, self._done(command)))
        except DeviceAbsent:
            raise
        except FringedError as error:
            self._say(Refused(command.token, error.message))

    def _done(self, command: Load | Show | Idle | Ping) -> float:
        match command:
            case Load():
                self._load(command)
            case Show():
                return float(self._window.show(command.index))
            case Idle():
                return float(self._window.idle())
            case Ping():
                self._window.tick()
        return 0.0

    def _load(self, command: Load) -> None:
        from fringed.display.patterns import unpacked

        descriptor = self._descriptors.popleft()
        try:
            with mmap.mmap(descriptor, command.length, access=mmap.ACCESS_READ) as memory:
                patterns = unpacked(bytes(memory), command.table, self._size_px)
        finally:
            os.close(descriptor)
        self._window.load(patterns)

    def _say(self, answer: Ready | Done | Refused | Gone) -> None:
        self._link.sendall(framed(answer))


def main(argv: list[str]) -> int:
    """Run; `argv` is the socket's descriptor and the `Setup` as JSON. `--list` tells what displays there are."""
    if argv[:1] == ["--list"]:
        return listing.main(argv[1:])
    if len(argv) != 2:
        sys.stderr.write("usage: python -m fringed.display --list [BACKEND] [--json]; the daemon starts it otherwise\n")
        return 2
    for number in (signal.SIGINT, signal.SIGTERM):  # the daemon's affair, which closes the window in good order
        signal.signal(number, signal.SIG_IGN)
    link = socket.socket(fileno=int(argv[0]))
    setup = msgspec.json.decode(argv[1], type=Setup)
    hang_on(0)
    if os.getppid() != setup.parent:
        return EXIT_STATION_GONE  # it died before the lifeline held
    os.environ.update(ENVIRONMENT)
    from fringed.display.window import Window  # only now: SDL reads the environment when it loads

    window = Window(setup)
    try:
        return Loop(link, window, setup.size_px).run()
    except (BrokenPipeError, ConnectionResetError):
        return EXIT_STATION_GONE
    finally:
        window.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
