"""Which worker gets which job, and what becomes of a job whose worker fails: a pure state machine.

Owns credits, time and order; `ledger` what becomes of a job, `feeding` who is fed. Time is passed in, messages to
send pile up in the outbox, workers to end in the list of the condemned: no sockets, no threads, no clock, no
processes.

A job is tried at least once and answered exactly once. A failure that its worker took part in (crash, hang,
memory, an exception that may pass) is tried again, if possible elsewhere, until (subject, pipeline) has failed
`attempts` times in a row; then it is quarantined with its reason. What a plug-in refuses on purpose (`retry`
unset) fails at once and leaves no mark.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from fringed.messages import (
    ErrorInfo,
    FeedLost,
    FeedTaken,
    Job,
    JobCancel,
    JobDone,
    JobFailed,
    JobProgress,
    StageDone,
    StageTaken,
    WorkerAlive,
    WorkerReady,
    WorkerStop,
)
from fringed.workers.feeding import Feeding
from fringed.workers.jobs import Entry, Limits, Watcher
from fringed.workers.ledger import Ledger
from fringed.workers.roster import Peer, Roster

JobMessage = JobProgress | StageDone | JobDone | JobFailed


class Dispatcher:
    """Decide; `received`, `lost`, `submit`, `cancel` and `tick` are its events."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self.counters: Counter[str] = Counter()
        self.peers = Roster()
        self._jobs = Ledger(self.limits.attempts, self.counters)
        self.quarantine = self._jobs.quarantine
        self._outbox: list[tuple[str, Any]] = []
        self._condemned: list[tuple[str, str]] = []
        self.feeding = Feeding(self.peers, lambda *addressed: self._outbox.append(addressed), self.counters)

    def set_limits(self, limits: Limits) -> None:
        """Apply changed limits to whatever comes from now on."""
        self.limits = limits
        self.quarantine.attempts = limits.attempts
        self.feeding.forgive()

    # What others ask.

    def submit(self, job: Job, watcher: Watcher, now: float, timeout_s: float | None = None) -> None:
        """Queue a job.

        Raises
        ------
        Quarantined
            it failed too often before; the message tells the reason and how to allow it again.
        UsageError
            it has no stage, two of one name, or its id is taken.
        """
        self._jobs.add(job, watcher, self.limits.job_timeout_s if timeout_s is None else timeout_s)
        self._assign(now)

    def cancel(self, job: str, now: float) -> bool:
        """Stop a job; return whether it was still on its way. Its `on_failed` tells Cancelled."""
        entry = self._jobs.entries.get(job)
        if entry is None:
            return False
        if not entry.worker:
            self._jobs.finish(entry, ErrorInfo("Cancelled", "cancelled before it began"), False)
        elif self._running(entry):
            self._ask_to_stop(entry, "cancelled", now)
        else:  # waits behind another one: its worker skips it
            entry.stop = "cancelled"
            self._outbox.append((entry.worker, JobCancel(job)))
        return True

    def taken(self, job: str, stage: str) -> None:
        """Tell the job's worker that a stage's product is announced; unknown jobs are no matter."""
        entry = self._jobs.entries.get(job)
        if entry is not None and entry.worker in self.peers:
            self._outbox.append((entry.worker, StageTaken(job, stage)))

    def shutdown(self, reason: str) -> None:
        """Fail everything that is on its way and send all workers home; what they still answer is stray."""
        for peer in self.peers.values():
            peer.jobs.clear()
            peer.capacity = 0
        for entry in list(self._jobs.entries.values()):
            self._jobs.finish(entry, ErrorInfo("Cancelled", reason), False)
        self._outbox = [(name, WorkerStop(reason)) for name in self.peers]

    def take_outbox(self) -> list[tuple[str, Any]]:
        """Return (worker, message) pairs to send, in order, and forget them."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def take_condemned(self) -> list[tuple[str, str]]:
        """Return (worker, reason) pairs of processes to end, and forget them."""
        condemned, self._condemned = self._condemned, []
        return condemned

    @property
    def waiting(self) -> int:
        """How many jobs wait for a worker."""
        return len(self._jobs.queue)

    @property
    def active(self) -> tuple[str, ...]:
        """The ids of all jobs on their way."""
        return tuple(self._jobs.entries)

    # What happens.

    def received(self, worker: str, message: Any, now: float) -> None:
        """Take one message of a worker; anything that does not belong here is counted and answered."""
        peer = self.peers.get(worker)
        if peer is not None:
            peer.heard_s = now
        if isinstance(message, WorkerReady):
            self._ready(worker, message, now)
        elif isinstance(message, (WorkerAlive, JobProgress, StageDone, JobDone, JobFailed, FeedTaken, FeedLost)):
            if peer is None:
                self.counters["stray"] += 1
                self._outbox.append((worker, WorkerStop("this station does not know that worker (any more)")))
            elif isinstance(message, WorkerAlive):
                self._outbox.append((worker, message))  # tells the worker that somebody is there
            elif isinstance(message, FeedTaken):
                self.feeding.taken(worker, message, now)
            elif isinstance(message, FeedLost):
                self._feed_lost(peer, message, now)
            else:
                self._job_message(peer, message, now)
        else:
            kind = type(message).__name__
            allowed = "WorkerReady, WorkerAlive, JobProgress, StageDone, JobDone, JobFailed, FeedTaken, FeedLost"
            self.malformed(worker, f"a {kind} came to the work socket; it takes {allowed}", kind != "ErrorInfo")

    def malformed(self, worker: str, problem: str, answer: bool = True) -> None:
        """Count a message that cannot be meant, and answer it."""
        self.counters["malformed"] += 1
        if answer:
            self._outbox.append((worker, ErrorInfo("WireError", problem)))

    def lost(self, worker: str, reason: str, now: float, blame: bool = True) -> None:
        """Give a gone worker's work to others; with `blame` the job that it was working on counts a failure."""
        peer = self.peers.pop(worker, None)
        if peer is None:
            return
        self.counters["workers_lost"] += 1
        self.feeding.gone(worker, blame and not peer.jobs)
        entries = [self._jobs.entries[job] for job in peer.jobs]
        blamed = 1 if blame else 0
        for entry in reversed(entries[blamed:]):
            self._jobs.requeue(entry, reason)
        for entry in entries[:blamed]:
            if entry.stop == "cancelled":
                self._jobs.finish(entry, ErrorInfo("Cancelled", f"cancelled; its worker {reason}"), False)
            else:
                self._jobs.attempt_failed(entry, ErrorInfo("WorkerLost", f"its worker {reason}"))
        self._assign(now)

    def tick(self, now: float) -> None:
        """Notice silence and overtime."""
        for worker, reason in self.feeding.late(now, self.limits.job_timeout_s):
            if worker in self.peers and not self.peers[worker].jobs:
                self._condemn(self.peers[worker], f"{reason}; killed", now)
        for peer in list(self.peers.values()):
            if now - peer.heard_s > self.limits.silence_s:
                self._condemn(peer, f"was silent for {now - peer.heard_s:.1f} s", now)
                continue
            for job in peer.jobs[:1]:
                self._watch_time(peer, self._jobs.entries[job], now)
        self._assign(now)

    # Inside.

    def _ready(self, worker: str, ready: WorkerReady, now: float) -> None:
        if ready.credits < 1:  # "nothing more for me": it answers what it has and goes
            if worker in self.peers:
                self.peers[worker].capacity = 0
            return
        if worker in self.peers:  # the same name again: a new process, or it forgot
            self.lost(worker, "started anew", now)
        self.peers.join(Peer.of(ready, worker, now))
        self._assign(now)

    def _feed_lost(self, peer: Peer, lost: FeedLost, now: float) -> None:
        self.feeding.lost(peer.name, lost)
        if lost.job in peer.jobs:  # it refers to frames that are not there: no fault of the job
            entry = self._jobs.entries[lost.job]
            self._release(peer, entry, now)
            self._jobs.requeue(entry, "lost the frames that it was fed")
        self._assign(now)

    def _job_message(self, peer: Peer, message: JobMessage, now: float) -> None:
        if message.job not in peer.jobs:
            self.counters["stray"] += 1
            return
        entry = self._jobs.entries[message.job]
        if isinstance(message, JobProgress):
            entry.stage = message.stage or entry.stage
            entry.watcher.on_progress(message)
        elif isinstance(message, StageDone):
            self._jobs.stage_done(entry, message)
        else:
            self._release(peer, entry, now)
            if isinstance(message, JobDone):
                peer.done += 1
                self._jobs.done(entry, message)
            else:
                self._jobs.failed(entry, message)
            self._assign(now)

    def _watch_time(self, peer: Peer, entry: Entry, now: float) -> None:
        if entry.started_s is None:
            entry.started_s = now
        if entry.kill_at_s is None and now - entry.started_s > entry.timeout_s:
            self._ask_to_stop(entry, "overtime", now)
        elif entry.kill_at_s is not None and now >= entry.kill_at_s:
            where = f" in stage {entry.stage}" if entry.stage else ""
            if entry.stop == "overtime":
                reason = f"took longer than {entry.timeout_s:g} s{where} and did not stop when asked; killed"
            else:
                reason = f"did not stop when asked{where}; killed"
            self._condemn(peer, reason, now)

    def _ask_to_stop(self, entry: Entry, why: str, now: float) -> None:
        entry.stop = entry.stop or why
        if entry.kill_at_s is None:
            entry.kill_at_s = now + self.limits.cancel_grace_s
            self._outbox.append((entry.worker, JobCancel(entry.job.id)))

    def _condemn(self, peer: Peer, reason: str, now: float) -> None:
        self._condemned.append((peer.name, reason))
        self._outbox.append((peer.name, WorkerStop(reason)))
        self.lost(peer.name, reason, now)

    def _running(self, entry: Entry) -> bool:
        peer = self.peers.get(entry.worker)
        return peer is not None and peer.jobs[:1] == [entry.job.id]

    def _release(self, peer: Peer, entry: Entry, now: float) -> None:
        peer.jobs.remove(entry.job.id)
        for job in peer.jobs[:1]:
            following = self._jobs.entries[job]
            following.started_s = now
            if following.stop and following.kill_at_s is None:
                following.kill_at_s = now + self.limits.cancel_grace_s

    def _assign(self, now: float) -> None:
        for job in list(self._jobs.queue):
            entry = self._jobs.entries.get(job)
            if entry is None or entry.worker:  # a watcher may have submitted or cancelled meanwhile
                continue
            refused = self.quarantine.refusal(entry.subject, entry.pipeline)
            if refused is not None:
                self._jobs.finish(entry, refused, True)
                continue
            self.feeding.settle(entry.job, now)
            peer = self.peers.choose(entry.job, entry.avoid, self.feeding.rank)
            if peer is not None:
                self._jobs.queue.remove(job)
                self._give(peer, entry, now)

    def _give(self, peer: Peer, entry: Entry, now: float) -> None:
        entry.worker = peer.name
        if not peer.jobs:
            entry.started_s = now
        peer.jobs.append(entry.job.id)
        self._outbox.append((peer.name, self.feeding.claim(entry.job, peer.name, now)))
