"""Pattern sequences, encoded by a worker once and remembered.

Owns the cache: one sequence for each encoder, parameters, projector and tone curve.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec

from fringed.data import Array, PatternSequence, new_id
from fringed.errors import FringedError
from fringed.messages import ErrorInfo, Job, JobDone, JobProgress, StageCall, StageDone
from fringed.serving.ports import Jobs, JobWatcher
from fringed.serving.requests import error_info

_log = logging.getLogger(__name__)
KEPT = 16
KEPT_BYTES = 128 * 1024 * 1024  # dithered patterns fill the whole panel
Done = Callable[[PatternSequence], None]
Failed = Callable[[ErrorInfo], None]


class Sequences:
    """Ask workers for patterns."""

    def __init__(self, jobs: Jobs) -> None:
        self._jobs = jobs
        self._known: OrderedDict[bytes, PatternSequence] = OrderedDict()

    def clear(self) -> None:
        """Forget all: plug-ins may have changed."""
        self._known.clear()

    def get(
        self, call: StageCall, size_px: tuple[int, int], tone_curve: Array | None, done: Done, failed: Failed
    ) -> str:
        """Call `done` at once where the sequence is known, else later; return the job's id, empty where none runs."""
        curve = b"" if tone_curve is None else tone_curve.tobytes()
        params = msgspec.json.encode(dict(call.params), order="deterministic", enc_hook=str)
        key = msgspec.json.encode([call.plugin, size_px]) + params + curve
        known = self._known.get(key)
        if known is not None:
            self._known.move_to_end(key)
            done(known)
            return ""
        target: dict[str, Any] = {"width_px": size_px[0], "height_px": size_px[1], "tone_curve": tone_curve}
        job = Job(new_id(), (call,), {"projector": target}, f"encoder {call.plugin}")
        made: list[PatternSequence] = []
        watcher = JobWatcher(
            partial(_stage, made), partial(self._done, key, made, (done, failed)), partial(_failed, failed), _progress
        )
        try:
            self._jobs.submit(job, watcher)
        except FringedError as error:
            failed(error_info(error))
        return job.id

    def _done(self, key: bytes, made: list[PatternSequence], then: tuple[Done, Failed], _: JobDone) -> None:
        done, failed = then
        if not made:
            failed(ErrorInfo("PluginError", "the encoder's worker answered without a pattern sequence"))
            return
        self._known[key] = made[0]
        while len(self._known) > KEPT or (self._bytes() > KEPT_BYTES and len(self._known) > 1):
            self._known.popitem(last=False)
        done(made[0])

    def _bytes(self) -> int:
        return sum(pattern.nbytes for sequence in self._known.values() for pattern in sequence.patterns)


def _stage(made: list[PatternSequence], answer: StageDone) -> None:
    if isinstance(answer.product, PatternSequence):
        made.append(answer.product)


def _failed(failed: Failed, error: ErrorInfo, _: bool) -> None:
    failed(error)


def _progress(progress: JobProgress) -> None:
    if progress.fraction < 0:
        _log.info("encoder: %s", progress.text)
