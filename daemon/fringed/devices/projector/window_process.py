"""The daemon's end of a display process: start it, ask it, end it, and tell why it ended.

Owns the process, its socket and its lifeline. No thread: whoever asks waits, and every wait has a time-out.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping

import msgspec

from fringed.display.messages import Answer, Command, Decoder, Done, Gone, Load, Quit, Ready, Refused, Setup, encode
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError, UsageError

_LEAVE_S = 2.0
_LAST_WORDS = 2000
_CHUNK = 1 << 16


class DisplayProcess:
    """A running `python -m fringed.display`."""

    def __init__(self, setup: Setup, environment: Mapping[str, str]) -> None:
        self._decoder = Decoder()
        self._waiting: list[Answer] = []
        self._token = 0
        lifeline, self._lifeline = os.pipe()
        self._words = os.memfd_create("display-stderr")  # read when it has ended; nobody needs to drain it
        self._link, theirs = socket.socketpair()
        command = [sys.executable, "-m", "fringed.display", str(theirs.fileno()), msgspec.json.encode(setup).decode()]
        try:
            self._process = subprocess.Popen(
                command, stdin=lifeline, stdout=self._words, stderr=self._words,
                pass_fds=(theirs.fileno(),), env=dict(environment), start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            self._release()
            raise DeviceError(f"the display process does not start: {error}; check memory and open files") from error
        finally:
            os.close(lifeline)
            theirs.close()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def ready(self, timeout_s: float) -> Ready:
        """Wait until its window is open and measured; raises as `ask`."""
        answer = self._next(timeout_s, "opening its window")
        if not isinstance(answer, Ready):
            raise ProtocolError(f"the display process began with {type(answer).__name__}; expected Ready")
        return answer

    def ask(self, make: Callable[[int], Command], timeout_s: float, memory: int = -1) -> float:
        """Send a command and return the time of its flip.

        Raises
        ------
        DeviceAbsent
            the display has gone, or the process has ended.
        DeviceStalled
            no answer in time: it hangs.
        UsageError
            the process refuses what was asked for.
        """
        self._token += 1
        command = make(self._token)
        what = type(command).__name__.lower()
        self._send(encode(command), memory, timeout_s)
        answer = self._next(timeout_s, f"the command {what!r}")
        if isinstance(answer, Refused):
            raise UsageError(answer.text)
        if not isinstance(answer, Done) or answer.token != self._token:
            raise ProtocolError(f"the display process answered {answer!r} to command {self._token} ({what})")
        return answer.flip_s

    def load(self, data: bytes, table: tuple[tuple[int, tuple[int, int, int]], ...], timeout_s: float) -> None:
        """Hand over patterns in memory that both share from then on; raises as `ask`."""
        memory = os.memfd_create("patterns", os.MFD_CLOEXEC)
        try:
            with open(memory, "wb", closefd=False) as file:  # a descriptor
                file.write(data)
            self.ask(lambda token: Load(token, len(data), table), timeout_s, memory)
        finally:
            os.close(memory)

    def look(self) -> None:
        """Raise DeviceAbsent if it has said that the display is gone, or has ended; waits for nothing."""
        self._link.settimeout(0)
        with contextlib.suppress(BlockingIOError):
            self._receive()
        for answer in self._waiting:
            if isinstance(answer, Gone):
                raise DeviceAbsent(answer.text)

    def _send(self, data: bytes, memory: int, timeout_s: float) -> None:
        self._link.settimeout(timeout_s)
        try:
            sent = socket.send_fds(self._link, [data], [memory]) if memory >= 0 else 0
            self._link.sendall(data[sent:])
        except TimeoutError as error:
            raise DeviceStalled(self._silent(timeout_s, "taking a command")) from error
        except OSError:
            self.look()  # what it said before it ended is the better reason
            raise DeviceAbsent(self._ended()) from None

    def _next(self, timeout_s: float, what: str) -> Answer:
        deadline = time.monotonic() + timeout_s
        while not self._waiting:
            self._link.settimeout(max(0.001, deadline - time.monotonic()))
            try:
                self._receive()
            except TimeoutError as error:
                raise DeviceStalled(self._silent(timeout_s, what)) from error
        answer = self._waiting.pop(0)
        if isinstance(answer, Gone):
            raise DeviceAbsent(answer.text)
        return answer

    def _receive(self) -> None:
        try:
            data = self._link.recv(_CHUNK)
        except (BlockingIOError, TimeoutError):
            raise
        except OSError:
            data = b""
        if not data:
            raise DeviceAbsent(self._ended())
        self._waiting += self._decoder.feed(data)  # type: ignore[arg-type]  # what is no answer is refused by type

    def _silent(self, timeout_s: float, what: str) -> str:
        return (
            f"the display process {self.pid} did not answer within {timeout_s:g} s ({what}); it is ended, and a new "
            "one starts at the next try. If this comes again, look at the graphics driver (dmesg), or raise "
            "projector.options.timeout_s"
        )

    def _ended(self) -> str:
        """Return why it ended, with what it said last."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVE_S)
        status = self._process.returncode
        if status is None:
            how = "closed its connection"
        elif status < 0:
            how = f"was killed by {_signal_name(-status)}"
        else:
            how = f"ended with status {status}"
        size = os.fstat(self._words).st_size
        words = os.pread(self._words, _LAST_WORDS, max(0, size - _LAST_WORDS)).decode(errors="replace").splitlines()
        fatal = [line for line in words if line.startswith("Fatal Python error")]
        last = " ".join(line.strip() for line in fatal[:1] or words[-3:]).strip()
        said = f"; it said: {last.rstrip('.')}" if last else ""
        return f"the display process {self.pid} {how}{said}. A new one starts at the next try"

    def end(self) -> None:
        """End it, kindly if it listens; harmless when ended."""
        if self._lifeline < 0:
            return
        if self._process.poll() is None:
            with contextlib.suppress(OSError):
                self._link.settimeout(0.1)
                self._link.sendall(encode(Quit()))
            try:
                self._process.wait(_LEAVE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                with contextlib.suppress(subprocess.TimeoutExpired):  # only a driver that hangs in the kernel
                    self._process.wait(_LEAVE_S)
        self._release()

    def kill(self) -> None:
        """End one that hangs at once."""
        if self._lifeline >= 0:
            self._process.kill()
            self.end()

    def _release(self) -> None:
        self._link.close()
        os.close(self._lifeline)
        os.close(self._words)
        self._lifeline = self._words = -1


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
