"""What the dispatcher remembers of a job, and what it promises to whoever submitted it.

Owns the record of one job and how it is named; no sockets, no clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import xxhash

from fringed.data import Calibration
from fringed.messages import ErrorInfo, Job, JobDone, JobProgress, StageDone


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
