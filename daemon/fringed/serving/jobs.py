"""One pipeline job of a scan: sent to a worker, its products recorded and announced as they come.

Owns the way from `StageDone` to an announced product; knows nothing of devices.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from fringed import wire
from fringed.data import RECORDED, RangeImage, new_id
from fringed.errors import FringedError
from fringed.messages import ErrorInfo, Event, Job, JobDone, JobProgress, StageCall, StageDone
from fringed.serving.house import House
from fringed.serving.ports import JobWatcher
from fringed.serving.records import Record, iso_now
from fringed.serving.requests import error_info

_log = logging.getLogger(__name__)
_WARNINGS = 20  # of one scan; a plug-in that warns for each pixel tells nobody more


class JobRun:
    """Run stages on inputs for a record; `on_end(None)` once all is announced, `on_end(error)` when it failed."""

    def __init__(self, house: House, record: Record, on_end: Callable[[ErrorInfo | None], None]) -> None:
        self.job = ""
        self._house = house
        self._record = record
        self._on_end = on_end
        self._ended = False
        self._worked = False
        self._recording = 0
        self._progress_from = 0.0

    def start(self, stages: tuple[StageCall, ...], inputs: Mapping[str, Any], pipeline: str) -> None:
        """Send the job; an error that is known at once ends it too."""
        origins = [item.provenance for value in inputs.values() for item in _each(value) if hasattr(item, "provenance")]
        self.job = new_id()
        self._progress_from = self._record.progress
        job = Job(
            self.job, stages, dict(inputs), pipeline, self._record.id,
            simulated=any(origin.simulated for origin in origins), replayed=any(origin.replayed for origin in origins),
        )  # fmt: skip
        watcher = JobWatcher(self._stage, self._done, self._failed, self._progress)
        self._house.counters["jobs"] += 1
        try:
            self._house.jobs.submit(job, watcher)
        except FringedError as error:
            self._end(error_info(error))

    def cancel(self) -> None:
        """Stop it, and listen no more: what a worker still answers is dropped."""
        self._ended = True
        self._house.jobs.cancel(self.job)

    def _progress(self, progress: JobProgress) -> None:
        if progress.fraction >= 0:
            fraction = self._progress_from + (0.98 - self._progress_from) * min(progress.fraction, 1.0)
            self._house.records.change(self._record, progress=fraction, text=progress.text)
        elif progress.level != "debug":
            detail = {"id": self._record.id, "stage": progress.stage}
            if progress.level != "info":
                self._doubted(f"{progress.stage}: {progress.text}")
            self._house.stream.publish(
                Event("plugin.log", iso_now(), progress.level, progress.text, detail), wire.TOPIC_EVENT
            )

    def _doubted(self, text: str) -> None:
        if text not in self._record.warnings and len(self._record.warnings) < _WARNINGS:
            self._record.warnings.append(text)
            _log.warning("%s %s: %s", self._record.pipeline, self._record.id, text)

    def _stage(self, done: StageDone) -> None:
        self._record.timings_s[done.stage] = round(done.seconds, 6)
        if done.product is None or self._ended:
            return
        product: Any = done.product
        if type(product) not in RECORDED or not getattr(product, "id", ""):
            self._end(
                ErrorInfo("PluginError", f"stage {done.stage!r} answered with {type(product).__name__} without id")
            )
            return
        if hasattr(product, "scan") and not product.scan:
            product = replace(product, scan=self._record.id)
        self._recording += 1
        self._house.record(
            product, partial(self._announced, done.stage, product), self._unrecorded, lambda: not self._ended
        )

    def _announced(self, stage: str, product: Any, _: wire.Encoded) -> None:
        self._recording -= 1
        record = self._record
        if isinstance(product, RangeImage) and record.last_frame_s is not None:
            waited = self._house.reactor.now() - record.last_frame_s
            record.timings_s.setdefault("last_frame_to_range_image", round(waited, 6))
        entry = {"id": product.id, "kind": type(product).__name__, "stage": stage, "role": ""}
        record.products.append(entry)
        self._house.jobs.taken(self.job, stage)
        self._house.records.touch(record)
        self._maybe_end()

    def _unrecorded(self, error: FringedError) -> None:
        self._recording -= 1
        if not self._ended:
            self._end(error_info(error))  # first: a job that waits for its retry is told at once to be cancelled
            self._house.jobs.cancel(self.job)

    def _done(self, done: JobDone) -> None:
        self._record.timings_s["job"] = round(done.seconds, 6)
        self._worked = True
        self._maybe_end()

    def _failed(self, error: ErrorInfo, quarantined: bool) -> None:
        if quarantined:
            self._house.counters["quarantined"] += 1
        self._end(error)

    def _maybe_end(self) -> None:
        if self._worked and not self._recording:
            self._end(None)

    def _end(self, error: ErrorInfo | None) -> None:
        if not self._ended:
            self._ended = True
            self._on_end(error)


def _each(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, (list, tuple)) else (value,)
