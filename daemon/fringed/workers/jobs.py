"""What the dispatcher remembers of a job, of a worker and of failures.

Owns the records and the rules about one of them alone; `dispatch` owns how they meet. No sockets, no clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

import msgspec
import xxhash

from fringed.data import Calibration
from fringed.messages import ErrorInfo, Job, JobDone, JobProgress, PluginInfo, QuarantineEntry, StageDone, WorkerReady


@dataclass(frozen=True)
class Limits:
    """How long and how often."""

    attempts: int = 3
    job_timeout_s: float = 120.0
    cancel_grace_s: float = 2.0
    silence_s: float = 10.0


@dataclass(frozen=True)
class Watcher:
    """Who wants to know about one job. `on_failed` or `on_done` comes exactly once, and last."""

    on_stage: Callable[[StageDone], None]
    on_done: Callable[[JobDone], None]
    on_failed: Callable[[ErrorInfo, bool], None]
    on_progress: Callable[[JobProgress], None] = lambda _: None


@dataclass(eq=False)
class Entry:
    """One job on its way."""

    job: Job
    watcher: Watcher
    subject: str
    pipeline: str
    timeout_s: float
    worker: str = ""
    avoid: str = ""
    started_s: float | None = None
    kill_at_s: float | None = None
    stop: str = ""  # "cancelled" or "overtime" once it was asked to stop
    stage: str = ""
    answered: set[str] = field(default_factory=set)
    delivered: set[str] = field(default_factory=set)

    def again(self) -> None:
        """Prepare for another worker."""
        self.job = replace(self.job, attempt=self.job.attempt + 1)
        self.unassign()

    def unassign(self) -> None:
        """Forget the worker that had it."""
        self.avoid, self.worker, self.stage = self.worker, "", ""
        self.started_s = self.kill_at_s = None
        self.stop = ""
        self.answered = set()

    def missing(self) -> list[str]:
        """Return the stages that have not answered in this attempt."""
        return [stage.name for stage in self.job.stages if stage.name not in self.answered]


@dataclass(eq=False)
class Peer:
    """One worker that said READY. It works on the first of `jobs`."""

    name: str
    pid: int
    capacity: int
    heard_s: float
    plugins: tuple[PluginInfo, ...]
    schemas: Mapping[str, Any]
    jobs: list[str] = field(default_factory=list)
    done: int = 0

    @classmethod
    def of(cls, ready: WorkerReady, name: str, now: float) -> Peer:
        """Return the record of a worker that just said READY."""
        schemas = {kind: table for kind, table in ready.schemas.items() if isinstance(table, Mapping)}
        return cls(name, ready.pid, min(ready.credits, 64), now, ready.plugins, schemas)

    @property
    def credits(self) -> int:
        """How many more jobs it takes."""
        return max(0, self.capacity - len(self.jobs))

    def provides(self, job: Job) -> bool:
        """Tell whether it has every plug-in that the job needs."""
        return all(stage.plugin in self.schemas.get(stage.kind, ()) for stage in job.stages)


class Quarantine:
    """Failures in a row of each (subject, pipeline), and those that are given up."""

    def __init__(self, attempts: int) -> None:
        self.attempts = attempts
        self._failures: dict[tuple[str, str], int] = {}
        self._entries: dict[tuple[str, str], QuarantineEntry] = {}

    @property
    def entries(self) -> tuple[QuarantineEntry, ...]:
        """Everything that is not tried again, oldest first."""
        return tuple(self._entries.values())

    def find(self, subject: str, pipeline: str) -> QuarantineEntry | None:
        """Return why this is not tried again, or None."""
        return self._entries.get((subject, pipeline))

    def failed(self, subject: str, pipeline: str, reason: str) -> QuarantineEntry | None:
        """Count one failure; return the entry when it was one too many."""
        key = (subject, pipeline)
        count = self._failures[key] = self._failures.get(key, 0) + 1
        if count < self.attempts:
            return None
        created = datetime.now(UTC).isoformat(timespec="milliseconds")
        del self._failures[key]
        self._entries[key] = QuarantineEntry(subject, pipeline, reason, count, created)
        return self._entries[key]

    def succeeded(self, subject: str, pipeline: str) -> None:
        """Forget earlier failures: they were not the subject's."""
        self._failures.pop((subject, pipeline), None)

    def clear(self, subject: str = "") -> int:
        """Allow `subject` (empty: everything) again; return how many entries went."""
        keys = [key for key in self._entries if not subject or key[0] == subject]
        for key in keys:
            del self._entries[key]
        for key in [key for key in self._failures if not subject or key[0] == subject]:
            del self._failures[key]
        return len(keys)


def subject_of(job: Job) -> str:
    """Name what a job is about: the ids of its inputs, or the first stage's plug-in and parameters."""
    ids = dict.fromkeys(i for value in job.inputs.values() for i in _ids(value))
    if ids:
        return "+".join(ids)
    first = job.stages[0]
    digest = xxhash.xxh3_64_hexdigest(msgspec.json.encode(dict(first.params), order="deterministic", enc_hook=str))
    return f"{first.kind}/{first.plugin}#{digest[:8]}"


def pipeline_of(job: Job) -> str:
    """Name what is done with a job's subject: its pipeline, or the plug-ins of stages that belong to none."""
    return job.pipeline or " > ".join(f"{stage.kind}/{stage.plugin}" for stage in job.stages)


def _ids(value: Any) -> Iterator[str]:
    if isinstance(value, (list, tuple)):
        for item in value:
            yield from _ids(item)
    elif not isinstance(value, Calibration) and isinstance(getattr(value, "id", None), str) and value.id:
        yield value.id
