"""The one clock of a simulated rig.

Owns what time it is; knows nothing of what happens at that time.
"""

from __future__ import annotations

import threading
import time


class VirtualClock:
    """Tell the time of a simulation, in seconds.

    In real time it is the machine's monotonic clock and sleeping takes as long as it says. Otherwise it starts at
    zero, stands still while the machine computes, and jumps ahead when somebody sleeps.
    """

    def __init__(self, real_time: bool) -> None:
        self.real_time = real_time
        self._lock = threading.Lock()
        self._now_s = 0.0

    def now(self) -> float:
        """Return the time in seconds; it never goes back."""
        if self.real_time:
            return time.monotonic()
        with self._lock:
            return self._now_s

    def sleep(self, seconds: float) -> None:
        """Let that much time pass; nothing for zero or less."""
        if seconds <= 0:
            return
        if self.real_time:
            time.sleep(seconds)
            return
        with self._lock:
            self._now_s += seconds

    def sleep_until(self, time_s: float) -> None:
        """Let time pass until `time_s`; nothing when that is over.

        In virtual time the clock then stands exactly there, free of the rounding that adding differences brings.
        """
        if self.real_time:
            while (left_s := time_s - time.monotonic()) > 0:
                time.sleep(left_s)
            return
        with self._lock:
            self._now_s = max(self._now_s, time_s)
