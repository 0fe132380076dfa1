"""The jobs on their way, which of them wait, and what becomes of each: delivered, tried again or given up.

Owns the entries, their order, and the answer that each watcher gets exactly once; knows no worker. Pure.
"""

from __future__ import annotations

from collections import Counter, deque

from fringed.data import RECORDED
from fringed.errors import Quarantined, UsageError
from fringed.messages import ErrorInfo, Job, JobDone, JobFailed, StageDone
from fringed.workers.jobs import Entry, Watcher, pipeline_of, subject_of
from fringed.workers.quarantine import Quarantine


class Ledger:
    """Every job that was submitted and not answered; those in `queue` wait for a worker."""

    def __init__(self, attempts: int, counters: Counter[str]) -> None:
        self.quarantine = Quarantine(attempts)
        self.counters = counters
        self.entries: dict[str, Entry] = {}
        self.queue: deque[str] = deque()

    def add(self, job: Job, watcher: Watcher, timeout_s: float) -> None:
        """Queue a job; raises Quarantined or UsageError as `Dispatcher.submit` says."""
        names = [stage.name for stage in job.stages]
        if not names or len(set(names)) != len(names) or job.id in self.entries:
            raise UsageError(f"job {job.id!r} has the stages {names}; it needs one or more, each of its own name")
        subject, pipeline = subject_of(job), pipeline_of(job)
        refused = self.quarantine.refusal(subject, pipeline)
        if refused is not None:
            raise Quarantined(refused.message)
        self.entries[job.id] = Entry(job, watcher, subject, pipeline, timeout_s)
        self.queue.append(job.id)

    def stage_done(self, entry: Entry, done: StageDone) -> None:
        """Deliver a stage's product, once."""
        kept = {stage.name: stage.keep for stage in entry.job.stages}
        if done.stage not in kept or kept[done.stage] != isinstance(done.product, RECORDED):
            self.counters["stray"] += 1  # the stage stays unanswered, which fails the attempt when the job ends
            return
        entry.answered.add(done.stage)
        if done.stage not in entry.delivered:  # an earlier attempt may have delivered it before it failed
            entry.delivered.add(done.stage)
            entry.watcher.on_stage(done)

    def done(self, entry: Entry, done: JobDone) -> None:
        """End a job well, if each of its stages has answered."""
        missing = entry.missing()
        if missing:
            self.attempt_failed(entry, ErrorInfo("DataError", f"no answer came from the stages {', '.join(missing)}"))
            return
        self.quarantine.succeeded(entry.subject, entry.pipeline)
        self.counters["jobs_done"] += 1
        self._forget(entry)
        entry.watcher.on_done(done)

    def failed(self, entry: Entry, failed: JobFailed) -> None:
        """Decide whether a job that failed is tried again."""
        error = failed.error
        if entry.stop == "overtime":
            text = f"stage {failed.stage!r} took longer than the {entry.timeout_s:g} s of workers.job_timeout_s"
            self.attempt_failed(entry, ErrorInfo("WorkerLost", text, error.detail))
        elif entry.stop == "cancelled":
            self.finish(entry, ErrorInfo("Cancelled", f"cancelled in stage {failed.stage!r}"), False)
        elif failed.retry:
            self.attempt_failed(entry, error)
        else:
            self.finish(entry, error, False)

    def attempt_failed(self, entry: Entry, error: ErrorInfo) -> None:
        """Try again, elsewhere if possible, or give the job up for good."""
        self.counters["attempts_failed"] += 1
        given_up = self.quarantine.failed(entry.subject, entry.pipeline, error.message)
        if given_up is None:
            self.counters["jobs_retried"] += 1
            entry.again()
            self.queue.appendleft(entry.job.id)
            return
        self.counters["quarantined"] += 1
        refused = self.quarantine.refusal(entry.subject, entry.pipeline)
        assert refused is not None
        detail = (f"{error.code}: {error.message}", *error.detail)
        self.finish(entry, ErrorInfo(refused.code, refused.message, detail), True)

    def requeue(self, entry: Entry, reason: str) -> None:
        """Give it to whoever is free, first of all; nobody is to blame."""
        if entry.stop == "cancelled":
            self.finish(entry, ErrorInfo("Cancelled", f"cancelled; its worker {reason}"), False)
        else:
            entry.unassign()
            self.queue.appendleft(entry.job.id)

    def finish(self, entry: Entry, error: ErrorInfo, quarantined: bool) -> None:
        """End a job with an error."""
        self.counters["jobs_cancelled" if error.code == "Cancelled" else "jobs_failed"] += 1
        self._forget(entry)
        entry.watcher.on_failed(error, quarantined)

    def _forget(self, entry: Entry) -> None:
        self.entries.pop(entry.job.id, None)
        if entry.job.id in self.queue:
            self.queue.remove(entry.job.id)
