"""A daemon killed (SIGKILL) at random moments of scanning: every announced set is whole afterwards."""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

from stationkit import SIMULATED, figure, info, launch, stop

from fringed.errors import FringedError
from fringed_client import Station

KILLS = 30
SMALL = SIMULATED + "[simulation.sensor]\nwidth_px = 696\nheight_px = 520\n[acquisition]\nlatency_s = 0.045\n"


def announced_until_killed(ids: set[str], ready: threading.Event) -> None:
    """Collect the ids that the stream announces until the daemon is gone."""
    try:
        with Station() as client:
            stream = client.subscribe("frameset", "product")
            ready.set()
            for message in stream:
                ids.add(message.content.id)
    except FringedError:
        return
    finally:
        ready.set()


def scan_until_killed() -> None:
    """Scan without pause until the daemon is gone."""
    try:
        with Station() as client:
            while True:
                client.scan(pipeline="hierarchical")
    except FringedError:
        return


def main() -> int:
    random.seed(int(os.environ.get("BENCH_SEED", "7")))
    announced: set[str] = set()
    restarts_by_hand = 0
    with tempfile.TemporaryDirectory(prefix="fringed-kill-") as made:
        folder = Path(made)
        for kill in range(KILLS):
            try:
                running = launch(SMALL, folder)
            except TimeoutError as error:
                restarts_by_hand += 1
                print(f"start {kill} failed: {error}", file=sys.stderr)
                continue
            ready = threading.Event()
            threads = [
                threading.Thread(target=announced_until_killed, args=(announced, ready)),
                threading.Thread(target=scan_until_killed),
            ]
            for thread in threads:
                thread.start()
            ready.wait(10)
            time.sleep(random.uniform(0.2, 4.0))
            running.process.send_signal(signal.SIGKILL)
            running.process.wait()
            for thread in threads:
                thread.join(20)
        running = launch(SMALL, folder)
        broken = unreadable(announced)
        left = [str(p) for p in running.data.rglob("*.part")]
        stop(running)
    info("announced in all", f"{len(announced)} sets and products")
    figure("killed while scanning", f"{KILLS} times", "30 times", KILLS >= 30 and bool(announced))
    figure("announced and unreadable afterwards", str(len(broken)), "0", not broken)
    figure("partial files left after the next start", str(len(left)), "0", not left)
    figure("starts that needed a hand", str(restarts_by_hand), "0", restarts_by_hand == 0)
    return 0


def unreadable(ids: set[str]) -> list[str]:
    """Return the ids that the station cannot give whole; its reader verifies every checksum."""
    broken = []
    with Station() as client:
        for identity in sorted(ids):
            try:
                client.get(identity)
            except FringedError as error:
                broken.append(identity)
                print(f"{identity}: {error}", file=sys.stderr)
    return broken


if __name__ == "__main__":
    sys.exit(main())
