"""Scans by the hundred on the emulated laboratory while its cables, ports and frames fail at random.

Every set that is announced has to be right: its phase is compared with that of undisturbed scans. Every scan that
fails has to say why. Nothing may hang or leak: time-outs, threads, handles and memory of the daemon are watched.

    python tests/bench/bench_devices.py [--scans 150] [--seed 1] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from emulated import EmulatedStation, emulated_station

from fringed.emulators.lab import BRIDGE
from fringed.errors import FringedError, RequestTimeout, StationError
from fringed_client import Station

SIMULATION = {
    "scene": {"object": "face"},
    "sensor": {"width_px": 174, "height_px": 130, "period_s": 0.025},
    "projector": {"width_px": 256, "height_px": 192},
}
REFERENCES = 8
WRONG = 8.0  # noises: a pixel that is farther off than this is wrong
MOST_WRONG = 1e-3  # of a set's pixels: fringe orders at the head's rim
SCAN_S = 60.0
GROWN_MB, GROWN_HANDLES, GROWN_THREADS = 60.0, 8, 4

Fault = Callable[[EmulatedStation, random.Random], None]


def unplugged(emulator: str, least_s: float = 0.1, most_s: float = 1.5) -> Fault:
    def strike(station: EmulatedStation, chance: random.Random) -> None:
        station.lab.order(emulator, do="unplug")
        time.sleep(chance.uniform(least_s, most_s))
        station.lab.order(emulator, do="plug")

    return strike


def ordered(emulator: str, *orders: dict[str, Any]) -> Fault:
    return lambda station, chance: station.lab.order(emulator, **chance.choice(orders))


def switched_off(station: EmulatedStation, chance: random.Random) -> None:
    """Switch the lamp off and on again: it cools down and warms up, and refuses what comes meanwhile."""
    with Station(station.client.address) as other, suppress(FringedError):
        other.set_device("projector", "lamp", "standby")
        time.sleep(chance.uniform(0.0, 1.0))
        for _ in range(40):  # refused while it cools down
            with suppress(FringedError):
                other.set_device("projector", "lamp", "on")
                return
            time.sleep(0.25)


def killed_display(station: EmulatedStation, chance: random.Random) -> None:
    """Kill the process that owns the window."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == station.process.pid and b"fringed.display" in (process / "cmdline").read_bytes():
                os.kill(int(process.name), chance.choice([signal.SIGKILL, signal.SIGSEGV]))


FAULTS: dict[str, Fault] = {
    "projector: replies dropped, refused, junk": ordered(
        "cpx260", {"do": "drop", "count": 1}, {"do": "nak", "count": 2}, {"do": "junk", "count": 1},
        {"do": "noise", "size": 20},
    ),
    "projector: serial cable": unplugged("cpx260"),
    "projector: lamp off and on, warming up": switched_off,
    "projector: display process killed": killed_display,
    "camera: replies dropped, garbled, junk": ordered(
        "ms3100", {"fault": "drop", "count": 2}, {"fault": "garble", "count": 1}, {"fault": "junk", "count": 1}
    ),
    "camera: serial cable": unplugged("ms3100"),
    "frames: 5 % of the transfers lost": ordered(BRIDGE, {"lost_fraction": 0.05}),
    "frames: late, cut short, discarded": ordered(
        BRIDGE, {"late_next_s": [0.3]}, {"short_next": 1}, {"discard_next": 1}, {"lose_next": ["leader", "trailer"]}
    ),
    "frames: control endpoint stalled, silent": ordered(BRIDGE, {"stalled": 1}, {"silent": 1}, {"pending": 2}),
    "frames: USB cable": unplugged(BRIDGE),
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=150, help="the figure is of 1000, which take half an hour")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="fringed-devices-") as made:
        return run(asked.folder or Path(made), asked.scans, random.Random(asked.seed))


def run(folder: Path, scans: int, chance: random.Random) -> int:
    struck, failed = Counter[str](), Counter[str]()
    good = wrong = hung = unnamed = 0
    with emulated_station(folder, SIMULATION) as station:
        station.wait_ready()
        expected = reference(station)
        before = weight(station)
        for number in range(1, scans + 1):
            name = chance.choice([*FAULTS, ""]) if chance.random() < 0.7 else ""
            struck[name or "none"] += 1
            try:
                result = disturbed(station, FAULTS.get(name), chance)
            except RequestTimeout:
                hung += 1
            except FringedError as error:
                failed[f"{name or 'none'}: {type(error).__name__}"] += 1
                unnamed += not error.message.strip() or isinstance(error, StationError)
            else:
                good += 1
                wrong += not right(result, expected)
            if number % 25 == 0:
                print(f"devices: {number} of {scans} scans, {good} taken, {wrong} wrong", file=sys.stderr, flush=True)
        station.wait_ready()
        after = weight(station)
    print(f"{'PASS' if not wrong else 'MISS'}  sets announced: {good}, wrong ones among them: {wrong} (0)")
    print(f"{'PASS' if not hung else 'MISS'}  scans that did not end: {hung} of {scans} (0)")
    print(f"{'PASS' if not unnamed else 'MISS'}  failures: {sum(failed.values())}, without a reason: {unnamed} (0)")
    limits = (GROWN_MB, GROWN_HANDLES, GROWN_THREADS)
    for what, unit, a, b, most in zip(
        ("memory", "handles", "threads"), (" MB", "", ""), before, after, limits, strict=True
    ):
        print(f"{'PASS' if b - a <= most else 'MISS'}  {what} of the daemon: {a:.0f}, then {b:.0f}{unit} (+{most:g})")
    for name, count in struck.most_common():
        ended = {what.split(": ")[-1]: n for what, n in failed.items() if what.rsplit(": ", 1)[0] == name}
        print(f"INFO    {count} x {name}; failed: {ended or 'none'}")
    return 0


def disturbed(station: EmulatedStation, fault: Fault | None, chance: random.Random) -> Any:
    """Scan while a fault strikes at some moment; everything is as it was afterwards."""
    after_s = chance.uniform(0.0, 0.8)
    seed = chance.random()

    def strike() -> None:
        time.sleep(after_s)
        if fault is not None:
            fault(station, random.Random(seed))

    striking = threading.Thread(target=strike)
    striking.start()
    try:
        result = station.client.scan(timeout_s=SCAN_S)
        return result.phase_map
    finally:
        striking.join()
        station.lab.order(BRIDGE, lost_fraction=0.0)


def reference(station: EmulatedStation) -> tuple[Any, Any, Any]:
    """Return phase, deviation and mask of undisturbed scans."""
    maps = [station.client.scan(timeout_s=SCAN_S).phase_map for _ in range(REFERENCES)]
    kept = np.logical_and.reduce([one.rejected == 0 for one in maps])
    phase = np.median([one.phase_rad for one in maps], axis=0)
    return phase, maps[0].sigma_rad, kept


def right(phase_map: Any, expected: tuple[Any, Any, Any]) -> bool:
    phase, sigma, kept = expected
    both = kept & (phase_map.rejected == 0)
    off = np.abs(phase_map.phase_rad[both] - phase[both]) > WRONG * sigma[both]
    return bool(both.sum() > 0.9 * kept.sum() and off.mean() < MOST_WRONG)


def weight(station: EmulatedStation) -> tuple[float, int, int]:
    """Return the daemon's memory in MB, open handles and threads."""
    process = Path(f"/proc/{station.process.pid}")
    pages = int((process / "statm").read_text().split()[1])
    handles = 0
    with suppress(OSError):
        handles = len(list((process / "fd").iterdir()))
    return pages * 4096 / 1e6, handles, len(list((process / "task").iterdir()))


if __name__ == "__main__":
    sys.exit(main())
