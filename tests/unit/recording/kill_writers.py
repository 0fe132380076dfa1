"""Run writers and kill each at a random moment; a program of its own, so that it forks without threads.

Prints the id of everything that a writer announced.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

import numpy as np
from recordings import frame_set, range_image

from fringed.recording import Store


def write_for_ever(folder: Path, announce: int) -> None:
    """Record sets and products, and tell of each one that is safe."""
    store = Store(folder)
    store.recover()
    while True:
        item = frame_set(60, 300)
        writer = store.begin_set(item.id, item.sequence, (60, 300), np.uint8)
        for index, frame in enumerate(item.frames):
            writer.write(index, frame)
        writer.commit(item)
        os.write(announce, f"{item.id}\n".encode())
        product = range_image(80, 90)
        store.save(product)
        os.write(announce, f"{product.id}\n".encode())


def kill_one(folder: Path, after_s: float) -> str:
    """Return what a writer announced before it was killed, `after_s` after its first announcement."""
    reader, announce = os.pipe()
    child = os.fork()
    if child == 0:
        write_for_ever(folder, announce)
    os.close(announce)
    first = os.read(reader, 4096).decode()
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with os.fdopen(reader, "rb") as rest:
        return first + rest.read().decode()


if __name__ == "__main__":
    rng = random.Random(5)
    for _ in range(int(sys.argv[2])):
        sys.stdout.write(kill_one(Path(sys.argv[1]), rng.uniform(0, 0.03)))
