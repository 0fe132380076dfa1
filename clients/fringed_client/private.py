"""A private station for the time of one command: started, used, always stopped.

Owns the process, its folders and their removal. The station ends with whoever started it, even when that one is
killed: the kernel sends it SIGTERM then.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fringed.config.paths import data_dir
from fringed.errors import EXIT_USAGE, ConfigurationError, FringedError, NoStation

if TYPE_CHECKING:
    from fringed_client.station import Station

log = logging.getLogger(__name__)
Say = Callable[[str], None]

START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 8.0
_PREFIX = "fringe-private-"
# Ask the kernel for SIGTERM when the parent dies, make sure that it has not died before, become the station.
_GUARD = (
    "import ctypes,os,signal,sys;ctypes.CDLL(None).prctl(1,int(signal.SIGTERM));"
    "sys.exit(1) if os.getppid()!=int(sys.argv[1]) else os.execv(sys.executable,[sys.executable,*sys.argv[2:]])"
)

NO_DEVICES: dict[str, Any] = {
    "name": "private", "camera": {"driver": "none"}, "projector": {"driver": "none"}, "calibration": "",
    "workers": {"count": 1},
}  # fmt: skip
SIMULATED_RIG: dict[str, Any] = {
    "name": "private", "camera": {"driver": "sim"}, "projector": {"driver": "sim"}, "calibration": "simulated",
    "workers": {"count": 1}, "simulation": {"real_time": False},
}  # fmt: skip


def to_toml(tables: Mapping[str, Any]) -> str:
    """Return plain tables as TOML."""
    return "\n".join(f"{key} = {_value(value)}" for key, value in tables.items() if value is not None) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{json.dumps(str(k))} = {_value(v)}" for k, v in value.items() if v is not None)
        return f"{{{inner}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, (bool, str)):
        return json.dumps(value)
    return repr(value)


class PrivateStation:
    """A station of one's own: `with PrivateStation(SIMULATED_RIG) as station: ...` yields a `Station`.

    Parameters
    ----------
    config
        the configuration's tables.
    recordings
        where it records; None: a folder that is removed afterwards.

    Raises
    ------
    ConfigurationError
        it refused its configuration; the message is its own.
    NoStation
        it did not start; the message holds the end of its log.
    """

    def __init__(self, config: Mapping[str, Any], recordings: Path | None = None) -> None:
        _remove_orphans()
        self._folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        self.recordings = recordings or self._folder / "data"
        self._config = {**config, "runtime_dir": str(self._folder / "run"), "data_dir": str(self.recordings)}
        self._process: subprocess.Popen[bytes] | None = None
        self._station: Station | None = None

    @property
    def runtime(self) -> Path:
        """Its runtime folder, for further clients."""
        return self._folder / "run"

    def __enter__(self) -> Station:
        try:
            self._start()
            self._station = self._connect()
        except BaseException:
            self.stop()
            raise
        return self._station

    def __exit__(self, *exc: object) -> None:
        self.stop()

    def _start(self) -> None:
        toml = self._folder / "station.toml"
        toml.write_text(to_toml(self._config), encoding="utf-8")
        run = ["-m", "fringed", "run", "--config", str(toml)]
        environment = {k: v for k, v in os.environ.items() if k not in ("NOTIFY_SOCKET", "WATCHDOG_USEC")}
        with (self._folder / "log").open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _GUARD, str(os.getpid()), *run],
                stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment, start_new_session=True,
            )  # fmt: skip

    def _connect(self) -> Station:
        from fringed_client.station import Station

        assert self._process is not None
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                if self._process.returncode == EXIT_USAGE:
                    raise ConfigurationError(self._complaint())
                raise NoStation(f"the private station ended at once ({self._process.returncode}):\n{self._log_end()}")
            if (self.runtime / "control").exists():
                with contextlib.suppress(NoStation):  # bound, and not listening yet
                    return Station(self.runtime)
            time.sleep(0.03)
        raise NoStation(f"the private station did not start within {START_TIMEOUT_S:g} s:\n{self._log_end()}")

    def _log_end(self, lines: int = 12) -> str:
        text = (self._folder / "log").read_text(errors="replace")
        return "\n".join(text.splitlines()[-lines:])

    def _complaint(self) -> str:
        """Return what the station says of its configuration, without the lines of its log."""
        return self._log_end(40).removeprefix("fringed: ")

    def stop(self) -> None:
        """End the station and remove its folder; harmless when done. Ctrl-C does not interrupt it."""
        with _uninterrupted():
            if self._station is not None:
                with contextlib.suppress(FringedError):
                    self._station.close()
                self._station = None
            if self._process is not None:
                self._end(self._process)
                self._process = None
            shutil.rmtree(self._folder, ignore_errors=True)

    @staticmethod
    def _end(process: subprocess.Popen[bytes]) -> None:
        process.terminate()
        try:
            process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            log.warning("the private station did not stop within %g s; it is killed", STOP_TIMEOUT_S)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(STOP_TIMEOUT_S)


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    old = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, old)


def _remove_orphans() -> None:
    """Remove the folders of clients that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        pid = folder.name.removeprefix(_PREFIX).partition("-")[0]
        with contextlib.suppress(OSError):
            if pid.isdigit() and not Path(f"/proc/{pid}").exists() and folder.stat().st_uid == os.getuid():
                shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def any_station(where: str | None, say: Say, config: Path | None = None) -> Iterator[Station]:
    """Yield the running station, or a private one without devices where there is none.

    A station that was named (`where`, $FRINGED_STATION) has to be there. The private one reads and
    writes the user's own recordings, so that what was measured yesterday is found, and what is made now is kept.

    Raises
    ------
    NoStation
        the named one is not there, or the private one did not start.
    """
    from fringed_client.station import Station

    try:
        station = Station(where)
    except NoStation:
        if where or os.environ.get("FRINGED_STATION"):
            raise
    else:
        with station:
            yield station
        return
    say("no station is running: starting a private one for this command")
    with PrivateStation(_offline(config), data_dir()) as private:
        yield private


def _offline(config: Path | None) -> Mapping[str, Any]:
    if config is None:
        return NO_DEVICES
    from fringed.config import merged, read_toml

    given = {k: v for k, v in read_toml(config).items() if k not in ("runtime_dir", "data_dir", "tcp", "simulation")}
    return merged(given, NO_DEVICES)
