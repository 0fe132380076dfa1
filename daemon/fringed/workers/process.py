"""One local worker process: start it, read its log, look at it, end it, tell why it ended.

Owns the process and its group; decides nothing. A worker leads a process group of its own, so that what a
plug-in started ends with it.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from typing import IO

from fringed.workers.blackbox import BlackBox
from fringed.workers.memory import resident_mb

_LINE_BYTES = 2000
_LAST_LINES_S = 0.1  # for what it logged last; a process that it left behind may hold the pipe for ever
_LEVELS = {name: logging.getLevelNamesMapping()[name] for name in ("DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL")}


class WorkerProcess:
    """A running `python -m fringed.workers`."""

    def __init__(self, name: str, arguments: Sequence[str], skip: Mapping[str, str]) -> None:
        self.name = name
        self.reason = ""  # why it was killed, if it was
        self._box = BlackBox.create()
        command = [sys.executable, "-m", "fringed.workers", "--name", name, "--parent", str(os.getpid())]
        command += ["--box", str(self._box.descriptor), *arguments]
        command += [part for plugin, why in skip.items() for part in ("--skip", f"{plugin}={why}")]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(self._box.descriptor,),
                process_group=0,
            )
        except OSError:
            self._box.close()
            raise
        assert self._process.stdout is not None
        self._reader = threading.Thread(
            target=_log_lines, args=(name, self._process.stdout), name=f"{name}-log", daemon=True
        )
        self._reader.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def doing(self) -> str:
        """What it is doing, or was when it died: "stage phase", "loading plug-in x", or nothing."""
        return self._box.read()

    def memory_mb(self) -> float:
        """Return what it holds."""
        return resident_mb(self.pid)

    def ended(self) -> bool:
        """Tell whether it is dead; it is not reaped yet, so its number cannot belong to anybody else."""
        if self._process.returncode is not None:
            return True
        flags = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return os.waitid(os.P_PID, self.pid, flags) is not None

    def signal(self, number: signal.Signals) -> None:
        """Signal it and whatever it started."""
        if self._process.returncode is None:
            os.killpg(self.pid, number)

    def kill(self, reason: str) -> None:
        """End it at once; the first reason stays."""
        self.reason = self.reason or reason
        self.signal(signal.SIGKILL)

    def reap(self) -> str:
        """Clear up after its end and return why it ended, such as "was killed by SIGSEGV in stage phase"."""
        doing = self.doing
        self.signal(signal.SIGKILL)  # its children
        status = self._process.wait()
        self._reader.join(_LAST_LINES_S)
        if not self._reader.is_alive() and self._process.stdout is not None:
            self._process.stdout.close()
        self._box.close()
        return self.reason or f"{_status_text(status)}{f' {_while(doing)}' if doing else ''}"


def _while(doing: str) -> str:
    return f"in {doing}" if doing.startswith("stage ") else f"while {doing}"


def _status_text(status: int) -> str:
    if status >= 0:
        return f"exited with status {status}"
    try:
        return f"was killed by {signal.Signals(-status).name}"
    except ValueError:
        return f"was killed by signal {-status}"


def _log_lines(name: str, stream: IO[bytes]) -> None:
    log = logging.getLogger(f"fringed.worker.{name}")
    while line := stream.readline(_LINE_BYTES):
        text = line.decode(errors="replace").rstrip()
        first, _, rest = text.partition(" ")
        if first in _LEVELS:
            log.log(_LEVELS[first], "%s", rest)
        elif text:  # what a plug-in printed
            log.info("%s", text)
