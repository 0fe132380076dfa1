"""The worker: load plug-ins, ask for work, run one job at a time, answer.

Owns the life of one worker process. It never answers for a job that it was not given, sends the last stage's
product first (that is the one people wait for), and leaves when its station is gone.
"""

from __future__ import annotations

import logging
import os
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fringed.errors import Cancelled, DataError, FringedError, PluginError
from fringed.loading import Catalogue, load_plugins
from fringed.messages import (
    ErrorInfo,
    FedSet,
    FeedBegin,
    FeedFrame,
    FeedLost,
    FeedTaken,
    Job,
    JobDone,
    JobFailed,
    JobProgress,
    StageDone,
    WorkerReady,
)
from fringed.workers.context import JobContext
from fringed.workers.describe import schemas_of
from fringed.workers.intake import Intake
from fringed.workers.link import FeedMessage, Link
from fringed.workers.memory import resident_mb
from fringed.workers.resolve import Pool
from fringed.workers.stages import Early, run_stage

_TRACE_LINES = 12
_TAKEN_S = 1.0  # how long other products wait for the last one to be announced
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class HostOptions:
    """How one worker runs. `skip` maps plug-ins that are not to be loaded to the reason."""

    name: str
    threads: int = 1
    memory_mb: int = 1800
    folders: tuple[Path, ...] = ()
    skip: Mapping[str, str] = field(default_factory=dict)
    warm_up: bool = True
    feeds: bool = False  # take frames while they arrive


class Host:
    """Run jobs that come over `link`; `note` writes what it is doing where its end does not wipe it out."""

    def __init__(self, options: HostOptions, link: Link, note: Callable[[str], None] = lambda _: None) -> None:
        self._options = options
        self._link = link
        self._note = note
        self._catalogue = Catalogue()
        self._intake = Intake(self._catalogue, options.threads, note)
        self._leaving = False

    def run(self) -> None:
        """Serve until the station says stop."""
        self._catalogue = load_plugins(
            self._options.folders, skip=self._options.skip, before=lambda name: self._note(f"loading plug-in {name}")
        )
        self._intake = Intake(self._catalogue, self._options.threads, self._note)
        self._note("")
        plugins = tuple(self._catalogue.plugins)
        schemas = schemas_of(self._catalogue)
        self._link.send(WorkerReady(self._options.name, os.getpid(), 1, plugins, schemas, self._options.feeds))
        cold = self._cold() if self._options.warm_up else []
        while not (self._leaving or self._link.stopping):
            work = self._link.next_work(timeout_s=0.0 if cold else None)
            if isinstance(work, Job):
                self._work(work)
            elif work is not None:
                self._feed(work)
            elif cold and not self._link.stopping:
                self._warm_up(cold.pop(0))
        if self._leaving:
            self._note("leaving to give leaked memory back")
        self._link.close()

    def _cold(self) -> list[Any]:
        """Return the classes that want to be warmed up before their first run."""
        provided = (item for kind in self._catalogue.provided.values() for item in kind.values())
        return [item for item in provided if callable(getattr(item, "warm_up", None))]

    def _warm_up(self, cls: Any) -> None:
        self._note(f"warming up {cls.name}")
        begun_s = time.perf_counter()
        try:
            cls.warm_up()
        except Exception:  # noqa: BLE001  a plug-in call; it is only a slower first run
            _log.warning("warming up %s failed", cls.name, exc_info=True)
        _log.debug("warmed up %s in %.2f s", cls.name, time.perf_counter() - begun_s)
        self._note("")

    def _feed(self, message: FeedMessage) -> None:
        """Take what comes of a set before its job; a feed that makes no sense is forgotten, the job comes whole."""
        try:
            if isinstance(message, FeedBegin):
                self._intake.begin(message)
                answer: FeedTaken | FeedLost = FeedTaken(message.feed, 0)
            elif isinstance(message, FeedFrame):
                answer = FeedTaken(message.feed, self._intake.add(message))
            else:
                self._intake.drop(message.feed)
                answer = FeedLost(message.feed, message.reason)
        except (DataError, MemoryError) as error:
            self._intake.drop(message.feed)
            answer = FeedLost(message.feed, str(error))
        self._link.send(answer)

    def _inputs(self, job: Job) -> tuple[dict[str, Any], dict[str, Early]] | None:
        """Return the job's inputs, fed ones in their places, and the stages that have begun; None where one is lost."""
        inputs, early = dict(job.inputs), {}
        for name, value in job.inputs.items():
            if isinstance(value, FedSet):
                try:
                    inputs[name], begun = self._intake.claim(value)
                except DataError as error:
                    self._link.send(FeedLost(value.id, error.message, job.id))
                    return None
                early.update(begun)
        return inputs, early

    def _work(self, job: Job) -> None:
        begun_s = time.perf_counter()
        held: list[StageDone] = []
        name = ""
        given = self._inputs(job)
        if given is None:
            return
        inputs, early = given
        try:
            pool = Pool(inputs)
            for index, stage in enumerate(job.stages):
                name = stage.name
                held.append(self._stage(job, index, pool, early.pop(name, None)))
                self._check_memory(name)
            seconds = time.perf_counter() - begun_s
            self._link.send(held.pop())
            if any(done.product is not None for done in held):  # they would compete with the one that is waited for
                self._link.wait_taken(_TAKEN_S)
            self._answer(held, JobDone(job.id, seconds))
        except (Exception, SystemExit) as error:  # noqa: BLE001  a plug-in may raise anything
            self._failed(job, name, error, held)
        finally:
            self._note("")

    def _stage(self, job: Job, index: int, pool: Pool, early: Early | None) -> StageDone:
        stage = job.stages[index]
        self._note(f"stage {stage.name}")
        place = (job.id, stage.name, index, len(job.stages))
        context = JobContext(self._link.send, lambda: self._link.cancelled(job.id), self._options.threads, place)
        context.check_cancelled()
        self._link.send(JobProgress(job.id, index / len(job.stages), stage.name, "info", stage.name))
        begun_s = time.perf_counter()
        product = run_stage(self._catalogue, job, stage, pool, context, early)
        seconds = time.perf_counter() - begun_s
        pool.made[stage.name] = product
        return StageDone(job.id, stage.name, seconds, product if stage.keep else None)

    def _answer(self, held: list[StageDone], end: JobDone | JobFailed) -> None:
        for message in (*held, end):
            self._link.send(message)

    def _check_memory(self, stage: str) -> None:
        used_mb, limit_mb = resident_mb(os.getpid()), self._options.memory_mb
        if used_mb > limit_mb:
            raise PluginError(
                f"its worker holds {used_mb:.0f} MB after stage {stage!r}; workers.memory_mb is {limit_mb}"
            )

    def _failed(self, job: Job, stage: str, error: BaseException, held: list[StageDone]) -> None:
        deliberate = isinstance(error, FringedError) and not isinstance(error, PluginError)
        if not deliberate:
            _log.error("stage %s of job %s: %s: %s", stage, job.id, type(error).__name__, error)
            held = []  # a retry makes them again
        if resident_mb(os.getpid()) > self._options.memory_mb:
            _log.error("leaving: only the process's end gives leaked memory back")
            self._leaving = True
            self._link.send(WorkerReady(self._options.name, os.getpid(), credits=0))
        self._answer(held, JobFailed(job.id, stage, describe_error(error, job, stage), retry=not deliberate))


def describe_error(error: BaseException, job: Job, stage: str) -> ErrorInfo:
    """Return an error as it travels: its class, message, and the last lines of its trace."""
    plugin = next((call.plugin for call in job.stages if call.name == stage), "")
    if isinstance(error, FringedError):
        code, text = type(error).__name__, error.message
    else:
        code, text = PluginError.__name__, f"{plugin} in stage {stage!r} raised {type(error).__name__}: {error}"
    if isinstance(error, Cancelled):
        return ErrorInfo(code, text)
    trace = "".join(traceback.format_exception(error)).rstrip().splitlines()[-_TRACE_LINES:]
    return ErrorInfo(code, text, tuple(trace))
