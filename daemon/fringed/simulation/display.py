"""What the projector's panel shows, and when: vertical sync, latency, settling.

Owns the timeline of pictures; knows nothing of what a picture is made of.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

from fringed.config.simulated import ProjectorOptics
from fringed.data import Array
from fringed.simulation.clock import VirtualClock

_KEPT = 8  # switches; older ones have settled long ago
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class Picture:
    """One pattern; two pictures are the same only if they are the same object."""

    pattern: Array


@dataclass(eq=False)
class _Switch:
    """One change of the picture: when its light comes, when it is told to come, and to have settled."""

    light_s: float
    told_s: float
    settled_s: float
    picture: Picture
    seen: bool = False  # a frame of it was delivered, or it is of no interest


class Display:
    """A panel that is told what to show and shows it a little later."""

    def __init__(self, optics: ProjectorOptics, clock: VirtualClock, first: Picture) -> None:
        self._clock = clock
        self._frame_s = 1 / optics.display_hz
        self._latency_s = optics.latency_frames * self._frame_s
        self._settle_s = optics.settle_s
        self._tau_s = optics.settle_s / math.log(1000)
        self._lock = threading.Lock()
        self._first = first
        self._switches = [_Switch(-math.inf, -math.inf, -math.inf, first, seen=True)]

    def show(self, picture: Picture, late_s: float = 0.0) -> float:
        """Hand over a picture, wait for its flip and return the flip's time; light comes `latency_frames` later.

        `late_s` makes the light come later than that, without telling.
        """
        flip_s = (math.floor(self._clock.now() / self._frame_s + 1e-9) + 1) * self._frame_s
        self.appear(picture, flip_s, late_s)
        self._clock.sleep_until(flip_s)
        return flip_s

    def appear(self, picture: Picture, flip_s: float, late_s: float = 0.0) -> None:
        """Know that a picture is handed to the panel at a flip: its light comes `latency_frames` and `late_s` later."""
        light_s = flip_s + self._latency_s
        switch = _Switch(light_s + late_s, light_s, light_s + self._settle_s, picture, seen=picture is self._first)
        with self._lock:
            kept = [old for old in self._switches if old.light_s < switch.light_s]
            self._switches = [*kept, switch][-_KEPT:]

    def is_awaited(self, start_s: float) -> bool:
        """Tell whether somebody waits for a frame that starts then: its picture is told to have settled.

        Of a picture that another one has followed already, as one that is shown ahead does, only the first frame.
        """
        with self._lock:
            at = self._at(start_s)
            switch = self._switches[at]
            return start_s >= switch.settled_s and (at == len(self._switches) - 1 or not switch.seen)

    def delivered(self, start_s: float) -> None:
        """Know that the frame that started then was delivered."""
        with self._lock:
            switch = self._switches[self._at(start_s)]
            switch.seen = switch.seen or start_s >= switch.settled_s

    def previous(self, start_s: float) -> Picture:
        """Return the picture before the one that is told to be there."""
        with self._lock:
            return self._switches[max(0, self._at(start_s) - 1)].picture

    def _at(self, time_s: float) -> int:
        return max((i for i, switch in enumerate(self._switches) if switch.told_s <= time_s), default=0)

    def weights(self, start_s: float, end_s: float) -> list[tuple[float, Picture]]:
        """Return the mean share that each picture has in the light from `start_s` to `end_s`; they add up to 1."""
        with self._lock:
            switches = [(switch.light_s, switch.picture) for switch in self._switches]
        now: dict[Picture, float] = {switches[0][1]: 1.0}
        total: dict[Picture, float] = {}
        for (since_s, picture), following in zip(switches, [*switches[1:], (math.inf, None)], strict=True):
            until_s = following[0]
            a, b = max(start_s, since_s), min(end_s, until_s)
            if b > a:
                left = self._mean_left(a - since_s, b - since_s)
                for shown, share in _moved(now, picture, left).items():
                    total[shown] = total.get(shown, 0.0) + share * (b - a) / (end_s - start_s)
            now = _moved(now, picture, self._left(until_s - since_s))
        return [(share, shown) for shown, share in total.items() if share > _NEGLIGIBLE]

    def _left(self, elapsed_s: float) -> float:
        """Return what is left of the old picture some time after a switch."""
        return math.exp(-elapsed_s / self._tau_s) if self._tau_s > 0 else 0.0

    def _mean_left(self, a_s: float, b_s: float) -> float:
        if self._tau_s <= 0 or math.isinf(a_s):
            return 0.0
        return self._tau_s * (self._left(a_s) - self._left(b_s)) / (b_s - a_s)


def _moved(now: dict[Picture, float], target: Picture, left: float) -> dict[Picture, float]:
    """Return the shares when `left` of the old ones is left and the rest went to `target`."""
    moved = {shown: share * left for shown, share in now.items()}
    moved[target] = moved.get(target, 0.0) + 1 - left
    return moved
