"""The pure state machine of one frame set: events in, actions out.

Owns the order of show, wait, trigger, read, keep and discard; knows no clock, thread or device.

A frame belongs to a pattern when its integration began no earlier than the pattern's flip + latency +
settling and ended no later than the next pattern's flip. Where waiting for the frame's arrival would cost
the next exposure, the next pattern is shown ahead: as soon as the exposure is over, while its frame is
still being read out. For a free-running camera that moment is predicted from its cadence, for a triggered
one from the trigger. A prediction that proves wrong costs one more flip, never a wrong frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from fringed.acquisition.actions import (
    Action,
    DeviceFailed,
    Discard,
    Event,
    Failed,
    Finished,
    Flipped,
    FrameArrived,
    Keep,
    Reached,
    ReadFrame,
    Show,
    TimedOut,
    Trigger,
    Triggered,
    WaitUntil,
)
from fringed.acquisition.cadence import Cadence
from fringed.errors import AcquisitionError

MAX_MISSES = 2  # wrong predictions after which the machine stops predicting
FLIP_S = 0.02  # what a display may take from the request to the flip
STALE_FRAMES = 64  # what a driver may have queued from before the flip
TICK_S = 1e-9  # times of one clock that differ by less are the same

_ANSWERS: dict[type[Action], tuple[type[Event], ...]] = {
    Show: (Flipped,),
    WaitUntil: (Reached,),
    Trigger: (Triggered,),
    ReadFrame: (FrameArrived, TimedOut),
}


@dataclass(frozen=True)
class Timing:
    """What the machine knows of the rig's times, all in seconds."""

    latency_s: float
    settle_s: float
    exposure_s: float
    period_s: float
    frame_timeout_s: float = 2.0
    triggered: bool = False
    guard_s: float = 0.001

    @property
    def delay_s(self) -> float:
        """From a flip to settled light."""
        return self.latency_s + self.settle_s


class Sequencer:
    """Take `count` patterns. Call `start` once, then `handle` with the answer to each last action.

    `counters_skipped` maps a pattern to the number of frames that the camera lost while it was awaited.
    """

    def __init__(self, count: int, timing: Timing) -> None:
        if count < 1:
            raise AcquisitionError(f"a sequence of {count} patterns cannot be taken; at least 1 is needed")
        self._count = count
        self._timing = timing
        self._cadence = Cadence(timing.period_s, timing.exposure_s)
        self._pending: Action | None = None
        self._index = 0
        self._flip_s = self._ready_s = 0.0
        self._next_flip_s = math.inf  # finite once the next pattern is shown ahead of the frame's arrival
        self._exposing = False  # triggered, and waiting for the exposure's end
        self._discarded = self._misses = 0
        self._last_counter: int | None = None
        self.counters_skipped: dict[int, int] = {}

    @property
    def done(self) -> bool:
        """Whether the last action was Finished or Failed."""
        return isinstance(self._pending, Finished | Failed)

    def start(self) -> tuple[Action, ...]:
        """Return the first action."""
        if self._pending is not None:
            raise AcquisitionError("this sequence has already begun; make a new sequencer for each set")
        return self._ask(Show(0))

    def handle(self, event: Event) -> tuple[Action, ...]:
        """Return what to do next: at most one Keep or Discard, then one action that wants an answer.

        Raises
        ------
        AcquisitionError
            the event is no answer to the last action.
        """
        if self._pending is None or self.done:
            raise AcquisitionError(f"{type(event).__name__} came, but no set is being taken")
        if isinstance(event, DeviceFailed):
            return self._ask(Failed("device", event.reason))
        if not isinstance(event, _ANSWERS[type(self._pending)]):
            raise AcquisitionError(f"{type(event).__name__} is no answer to {type(self._pending).__name__}")
        handlers: dict[type[Event], Callable[..., tuple[Action, ...]]] = {
            Flipped: self._flipped,
            Reached: self._reached,
            Triggered: self._triggered,
            FrameArrived: self._arrived,
            TimedOut: self._timed_out,
        }
        return handlers[type(event)](event)

    def _ask(self, action: Action, *before: Action) -> tuple[Action, ...]:
        self._pending = action
        return (*before, action)

    def _read(self, *before: Action) -> tuple[Action, ...]:
        return self._ask(ReadFrame(self._timing.frame_timeout_s), *before)

    def _flipped(self, event: Flipped) -> tuple[Action, ...]:
        if not math.isfinite(event.time_s):
            return self._ask(Failed("times", f"the projector confirmed a flip at {event.time_s} s; expected a time"))
        if isinstance(self._pending, Show) and self._pending.index > self._index:
            self._next_flip_s = event.time_s
            return self._read()
        self._begin(event.time_s)
        return self._await_frame()

    def _begin(self, flip_s: float) -> None:
        self._flip_s = flip_s
        self._ready_s = flip_s + self._timing.delay_s
        self._next_flip_s = math.inf
        self._discarded = 0

    @property
    def _may_show_ahead(self) -> bool:
        pays = self._cadence.next_is_missed(self._timing.delay_s + FLIP_S)
        return pays and self._index + 1 < self._count and self._misses < MAX_MISSES

    def _await_frame(self, *before: Action) -> tuple[Action, ...]:
        """Ask for what brings the frame of the pattern that is shown."""
        if self._timing.triggered:
            return self._ask(WaitUntil(max(self._ready_s, self._cadence.earliest_trigger_s)), *before)
        end_s = self._cadence.end_of_first_after(self._ready_s + self._timing.guard_s)
        if end_s is None or not self._may_show_ahead:
            return self._read(*before)
        return self._ask(WaitUntil(end_s + self._timing.guard_s), *before)

    def _reached(self, _: Reached) -> tuple[Action, ...]:
        if self._timing.triggered and not self._exposing:
            return self._ask(Trigger())
        self._exposing = False
        return self._ask(Show(self._index + 1))

    def _triggered(self, event: Triggered) -> tuple[Action, ...]:
        if not math.isfinite(event.time_s) or not self._may_show_ahead:
            return self._read()
        self._exposing = True
        return self._ask(WaitUntil(event.time_s + self._cadence.exposure_s + self._timing.guard_s))

    def _timed_out(self, event: TimedOut) -> tuple[Action, ...]:
        return self._ask(
            Failed(
                "stalled",
                f"no frame came within {event.waited_s:g} s for pattern {self._index} of {self._count}; "
                "check that the camera runs (and its trigger is connected), or raise acquisition.frame_timeout_s",
            )
        )

    def _arrived(self, frame: FrameArrived) -> tuple[Action, ...]:
        reason = self._misfit(frame)
        if reason is None:
            return self._keep(frame)
        self._discarded += 1
        if self._discarded > self._most_discards:
            return self._ask(
                Failed(
                    "times", f"{self._discarded} frames in a row were of no use for pattern {self._index}: {reason}"
                ),
                Discard(reason),
            )
        if frame.exposure_start_s >= self._ready_s and math.isfinite(self._next_flip_s):
            self._misses += 1  # its window is closed: the pattern has to be shown again
            self._note(frame)
            return self._ask(Show(self._index), Discard(reason))
        self._note(frame)
        return self._read(Discard(reason))

    @property
    def _most_discards(self) -> int:
        return STALE_FRAMES + 4 * math.ceil(min(self._timing.delay_s / max(self._timing.period_s, 1e-4), 1e4))

    def _misfit(self, frame: FrameArrived) -> str | None:
        """Return why the frame is not the one of the current pattern, or None."""
        start_s, end_s = frame.exposure_start_s, frame.exposure_end_s
        if not (math.isfinite(start_s) and math.isfinite(end_s) and start_s <= end_s):
            return f"its exposure from {start_s} s to {end_s} s is no window of time"
        if self._last_counter is not None and frame.counter <= self._last_counter:
            return f"its counter {frame.counter} did not advance past {self._last_counter}"
        if start_s < self._ready_s - TICK_S:
            return f"its integration began {(self._ready_s - start_s) * 1e3:.2f} ms before the pattern had settled"
        if end_s > self._next_flip_s + TICK_S:
            return f"its integration ended {(end_s - self._next_flip_s) * 1e3:.2f} ms after the next flip"
        return None

    def _note(self, frame: FrameArrived) -> None:
        """Learn from any frame; count what the camera lost since the first one that could be of use."""
        if not (math.isfinite(frame.exposure_start_s) and math.isfinite(frame.exposure_end_s)):
            return
        if self._last_counter is not None:
            if frame.counter <= self._last_counter:
                return
            skipped = frame.counter - self._last_counter - 1
            usable = frame.exposure_start_s - self._cadence.period_s >= self._ready_s - TICK_S
            if skipped and (self._index > 0 or usable):  # what a driver dropped before the set is no loss
                self.counters_skipped[self._index] = self.counters_skipped.get(self._index, 0) + skipped
        self._last_counter = frame.counter
        self._cadence.note(frame.counter, frame.exposure_start_s, frame.exposure_end_s, frame.delivered_s)

    def _keep(self, frame: FrameArrived) -> tuple[Action, ...]:
        self._note(frame)
        kept = Keep(self._index, self._flip_s)
        self._index += 1
        if self._index == self._count:
            return self._ask(Finished(), kept)
        if not math.isfinite(self._next_flip_s):
            return self._ask(Show(self._index), kept)
        self._begin(self._next_flip_s)
        return self._await_frame(kept)
