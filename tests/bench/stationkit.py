"""Start a real station for a benchmark, and print figures in one form."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass
class RunningStation:
    """A daemon under test: its process, folders and environment."""

    process: subprocess.Popen[bytes]
    folder: Path
    env: dict[str, str]

    @property
    def runtime(self) -> Path:
        return self.folder / "run"

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def rss_mb(self) -> float:
        """Resident memory of the daemon alone."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


SIMULATED = """
name = "bench"
calibration = "simulated"
[log]
level = "warning"
[camera]
driver = "sim"
[projector]
driver = "sim"
[simulation]
real_time = false
"""


@contextlib.contextmanager
def station(config: str = SIMULATED, folder: Path | None = None) -> Iterator[RunningStation]:
    """Run a station in a folder of its own; its runtime folder is also set for clients of this process."""
    with tempfile.TemporaryDirectory(prefix="fringed-bench-") as made:
        running = launch(config, folder or Path(made))
        try:
            yield running
        finally:
            stop(running)


def launch(config: str, folder: Path) -> RunningStation:
    """Start a daemon in `folder` and wait until it serves."""
    (folder / "station.toml").write_text(config)
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(folder / "run"), "FRINGED_DATA_DIR": str(folder / "data")}
    os.environ["FRINGED_RUNTIME_DIR"] = env["FRINGED_RUNTIME_DIR"]
    log = (folder / "log").open("ab")
    command = [sys.executable, "-m", "fringed", "run", "--config", str(folder / "station.toml")]
    process = subprocess.Popen(command, env=env, stdout=log, stderr=log)
    running = RunningStation(process, folder, env)
    wait_until_serving(running)
    return running


def wait_until_serving(running: RunningStation, timeout_s: float = 20) -> None:
    """Ask until the daemon answers; raises TimeoutError with its log."""
    from fringed.errors import StationError
    from fringed_client import Station

    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline and running.process.poll() is None:
        try:
            with Station() as client:
                client.status()
                return
        except StationError:
            time.sleep(0.1)
    raise TimeoutError((running.folder / "log").read_text()[-2000:])


def stop(running: RunningStation) -> None:
    """End the daemon, politely first."""
    running.process.terminate()
    try:
        running.process.wait(10)
    except subprocess.TimeoutExpired:
        running.process.kill()
        running.process.wait()


def figure(name: str, measured: str, demanded: str, reached: bool) -> None:
    """Print one figure beside what it has to reach."""
    print(f"{'PASS' if reached else 'MISS'}  {name}: {measured} ({demanded})", flush=True)


def info(name: str, measured: str) -> None:
    """Print a figure that has nothing to reach."""
    print(f"INFO  {name}: {measured}", flush=True)
