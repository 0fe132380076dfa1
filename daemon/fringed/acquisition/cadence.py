"""When a camera's next exposure begins and ends, learned from the frames it delivered.

Owns a prediction, nothing else; a wrong one is harmless because every frame's own times decide.
"""

from __future__ import annotations

import math


class Cadence:
    """The rhythm of one camera: seconds on the rig's clock."""

    def __init__(self, period_s: float, exposure_s: float) -> None:
        self.period_s = max(period_s, 1e-6)
        self.exposure_s = max(exposure_s, 0.0)
        self._nominal_s = self.period_s
        self._first: tuple[int, float] | None = None
        self._last_start_s: float | None = None
        self.readout_s = 0.0

    def note(self, counter: int, start_s: float, end_s: float, delivered_s: float) -> None:
        """Learn from a frame; counters advance from call to call."""
        if self._first is None:
            self._first = (counter, start_s)
        elif counter > self._first[0]:
            measured = (start_s - self._first[1]) / (counter - self._first[0])
            if 0.8 * self._nominal_s <= measured <= 1.25 * self._nominal_s:
                self.period_s = measured
        self._last_start_s = start_s
        self.exposure_s = max(end_s - start_s, 0.0)
        self.readout_s = max(delivered_s - end_s, 0.0) if math.isfinite(delivered_s) else 0.0

    def next_is_missed(self, delay_s: float) -> bool:
        """Return whether who acts on a frame's arrival and then needs `delay_s` misses the next exposure."""
        return self.exposure_s + self.readout_s + delay_s > self.period_s

    @property
    def earliest_trigger_s(self) -> float:
        """When a triggered camera may be triggered again."""
        return -math.inf if self._last_start_s is None else self._last_start_s + self._nominal_s

    def end_of_first_after(self, time_s: float) -> float | None:
        """Return when the first exposure that begins at `time_s` or later ends; None before the first frame."""
        if self._last_start_s is None:
            return None
        periods = max(1, math.ceil((time_s - self._last_start_s) / self.period_s))
        return self._last_start_s + periods * self.period_s + self.exposure_s
