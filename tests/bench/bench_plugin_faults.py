"""Plug-ins that exit, dereference null, sleep for ever, leak 2 GB or raise, in a real station.

For each: the daemon and another pipeline go on, the set is tried again, then quarantined with its reason, and
the station's status says so. Then what the way through a worker costs for full-size sets.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from pathlib import Path

from stationkit import SIMULATED, RunningStation, figure, info, launch, stop
from worker_cost import overheads_ms

from fringed.errors import FringedError, Quarantined
from fringed_client import Station

ATTEMPTS = 3
FAULTS = {
    "os._exit": ("os._exit(7)", "exited with status 7"),
    "null pointer": ("ctypes.string_at(0)", "SIGSEGV"),
    "sleeps for ever": ("time.sleep(1e6)", "took longer than 10 s"),
    "leaks 2 GB": ("kept.extend(np.ones(1 << 23) for _ in range(32))", "workers.memory_mb"),
    "raises": ("raise RuntimeError('the plug-in is broken')", "RuntimeError: the plug-in is broken"),
}
PLUGIN = """
import ctypes, os, time
import numpy as np
from fringed.data import FrameSet, PhaseMap
from fringed.hookspecs import Params, hookimpl

kept = []


class Faulty:
    version = "1"
    summary = "misbehaves"
    inputs = {"frames": FrameSet}
    optional = frozenset()
    output = PhaseMap
    Params = Params

    def run(self, inputs, params, context):
        self.act()
        shape = inputs["frames"].frames.shape[1:]
        plane = np.zeros(shape, np.float32)
        return PhaseMap(plane, plane, plane, np.zeros(shape, np.uint8), "wrapped", 16.0)
"""


def write_plugins(folder: Path) -> None:
    """Write one processor for each fault, called fault-0, fault-1, …"""
    folder.mkdir()
    classes = [
        f"class Faulty{i}(Faulty):\n    name = 'fault-{i}'\n\n    def act(self):\n        {code}\n"
        for i, (code, _) in enumerate(FAULTS.values())
    ]
    names = ", ".join(f"Faulty{i}" for i in range(len(FAULTS)))
    hook = f"@hookimpl\ndef register_processors():\n    return [{names}]\n"
    (folder / "faulty.py").write_text("\n\n".join([PLUGIN, *classes, hook]))


def configuration(plugins: Path) -> str:
    """Return a small station with one pipeline for each fault."""
    parts = [SIMULATED, "[simulation.sensor]\nwidth_px = 232\nheight_px = 174\n"]
    parts.append(f"[workers]\ncount = 2\nattempts = {ATTEMPTS}\njob_timeout_s = 10\nplugin_folders = ['{plugins}']\n")
    for i in range(len(FAULTS)):
        parts.append(
            f"[pipelines.bad-{i}]\nencoder = 'multi-frequency'\nstages = [{{processor = 'fault-{i}', name = 'bad'}}]\n"
        )
    return "\n".join(parts)


class Other(threading.Thread):
    """Another client that processes with another pipeline all the while."""

    def __init__(self, frame_set: str) -> None:
        super().__init__(daemon=True)
        self.done = 0
        self.errors: list[str] = []
        self._frame_set = frame_set
        self._stopping = threading.Event()

    def run(self) -> None:
        with Station() as client:
            while not self._stopping.is_set():
                try:
                    client.process({"object": self._frame_set}, pipeline="hierarchical")
                    self.done += 1
                except FringedError as error:
                    self.errors.append(error.message)

    def finish(self) -> None:
        """Stop after the job in hand."""
        self._stopping.set()
        self.join(60)


def try_fault(client: Station, running: RunningStation, frame_set: str, index: int, other: Other) -> None:
    """Run one bad pipeline and print what became of it."""
    name, reason = list(FAULTS)[index], list(FAULTS.values())[index][1]
    before, errors, begun_s = other.done, len(other.errors), time.perf_counter()
    code, refused = "nothing raised", False
    try:
        client.process({"object": frame_set}, pipeline=f"bad-{index}")
    except FringedError as error:
        code = type(error).__name__
    took_s = time.perf_counter() - begun_s
    try:
        client.process({"object": frame_set}, pipeline=f"bad-{index}")
    except Quarantined:
        refused = True
    except FringedError as error:
        code += f", then {type(error).__name__}"
    while other.done == before and len(other.errors) == errors and time.perf_counter() - begun_s < 60:
        time.sleep(0.05)
    meanwhile, failed = other.done - before, len(other.errors) - errors
    entries = [e for e in client.status().quarantine if e.pipeline == f"bad-{index}" and e.subject == frame_set]
    tries = entries[0].attempts if entries else 0
    told = entries[0].reason if entries else "nothing"
    alive = running.process.poll() is None
    figure(f"{name}: daemon", "alive" if alive else "dead", "alive", alive)
    figure(
        f"{name}: other pipeline",
        f"{meanwhile} done, {failed} failed in {took_s:.1f} s",
        "goes on",
        meanwhile > 0 and not failed,
    )
    figure(f"{name}: tries", str(tries), str(ATTEMPTS), tries == ATTEMPTS)
    figure(f"{name}: the client is told", code, "Quarantined", code == "Quarantined")
    figure(f"{name}: status", f"quarantined: {told}", "says why", reason in told)
    figure(f"{name}: asked again", "refused at once" if refused else "tried again", "refused", refused)


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="fringed-faults-") as made:
        folder = Path(made)
        write_plugins(folder / "plugins")
        running = launch(configuration(folder / "plugins"), folder)
        try:
            with Station() as client:
                scan = client.scan(pipeline="hierarchical")
                frame_set = scan.state.frame_sets["object"]
                other = Other(frame_set)
                other.start()
                for index in range(len(FAULTS)):
                    try_fault(client, running, frame_set, index, other)
                other.finish()
                info("other pipeline in all", f"{other.done} done, {len(other.errors)} failed {other.errors[:1]}")
                cleared = client.request("quarantine.clear")["cleared"]
                figure("quarantine cleared", str(cleared), str(len(FAULTS)), cleared == len(FAULTS))
        finally:
            stop(running)
    costs = overheads_ms(12)
    median = sorted(costs)[len(costs) // 2]
    info("way through a worker, 17.4 MB in, 26 MB out", f"{min(costs):.0f} to {max(costs):.0f} ms")
    figure("the same, median", f"{median:.0f} ms", "at most 45 ms", median <= 45)
    return 0


if __name__ == "__main__":
    sys.exit(main())
