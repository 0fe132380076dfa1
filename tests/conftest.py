"""What holds for every test: no leaked thread or process, and one small station for those who want it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from zmq.utils.garbage import gc

# The row pools of kernels, and the executor of an event loop, live as long as the process on purpose.
LONG_LIVED_THREADS = ("rows", "pytest", "MainThread", "asyncio_")


def children() -> set[int]:
    """Return the process ids of this process's children that are alive."""
    found: set[int] = set()
    for task in Path("/proc/self/task").iterdir():
        try:
            found.update(int(pid) for pid in (task / "children").read_text().split())
        except OSError:
            continue
    return {pid for pid in found if _alive(pid)}


def _alive(pid: int) -> bool:
    try:
        return ") Z" not in Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False


@pytest.fixture(scope="session", autouse=True)
def _collector() -> None:
    """Start the thread in which pyzmq frees zero-copy buffers: it lives as long as the process, and is no leak."""
    if not gc.is_alive():
        gc.start()


@pytest.fixture(autouse=True)
def _no_leaks(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves threads or processes behind; wider fixtures' own are there before it starts."""
    for name in request.fixturenames:  # a module's station starts before the count
        if name.startswith("station") and name in request.fixturenames:
            request.getfixturevalue(name)
    threads, processes = set(threading.enumerate()), children()
    yield
    deadline = time.monotonic() + 3
    while time.monotonic() < deadline:
        left = {
            t for t in threading.enumerate() if t not in threads and not t.name.startswith(LONG_LIVED_THREADS)
        }  # fmt: skip
        born = children() - processes
        if not left and not born:
            return
        time.sleep(0.02)
    for pid in born:
        os.kill(pid, signal.SIGKILL)
    pytest.fail(f"left behind: threads {sorted(t.name for t in left)}, processes {sorted(born)}")


SMALL_STATION = """
name = "small"
calibration = "simulated"
[log]
level = "warning"
[camera]
driver = "sim"
[projector]
driver = "sim"
[workers]
count = 1
[simulation]
real_time = false
[simulation.sensor]
width_px = 232
height_px = 174
"""


@pytest.fixture(scope="session")
def station_runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Run a small simulated station (232 x 174) for the whole session; yields its runtime folder."""
    folder = tmp_path_factory.mktemp("station")
    config = folder / "station.toml"
    config.write_text(SMALL_STATION)
    runtime = folder / "run"
    env = {**os.environ, "FRINGED_RUNTIME_DIR": str(runtime), "FRINGED_DATA_DIR": str(folder / "data")}
    log = (folder / "log").open("wb")
    process = subprocess.Popen(
        [sys.executable, "-m", "fringed", "run", "--config", str(config)], env=env, stdout=log, stderr=log
    )
    try:
        deadline = time.monotonic() + 20
        while not (runtime / "control").exists():
            if process.poll() is not None or time.monotonic() > deadline:
                pytest.fail(f"the station did not start: {(folder / 'log').read_text()}")
            time.sleep(0.05)
        yield runtime
    finally:
        process.terminate()
        process.wait(10)
        log.close()
