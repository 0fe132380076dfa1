"""The stream: throughput beside a bare pyzmq pair, and what a stopped subscriber costs the others.

The daemon is a real one; it announces one recorded frame set of the figure's size again and again. Subscribers are
processes of their own. Both rates are taken in turns in one run, so that the machine's mood counts for both.
"""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from stationkit import SIMULATED, RunningStation, figure, info, station

from fringed import wire
from fringed.data import FrameSet, PatternFrame, PatternSequence
from fringed_client import Station

WIDTH_PX, HEIGHT_PX, FRAMES = 1392, 1040, 12
ROUNDS, PER_ROUND = 5, 100
SETS, INTERVAL_S = 200, 0.05
CONFIG = SIMULATED + "[simulation.sensor]\nwidth_px = 232\nheight_px = 174\n[workers]\ncount = 0\n"


def frame_set() -> FrameSet:
    stamped = tuple(PatternFrame("sinusoid", period_px=16.0, step=i, steps=FRAMES) for i in range(FRAMES))
    patterns = tuple(np.zeros((1, 1024, 1), np.uint8) for _ in range(FRAMES))
    sequence = PatternSequence("bench", 1024, 768, stamped, patterns)
    frames = np.random.default_rng(1).integers(0, 255, (FRAMES, HEIGHT_PX, WIDTH_PX), np.uint8)
    return FrameSet(frames, sequence)


# What runs in processes of its own: `bench_stream.py ROLE …`.


def subscriber(address: str, topic: str, count: str) -> None:
    """Receive without decoding until `count` messages came or nothing more does; print seqs and times."""
    socket = zmq.Context.instance().socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 2)
    socket.connect(address)
    socket.subscribe(topic)
    print("ready", flush=True)
    seen: list[tuple[int, float]] = []
    deadline_ms = 30_000
    while len(seen) < int(count) and (socket.poll(deadline_ms) or socket.poll(deadline_ms)):  # a stop outlasts one
        parts = socket.recv_multipart(copy=False)
        seq = wire.peek([part.buffer for part in parts])[1].seq if topic else len(seen)
        if not seen or seq != seen[-1][0]:
            seen.append((seq, time.monotonic()))
        deadline_ms = 2_500
    print(" ".join(f"{seq}:{when:.6f}" for seq, when in seen), flush=True)


def bare_publisher(address: str, count: str) -> None:
    """Publish plain copies-free messages of the same size as fast as they leave."""
    content = wire.encode(frame_set(), wire.TOPIC_FRAME_SET, 1)[:3]  # the frames last: pyzmq tracks the last part only
    socket = zmq.Context.instance().socket(zmq.PUB)
    socket.setsockopt(zmq.SNDHWM, 2)
    socket.bind(address)
    print("ready", flush=True)
    sys.stdin.readline()
    waiting: list[zmq.MessageTracker] = []
    for _ in range(int(count)):
        while len(waiting) >= 2 and not waiting[0].done:
            time.sleep(0.0002)
        waiting = waiting[-1:]
        waiting.append(socket.send_multipart(content, copy=False, track=True))
    waiting[-1].wait(5)
    time.sleep(0.5)


class Process:
    """One of the roles above."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.process.stdout.readline()

    def go(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write("go\n")
        self.process.stdin.flush()

    def seen(self) -> list[tuple[int, float]]:
        out = self.process.communicate(timeout=120)[0].split()
        return [(int(seq), float(when)) for seq, when in (item.split(":") for item in out)]


def rate(seen: list[tuple[int, float]]) -> float:
    """Messages a second, from the first to the last."""
    return (len(seen) - 1) / (seen[-1][1] - seen[0][1]) if len(seen) > 2 else 0.0


def bare_rate(folder: Path) -> float:
    address = f"ipc://{folder}/bare"
    publisher = Process("bare", address, str(PER_ROUND))
    reader = Process("subscriber", address, "", str(PER_ROUND))
    time.sleep(0.3)
    publisher.go()
    seen = reader.seen()
    publisher.process.wait(30)
    return rate(seen)


def daemon_rate(running: RunningStation, client: Station, item: str) -> tuple[float, int]:
    reader = Process("subscriber", f"ipc://{running.runtime}/stream", wire.TOPIC_FRAME_SET, str(PER_ROUND))
    time.sleep(1.3)  # the last value comes again within a second
    client.request("republish", id=item, times=PER_ROUND, interval_s=0.0)
    seen = reader.seen()
    seqs = [seq for seq, _ in seen]
    missed = seqs[-1] - seqs[0] + 1 - len(seqs)
    fresh = seen[1:] if len(seen) > 1 and seen[1][1] - seen[0][1] > 0.2 else seen
    return rate(fresh), missed


def throughput(running: RunningStation, client: Station, item: str) -> None:
    with tempfile.TemporaryDirectory(prefix="fringed-bare-") as made:
        pairs = []
        for _ in range(ROUNDS):
            bare = bare_rate(Path(made))
            ours, missed = daemon_rate(running, client, item)
            pairs.append((ours / bare, ours, bare, missed))
    ratio = statistics.median(pair[0] for pair in pairs)
    ours, bare = statistics.median(p[1] for p in pairs), statistics.median(p[2] for p in pairs)
    text = f"{ratio:.2f} ({ours:.0f} of {bare:.0f} sets/s, {ours * 17.4e-3:.2f} GB/s; missed {[p[3] for p in pairs]})"
    figure("sets of 17.4 MB to a subscriber over ipc, relative to a bare pair", text, "at least 0.80", ratio >= 0.8)


def stopped_subscriber(running: RunningStation, client: Station, item: str) -> None:
    address = f"ipc://{running.runtime}/stream"
    stopped = Process("subscriber", address, wire.TOPIC_FRAME_SET, str(100_000))
    time.sleep(1.3)
    stopped.process.send_signal(signal.SIGSTOP)
    readers = [Process("subscriber", address, wire.TOPIC_FRAME_SET, str(SETS + 1)) for _ in range(2)]
    time.sleep(1.5)  # both have the last value
    before_mb = running.rss_mb()
    first = client.status().counters["stream_frameset"] + 1
    begun = time.monotonic()
    client.request("republish", id=item, times=SETS, interval_s=INTERVAL_S)
    seen = [reader.seen() for reader in readers]
    grown_mb = running.rss_mb() - before_mb
    last = first + SETS - 1
    got = [sum(first <= seq <= last for seq, _ in part) for part in seen]
    figure("a subscriber is stopped: sets that two others got", f"{got}", f"{SETS} each", got == [SETS, SETS])
    rates = [rate([(s, t) for s, t in part if s >= first]) for part in seen]
    wanted = 1 / INTERVAL_S
    text = ", ".join(f"{value:.1f}/s" for value in rates)
    figure("their rate", text, f"{wanted:.0f}/s, within 10 %", all(value > 0.9 * wanted for value in rates))
    figure("the daemon grew", f"{grown_mb:.0f} MB in {time.monotonic() - begun:.0f} s", "under 100 MB", grown_mb < 100)
    client.request("republish", id=item, times=40, interval_s=0.1)
    time.sleep(1.0)
    stopped.process.send_signal(signal.SIGCONT)
    resumed = time.monotonic()
    late = stopped.seen()
    after = [(seq, when) for seq, when in late if when >= resumed]
    recent = next((when - resumed for seq, when in after if seq > last), float("inf"))
    seqs = [seq for seq, _ in late]
    missed = seqs[-1] - seqs[0] + 1 - len(seqs)
    final = client.status().counters["stream_frameset"]
    figure("the stopped one, resumed, gets a recent set after", f"{recent:.2f} s", "1 s", recent < 1.0)
    info("it counted as missed", f"{missed} of {seqs[-1] - seqs[0] + 1}; its last is number {seqs[-1]} of {final}")


def main() -> int:
    with station(CONFIG) as running, Station() as client:
        item = str(client.request("import", content=frame_set())["id"])
        client.request("republish", id=item, times=1, interval_s=0.0)
        time.sleep(0.5)
        throughput(running, client, item)
        stopped_subscriber(running, client, item)
    return 0


ROLES: dict[str, Any] = {"subscriber": subscriber, "bare": bare_publisher}

if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] in ROLES:
        ROLES[sys.argv[1]](*sys.argv[2:])
        os._exit(0)
    sys.exit(main())
