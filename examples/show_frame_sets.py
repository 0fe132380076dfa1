"""Subscribe to a station and show each frame set: its figures, and its last frame as a picture; Ctrl-C ends it."""

import contextlib
import sys

import cv2

from fringed_client import Station

count = int(sys.argv[1]) if len(sys.argv) > 1 else None
with contextlib.suppress(KeyboardInterrupt), Station() as station, station.subscribe("frameset", latest=True) as sets:
    for number, message in enumerate(sets, 1):
        frames = message.content
        print(frames.id, frames.role, frames.frames.shape, f"missed {message.missed}", flush=True)
        cv2.imwrite(f"{frames.id}.png", frames.frames[-1])
        if number == count:
            break
