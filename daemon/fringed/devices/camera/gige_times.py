"""A GenICam camera's counters and clock: which frame it is, and when it was exposed. Pure; knows no camera."""

from __future__ import annotations

from collections import deque

WINDOW = 32  # frames over which the camera's clock is compared with ours; they may drift apart
_WRAP = 0xFFFF  # GigE Vision 1 counts blocks from 1 to 65535, and then from 1 again [V: Debian's fake camera]


class FrameIds:
    """Make one ascending counter of a camera's block ids, which wrap and begin anew."""

    def __init__(self) -> None:
        self.counter = -1
        self._last: int | None = None

    def restart(self) -> None:
        """Expect ids that begin anew; the counter goes on."""
        self._last = None

    def count(self, frame_id: int) -> int:
        """Return the counter of the frame with that id; the same again for an id that is repeated."""
        self.counter += self._step(frame_id)
        self._last = frame_id
        return self.counter

    def _step(self, frame_id: int) -> int:
        if self._last is None:
            return 1
        step = frame_id - self._last
        if step >= 0:
            return step
        wrapped = step + _WRAP
        if self._last <= _WRAP and 0 < wrapped < _WRAP // 2:
            return wrapped
        return 1  # the camera began to count anew


class CameraTime:
    """Put a camera's time stamps on our clock, by the smallest delay between a stamp and its frame's arrival.

    A stamp may mark any instant of the frame: what is returned is when such a frame begins to arrive if nothing
    holds it up. That is after its exposure, whatever the stamp marks, as long as the exposure does not change.
    """

    def __init__(self) -> None:
        self._offsets: deque[float] = deque(maxlen=WINDOW)

    def restart(self) -> None:
        """Forget the past: the settings have changed."""
        self._offsets.clear()

    def arrival_s(self, stamp_ns: int, arrived_s: float) -> float:
        """Return when the frame would have arrived undisturbed; `arrived_s` itself for a camera without stamps."""
        if stamp_ns <= 0:
            return arrived_s
        stamp_s = stamp_ns * 1e-9
        self._offsets.append(arrived_s - stamp_s)
        return stamp_s + min(self._offsets)
