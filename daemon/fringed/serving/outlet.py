"""Sends messages to all subscribers, a few at a time, and holds their buffers until zmq let go of them.

Owns the pace; knows nothing of topics. A subscriber's queue in zmq is short (the high-water mark), so that one
that is stopped costs few sets. So that one that *reads* loses nothing in a burst, at most that many messages are
on their way at once: the next one leaves when zmq is done with an earlier one, or when that took too long. What
a stopped subscriber holds back is waited for just once; zmq drops the rest for it alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import zmq

from fringed.serving.reactor import Reactor

BULK_BYTES = 65536
_LOOK_AGAIN_S = 0.001
_SWEEP_S = 0.25


@dataclass(frozen=True)
class Patience:
    """How long a message on its way may hold back the next one, in seconds."""

    small_s: float = 0.02
    bulk_s: float = 0.25


@dataclass
class _Parcel:
    """One message: built only when it is its turn."""

    frames: Callable[[], list[Any]]
    nbytes: int
    trackers: list[zmq.MessageTracker] = field(default_factory=list)
    give_up_s: float = 0.0

    @property
    def done(self) -> bool:
        """Whether zmq has let go of every part."""
        return all(tracker.done for tracker in self.trackers)


class Outlet:
    """The sending side of one socket."""

    def __init__(self, reactor: Reactor, socket: zmq.Socket[bytes], in_flight: int, patience: Patience) -> None:
        self.dropped = 0
        self.sent = 0
        self._reactor = reactor
        self._socket = socket
        self._limit = in_flight
        self._patience = patience
        self._pending: deque[_Parcel] = deque()
        self._on_way: list[_Parcel] = []
        self._stuck: list[_Parcel] = []
        self._watching = False

    def send(self, frames: Callable[[], list[Any]], nbytes: int, keep: int) -> None:
        """Queue a message; of those of its size class more than `keep` waiting, the oldest is dropped."""
        bulk = nbytes >= BULK_BYTES
        rivals = [parcel for parcel in self._pending if (parcel.nbytes >= BULK_BYTES) == bulk]
        if len(rivals) >= keep:
            self._pending.remove(rivals[0])
            self.dropped += 1
        self._pending.append(_Parcel(frames, nbytes))
        self.pump()

    @property
    def waiting(self) -> int:
        """How many messages have not left yet."""
        return len(self._pending)

    @property
    def idle(self) -> bool:
        """Whether everything has left, apart from what a stopped subscriber holds."""
        return not self._pending and not self._on_way

    @property
    def held_bytes(self) -> int:
        """Bytes of messages that zmq still holds."""
        return sum(parcel.nbytes for parcel in (*self._on_way, *self._stuck) if not parcel.done)

    def pump(self) -> None:
        """Let go of what is done, send what may leave."""
        now = self._reactor.now()
        self._settle(now)
        while self._pending and len(self._on_way) < self._limit:
            parcel = self._pending.popleft()
            bulk = parcel.nbytes >= BULK_BYTES
            parcel.give_up_s = now + (self._patience.bulk_s if bulk else self._patience.small_s)
            self._socket.getsockopt(zmq.EVENTS)  # zmq now takes note of what was read; else it may do so 1 ms too late
            parcel.trackers = send_tracked(self._socket, parcel.frames())
            self._on_way.append(parcel)
            self.sent += 1
        if (self._on_way or self._stuck) and not self._watching:
            self._watching = True
            self._reactor.call_later(_LOOK_AGAIN_S if self._pending or self._on_way else _SWEEP_S, self._look_again)

    def _look_again(self) -> None:
        self._watching = False
        self.pump()

    def _settle(self, now: float) -> None:
        self._stuck = [parcel for parcel in self._stuck if not parcel.done]
        waiting = [parcel for parcel in self._on_way if not parcel.done]
        self._on_way = [parcel for parcel in waiting if parcel.give_up_s > now]
        self._stuck += [parcel for parcel in waiting if parcel.give_up_s <= now]


def send_tracked(socket: zmq.Socket[bytes], frames: Sequence[Any]) -> list[zmq.MessageTracker]:
    """Send one message without copying it; return a tracker for *every* part (pyzmq's own tells of the last only)."""
    trackers = []
    for index, data in enumerate(frames):
        part = zmq.Frame(data, track=True, copy_threshold=0)
        socket.send(part, zmq.SNDMORE if index < len(frames) - 1 else 0, copy=False)
        assert part.tracker is not None
        trackers.append(part.tracker)
    return trackers
