"""Subscribe to a station and show each frame set: its figures, and its last frame as a picture."""

import sys

import cv2

from fringed_client import Station

count = int(sys.argv[1]) if len(sys.argv) > 1 else None
with Station() as station, station.subscribe("frameset", latest=True) as subscription:
    for number, message in enumerate(subscription, 1):
        frames = message.content
        print(frames.id, frames.role, frames.frames.shape, f"missed {message.missed}", flush=True)
        cv2.imwrite(f"{frames.id}.png", frames.frames[-1])
        if number == count:
            break
