"""Which idle worker is fed a set's frames while it is taken, and whether it keeps up: a pure state machine.

Owns the feeds (decision 12): who gets one, what was sent, what its worker has dealt with, what becomes of it. Every
feed is only a shorter way: whatever goes wrong, it is dropped, and the job takes its whole set along as it would
without. No sockets, no threads, no clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from fringed.data import Array, FrameSet
from fringed.messages import FedSet, FeedBegin, FeedDrop, FeedFrame, FeedLost, FeedTaken, Job, StageCall
from fringed.workers.roster import Roster

BEHIND = 8  # frames that a worker may be behind while the set is taken: it warms up, or hangs
LAST_BEHIND = 3  # and when the job comes: it would wait for them
_FAULTS = 2  # a pipeline that took that many workers down, one after the other, while they were fed is fed no more
_PATIENCE_S = 2.0  # for an answer, before the worker counts as busy


@dataclass(eq=False)
class Feed:
    """One set on its way to one worker. `taken` is -1 until the worker has begun."""

    begin: FeedBegin
    worker: str
    since_s: float
    sent: int = 0
    taken: int = -1
    ended: bool = False  # dropped here, not yet answered there

    @property
    def count(self) -> int:
        """How many frames the set has."""
        return len(self.begin.sequence.frames)

    @property
    def behind(self) -> int:
        """How many frames the worker still has to deal with."""
        return self.sent - max(self.taken, 0)

    @property
    def owed(self) -> bool:
        """Whether the worker has to answer."""
        return self.ended or self.taken < self.sent


class Feeding:
    """Every feed of the station; `send(worker, message)` puts a message into the dispatcher's outbox."""

    def __init__(self, peers: Roster, send: Callable[[str, Any], None], counters: Counter[str]) -> None:
        self._peers = peers
        self._send = send
        self._counters = counters
        self._feeds: dict[str, Feed] = {}
        self._faults: Counter[str] = Counter()

    # What acquisition brings.

    def begin(self, begin: FeedBegin, now: float) -> bool:
        """Feed a set to an idle worker that can do its stages; return whether there is one."""
        if begin.feed in self._feeds or self._faults[_work_of(begin.stages)] >= _FAULTS:
            return False
        worker = self._worker_for(begin)
        if not worker:
            self._counters["sets_unfed"] += 1
            return False
        self._feeds[begin.feed] = Feed(begin, worker, now)
        self._send(worker, begin)
        return True

    def frame(self, feed_id: str, index: int, image: Array, now: float) -> None:
        """Send the next frame; what is not fed (any more) is no matter."""
        feed = self._feeds.get(feed_id)
        if feed is None or feed.ended:
            return
        if index != feed.sent or index >= feed.count:
            self.drop(feed_id, f"frame {index} came where frame {feed.sent} of {feed.count} was due", now)
        elif feed.behind >= BEHIND:
            self.drop(feed_id, f"its worker is {feed.behind} frames behind", now)
        else:
            if not feed.owed:
                feed.since_s = now
            feed.sent += 1
            self._send(feed.worker, FeedFrame(feed_id, index, image))

    def drop(self, feed_id: str, reason: str, now: float) -> None:
        """Have a feed forgotten; harmless for any other."""
        feed = self._feeds.get(feed_id)
        if feed is None or feed.ended:
            return
        if not feed.owed:
            feed.since_s = now
        feed.ended = True
        self._counters["feeds_dropped"] += 1
        self._send(feed.worker, FeedDrop(feed_id, reason))

    # What workers answer.

    def taken(self, worker: str, message: FeedTaken, now: float) -> None:
        """Know how far a worker is."""
        feed = self._feeds.get(message.feed)
        if feed is not None and feed.worker == worker and feed.taken < message.frames <= feed.sent:
            feed.taken, feed.since_s = message.frames, now

    def lost(self, worker: str, message: FeedLost) -> None:
        """Forget a feed that its worker has forgotten, as asked or not."""
        feed = self._feeds.get(message.feed)
        if feed is not None and feed.worker == worker:
            del self._feeds[message.feed]
            self._counters["feeds_refused"] += not feed.ended

    def gone(self, worker: str, blame: bool) -> None:
        """Forget what a lost worker was fed; with `blame`, what it was busy with counts a fault."""
        for feed_id, feed in list(self._of(worker)):
            del self._feeds[feed_id]
            self._faults[_work_of(feed.begin.stages)] += blame and feed.owed

    def late(self, now: float, timeout_s: float) -> list[tuple[str, str]]:
        """Drop feeds that are not answered; return (worker, reason) of those that never do."""
        for feed_id, feed in list(self._feeds.items()):
            if feed.owed and now - feed.since_s > _PATIENCE_S:
                self.drop(feed_id, "its worker does not answer", now)
        return [
            (feed.worker, f"took longer than {timeout_s:g} s over frame {max(feed.taken, 0)} of {feed.begin.role!r}")
            for feed in self._feeds.values()
            if feed.owed and now - feed.since_s > timeout_s
        ]

    def forgive(self) -> None:
        """Feed pipelines again that took workers down: plug-ins may have changed."""
        self._faults.clear()

    # What the dispatcher asks when a job has come.

    def settle(self, job: Job, now: float) -> None:
        """Drop the feeds of a job that its worker has not kept up with."""
        for feed in self._for(job):
            if feed.sent < feed.count or feed.behind > LAST_BEHIND:
                self.drop(feed.begin.feed, f"{feed.behind} frames are left when the job comes", now)

    def rank(self, worker: str, job: Job) -> int:
        """Return how fit a free worker is: 3 has the job's frames, 2 is not fed, 1 is, 0 owes an answer."""
        feeds = [feed for _, feed in self._of(worker)]
        if any(feed.ended for feed in feeds):
            return 0
        if any(feed.worker == worker for feed in self._for(job)):
            return 3
        return 1 if feeds else 2

    def claim(self, job: Job, worker: str, now: float) -> Job:
        """Return the job as `worker` gets it, without the frames that it has; end its other feeds."""
        fed = {feed.begin.feed for feed in self._for(job) if feed.worker == worker}
        for feed_id in fed:
            self._faults.pop(_work_of(self._feeds.pop(feed_id).begin.stages), None)
        for feed_id, _ in list(self._of(worker)):
            self.drop(feed_id, "its worker got another job", now)
        if not fed:
            return job
        self._counters["sets_fed"] += len(fed)
        inputs = {name: _unframed(value) if _id_of(value) in fed else value for name, value in job.inputs.items()}
        return replace(job, inputs=inputs)

    def _for(self, job: Job) -> list[Feed]:
        found = (self._feeds.get(_id_of(value)) for value in job.inputs.values())
        return [feed for feed in found if feed is not None and not feed.ended]

    def _of(self, worker: str) -> Iterator[tuple[str, Feed]]:
        return ((feed_id, feed) for feed_id, feed in self._feeds.items() if feed.worker == worker)

    def _worker_for(self, begin: FeedBegin) -> str:
        """Return who is fed the scan's other sets, or was before a retake, else an idle worker; empty without one."""
        idle = [p.name for p in self._peers.values() if p.takes_feeds and not p.jobs and p.credits > 0]
        able = [name for name in idle if self._peers[name].provides(begin.stages)]
        free = set(able) - {feed.worker for feed in self._feeds.values()}
        same = (feed.worker for feed in self._feeds.values() if feed.begin.scan == begin.scan)
        return next((name for name in same if name in able), "") or next((n for n in able if n in free), "")


def _work_of(stages: Iterable[StageCall]) -> str:
    return " > ".join(f"{stage.kind}/{stage.plugin}" for stage in stages)


def _id_of(value: Any) -> str:
    return value.id if isinstance(value, FrameSet) else ""


def _unframed(frame_set: FrameSet) -> FedSet:
    names = ("id", "role", "scan", "stamps", "settings", "check", "retakes", "provenance")
    return FedSet(**{name: getattr(frame_set, name) for name in names})
