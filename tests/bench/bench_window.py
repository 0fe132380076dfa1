"""The video output under Xvfb: what a pattern costs beyond one frame period, exact levels, lost displays."""

from __future__ import annotations

import os
import signal
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from stationkit import figure, info

sys.path.insert(0, str(Path(__file__).parent.parent))

from fringed.config import validate
from fringed.data import PatternFrame, PatternSequence
from fringed.devices.projector.window import WindowOptions, WindowProjector
from fringed.errors import DeviceAbsent
from fringed.hookspecs import ProjectorTarget
from fringed_plugins.encoders.sinusoidal import MultiFrequencyEncoder
from xvfb import MISSING, Xvfb, available

SIZE = WIDTH, HEIGHT = 1024, 768
ROUNDS = 10
CHANNELS = {"red": (0,), "green": (1,), "blue": (2,), "grey": (0, 1, 2)}


def main() -> None:
    if not available():
        sys.exit(MISSING)
    with tempfile.TemporaryDirectory() as folder:
        measure(Path(folder))


def measure(folder: Path) -> None:
    with Xvfb(folder / "xvfb", SIZE) as cable:
        plug(folder, "connected")
        options = WindowOptions(
            x_display=cable.display, backend="x11", drm_folder=str(folder), connector="card0-HDMI-A-1"
        )
        projector = WindowProjector(options, "bench")
        start = time.monotonic()
        info("window", projector.open())
        info("opened and measured within", f"{time.monotonic() - start:.2f} s")
        try:
            set_up(projector, cable)
            levels(projector, cable)
            losses(projector, folder)
        finally:
            projector.close()


def set_up(projector: WindowProjector, cable: Xvfb) -> None:
    """Time each `show` of a 12-frame set, and compare what is scanned out."""
    assert projector.ready is not None
    sequence = MultiFrequencyEncoder().encode(validate({}, MultiFrequencyEncoder.Params), ProjectorTarget(*SIZE))
    start = time.monotonic()
    projector.load(sequence, "object")
    info(f"{len(sequence.patterns)} patterns loaded within", f"{(time.monotonic() - start) * 1e3:.1f} ms")
    added, answer, exact = [], [], 0
    for _ in range(ROUNDS):
        for index, pattern in enumerate(sequence.patterns):
            asked = time.monotonic()
            flip_s = projector.show(index)
            done = time.monotonic()
            added.append((done - asked - projector.ready.period_s) * 1e3)
            answer.append((done - flip_s) * 1e3)
            exact += np.array_equal(cable.picture(), np.broadcast_to(pattern, (HEIGHT, WIDTH, 3)))
    median, worst = statistics.median(added), max(added)
    period = f"{projector.ready.period_s * 1e3:.2f} ms frame period"
    text = f"median {median:.2f} ms, worst of {len(added)} {worst:.2f} ms, over the {period}"
    figure("set-up time per pattern over the physical minimum", text, "under 5 ms", median < 5)
    info("from the flip to its time in the daemon", f"median {statistics.median(answer):.2f} ms")
    figure("patterns exact on the cable", f"{exact} of {len(added)}", "all", exact == len(added))


def levels(projector: WindowProjector, cable: Xvfb) -> None:
    """Send all levels through each channel, one level on the whole panel at a time."""
    for name, channels in CHANNELS.items():
        patterns = np.zeros((256, 1, 1, 3), np.uint8)
        patterns[..., channels] = np.arange(256)[:, None, None, None]
        frames = tuple(PatternFrame("flat") for _ in patterns)
        projector.load(PatternSequence("flat", *SIZE, frames, tuple(patterns)), "object")
        exact = 0
        for level, pattern in enumerate(patterns):
            projector.show(level)
            exact += bool((cable.picture() == pattern).all())
        figure(f"exact levels, {name}", f"{exact} of 256", "256 of 256", exact == 256)


def losses(projector: WindowProjector, folder: Path) -> None:
    """Kill the display process, and unplug the display (the kernel's list of connectors is a folder of ours)."""
    os.kill(projector.pid, signal.SIGKILL)
    said_s = until_absent(projector)
    figure("display process killed to said", f"{said_s * 1e3:.0f} ms", "under 1 s", said_s < 1)
    projector.open()
    plug(folder, "disconnected")
    said_s = until_absent(projector)
    figure("unplugged to said", f"{said_s * 1e3:.0f} ms", "under 1 s", said_s < 1)
    plug(folder, "connected")
    start = time.monotonic()
    projector.open()
    ready_s = time.monotonic() - start
    figure("plugged again to ready", f"{ready_s:.2f} s", "under 5 s", ready_s < 5)


def until_absent(projector: WindowProjector) -> float:
    """Check every 0.01 s, and return how long it took until the driver said that something has gone."""
    start = time.monotonic()
    while time.monotonic() < start + 60:
        try:
            projector.check()
        except DeviceAbsent:
            return time.monotonic() - start
        time.sleep(0.01)
    return float("inf")


def plug(folder: Path, status: str) -> None:
    path = folder / "card0-HDMI-A-1"
    path.mkdir(exist_ok=True)
    (path / "modes").write_text("1024x768\n")
    (path / "status").write_text(f"{status}\n")


if __name__ == "__main__":
    main()
