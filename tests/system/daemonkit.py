"""A real daemon in a folder of its own, on a small simulated rig."""

import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from fringed.errors import StationError
from fringed_client import Station

SMALL = """
name = "test"
calibration = "simulated"
[camera]
driver = "sim"
[projector]
driver = "sim"
[workers]
count = 1
[acquisition]
retries = 1
latency_s = 0.05
[simulation]
real_time = false
[simulation.sensor]
width_px = 160
height_px = 120
[simulation.scene]
object = "sphere"
"""


class Daemon:
    """Start, ask, signal, end; the log is kept for messages of failed tests."""

    def __init__(self, folder: Path, config: str = SMALL, notify: bool = True, **env: str) -> None:
        self.folder = folder
        self.config = folder / "station.toml"
        if not self.config.exists() or config != SMALL:
            self.config.write_text(config)
        self.runtime = folder / "run"
        self.env = {
            **os.environ,
            "FRINGED_RUNTIME_DIR": str(self.runtime),
            "FRINGED_DATA_DIR": str(folder / "data"),
            **env,
        }
        self.notify = None
        if notify:
            self.notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            (folder / "notify").unlink(missing_ok=True)
            self.notify.bind(str(folder / "notify"))
            self.env["NOTIFY_SOCKET"] = str(folder / "notify")
        self.log_file = (folder / "log").open("ab")
        command = [sys.executable, "-m", "fringed", "run", "--config", str(self.config)]
        self.process = subprocess.Popen(command, env=self.env, stdout=self.log_file, stderr=self.log_file)

    @property
    def log(self) -> str:
        return (self.folder / "log").read_text()

    def notified(self, timeout_s: float = 20.0) -> str:
        """Return the next datagram for the service manager."""
        ready, _, _ = select.select([self.notify], [], [], timeout_s)
        assert ready, f"nothing was notified: {self.log}"
        return self.notify.recv(4096).decode()

    def until_ready(self) -> "Daemon":
        while "READY=1" not in self.notified():
            continue
        return self

    def until_worker(self, timeout_s: float = 60.0) -> "Daemon":
        """Wait until a worker is there: the first start compiles."""
        deadline = time.monotonic() + timeout_s
        with self.client() as client:
            while not any(worker.state == "idle" for worker in client.status().workers):
                assert time.monotonic() < deadline, self.log
                time.sleep(0.1)
        return self

    def client(self) -> Station:
        return Station(str(self.runtime))

    def send(self, number: int) -> None:
        self.process.send_signal(number)

    def logged(self, text: str, timeout_s: float = 10.0) -> None:
        deadline = time.monotonic() + timeout_s
        while text not in self.log:
            assert time.monotonic() < deadline, f"{text!r} is not in the log: {self.log}"
            time.sleep(0.02)

    def end(self, number: int = signal.SIGTERM, timeout_s: float = 10.0) -> int:
        """Signal, wait, and return the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(timeout_s)
        finally:
            if self.process.poll() is None:
                self.process.kill()
                self.process.wait()
            self.log_file.close()
            if self.notify is not None:
                self.notify.close()


__all__ = ["SMALL", "Daemon", "StationError"]
