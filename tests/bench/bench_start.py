"""From exec to READY, the idle load, and memory of a station with the simulated rig at full size."""

from __future__ import annotations

import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from stationkit import SIMULATED, RunningStation, figure, info, stop

STARTS = 5
SETTLE_S, IDLE_S = 10.0, 10.0


def start(folder: Path) -> tuple[RunningStation, float]:
    """Start a daemon; return it and the time until its READY arrived."""
    address = str(folder / "notify")
    Path(address).unlink(missing_ok=True)
    (folder / "station.toml").write_text(SIMULATED)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify, (folder / "log").open("ab") as log:
        notify.bind(address)
        notify.settimeout(30)
        env = {
            **os.environ,
            "NOTIFY_SOCKET": address,
            "FRINGED_RUNTIME_DIR": str(folder / "run"),
            "FRINGED_DATA_DIR": str(folder / "data"),
        }
        begun = time.monotonic()
        command = [sys.executable, "-m", "fringed", "run", "--config", str(folder / "station.toml")]
        process = subprocess.Popen(command, env=env, stdout=log, stderr=log)
        while "READY=1" not in notify.recv(4096).decode():
            continue
        return RunningStation(process, folder, env), time.monotonic() - begun


def cpu_s(pid: int) -> float:
    """User and system time of one process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="fringed-start-") as made:
        times = []
        for turn in range(STARTS):
            running, ready_s = start(Path(made))
            times.append(ready_s)
            if turn < STARTS - 1:
                stop(running)
        text = f"{statistics.median(times):.2f} s, slowest {max(times):.2f} s of {STARTS}"
        figure("daemon start to READY", text, "under 1.5 s", statistics.median(times) < 1.5)
        time.sleep(SETTLE_S)  # the simulated rig computes its geometry in the background
        before, begun = cpu_s(running.process.pid), time.monotonic()
        time.sleep(IDLE_S)
        load = (cpu_s(running.process.pid) - before) / (time.monotonic() - begun)
        figure("idle load", f"{load:.1%} of one core over {IDLE_S:.0f} s", "under 3 %", load < 0.03)
        memory_mb = running.rss_mb()
        figure("memory of the idle daemon", f"{memory_mb:.0f} MB", "under 250 MB", memory_mb < 250)
        begun = time.monotonic()
        stop(running)
        info("SIGTERM to its end", f"{time.monotonic() - begun:.2f} s (at most 5 s)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
