"""The life of a scan: patterns, sets, their recording, the pipeline's job, its products.

Owns the order: processing starts as soon as the last set is there, without waiting for the disk, but nothing
is announced before it is recorded, and the scan is done only when everything is.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from fringed import wire
from fringed.data import Array, FrameSet, PatternSequence, Truth, new_id
from fringed.errors import DataError, FringedError
from fringed.messages import ErrorInfo
from fringed.serving.feeds import ScanFeed
from fringed.serving.flow import Flow
from fringed.serving.house import House
from fringed.serving.jobs import JobRun
from fringed.serving.plans import Plan
from fringed.serving.ports import AcquiredSet, Rig, SetUnderWay
from fringed.serving.records import Record
from fringed.serving.requests import error_info
from fringed.serving.sequences import Sequences

_ENCODED, _ACQUIRED = 0.05, 0.6  # how far a scan is after its parts


class ScanFlow(Flow):
    """One scan."""

    moves_rig = True

    def __init__(self, house: House, record: Record, plan: Plan, rig: Rig, sequences: Sequences) -> None:
        super().__init__(house, record)
        self._plan = plan
        self._rig = rig
        self._sequences = sequences
        self._feed = ScanFeed(house.jobs, plan.stages, plan.roles)
        self._inputs: dict[str, Any] = {}
        self._encoder_job = ""
        self._recording = 0
        self._processed = False
        self._all_taken = not plan.to_take
        self._began_s = self._set_began_s = house.reactor.now()

    def start(self) -> None:
        """Load what was given, else go straight to the patterns."""
        if self._plan.given:
            self.house.load(self._plan.given, self._loaded, self.fail)
        else:
            self._encode()

    def cancel(self) -> None:
        """Stop whatever it is at."""
        state = self.record.state
        super().cancel()
        if state == "encoding":
            self.house.jobs.cancel(self._encoder_job)
        elif state == "acquiring":
            self._rig.cancel(self.record.id)

    def end(self, error: ErrorInfo | None) -> None:
        """End the record, and the feeds that no job has taken."""
        super().end(error)
        self._feed.end("its scan has ended")

    def _loaded(self, found: dict[str, Any]) -> None:
        for role, frame_set in found.items():
            if not isinstance(frame_set, FrameSet):
                kind = type(frame_set).__name__
                self.fail(DataError(f"frame_sets.{role} is the id of a {kind}; expected that of a FrameSet"))
                return
            self._inputs[role] = frame_set
            self.record.frame_sets[role] = frame_set.id
        self._encode()

    def _encode(self) -> None:
        if self.record.finished:
            return
        if not self._plan.to_take or self._plan.encoder is None:
            self._process()
            return
        self.house.records.change(self.record, "encoding", 0.0, "making patterns")
        calibration = self.house.present.calibration
        curve = calibration.tone_curve if calibration else None
        try:
            size_px = self._rig.size_px()
        except FringedError as error:
            self.fail(error)
            return
        self._encoder_job = self._sequences.get(self._plan.encoder, size_px, curve, self._acquire, self.end)

    def _acquire(self, sequence: PatternSequence) -> None:
        if self.record.finished:
            return
        self.record.timings_s["encode"] = round(self.house.reactor.now() - self._began_s, 6)
        self._began_s = self._set_began_s = self.house.reactor.now()
        self.house.records.change(self.record, "acquiring", _ENCODED, "taking sets")
        try:
            self._rig.take(self.record.id, self._plan.to_take, sequence, self._plan.cameras, self._plan.truth)
        except FringedError as error:
            self.fail(error)

    def acquiring(self, fraction: float, text: str) -> None:
        """Show how far the sets are."""
        if self.record.state == "acquiring":
            self.house.records.change(self.record, progress=_ENCODED + (_ACQUIRED - _ENCODED) * fraction, text=text)

    def frame_kept(self, of: SetUnderWay, index: int, image: Array) -> None:
        """Send it on to a worker, so that little is left to do when the set is complete."""
        if not self.record.finished:
            self._feed.frame(of, index, image)

    def set_acquired(self, acquired: AcquiredSet) -> None:
        """Record it, and process as soon as every set is there."""
        frame_set, timings = acquired.frame_set, self.record.timings_s
        if self.record.finished:
            acquired.discard()
            return
        role = frame_set.role
        self._inputs[role] = frame_set
        self.record.last_frame_s = acquired.last_frame_s
        timings[f"acquire/{role}"] = round(acquired.last_frame_s - self._set_began_s, 6)
        timings["check"] = round(timings.get("check", 0.0) + acquired.checked_s - acquired.last_frame_s, 6)
        self._set_began_s = acquired.checked_s
        if all(wanted in self._inputs for wanted in self._plan.roles):
            timings["acquire"] = round(acquired.checked_s - self._began_s, 6)
            self._process()
        self._record_set(acquired)

    def truth_known(self, truth: Truth) -> None:
        """Record the simulator's truth of a set of this scan."""
        role = self._role_of(truth.frame_set)
        if self.record.finished or not role:
            return
        self._recording += 1
        truth = replace(truth, id=truth.id or new_id())
        entry = {"id": truth.id, "kind": "Truth", "stage": "", "role": role}
        self.house.record(truth, partial(self._truth_announced, entry), self._unrecorded, lambda: True)

    def acquired_all(self) -> None:
        """Know that every set, and what the simulator knows of it, is there."""
        self._all_taken = True
        self._maybe_done()

    def _role_of(self, frame_set_id: str) -> str:
        return next((role for role, frame_set in self._inputs.items() if frame_set.id == frame_set_id), "")

    def _record_set(self, acquired: AcquiredSet) -> None:
        self._recording += 1
        began_s = self.house.reactor.now()

        def work() -> wire.Encoded:
            encoded = wire.prepare(acquired.frame_set)
            acquired.commit(encoded)
            return encoded

        announced = partial(self._set_announced, acquired.frame_set, began_s)
        self.house.write(work, acquired.frame_set, announced, self._unrecorded)

    def _set_announced(self, frame_set: FrameSet, began_s: float, _: wire.Encoded) -> None:
        timings = self.record.timings_s
        timings["record"] = round(timings.get("record", 0.0) + self.house.reactor.now() - began_s, 6)
        self.record.frame_sets[frame_set.role] = frame_set.id
        self._recorded_one()

    def _truth_announced(self, entry: dict[str, str], encoded: wire.Encoded) -> None:
        self.announced(entry, encoded)
        self._recorded_one()

    def _recorded_one(self) -> None:
        self._recording -= 1
        self.house.records.touch(self.record)
        self._maybe_done()

    def _unrecorded(self, error: FringedError) -> None:
        self._recording -= 1
        if not self.record.finished:
            self._rig.cancel(self.record.id)
        self.end(error_info(error))

    def _process(self) -> None:
        self.house.records.change(self.record, "processing", _ACQUIRED, "processing")
        inputs = {role: self._inputs[role] for role in self._plan.roles}
        if self.house.present.calibration is not None:
            inputs["calibration"] = self.house.present.calibration
        if not self._plan.stages:  # only the sets were wanted
            self._job_ended(None)
            return
        self.job = JobRun(self.house, self.record, self._job_ended)
        self.job.start(self._plan.stages, inputs, self._plan.pipeline)

    def _job_ended(self, error: ErrorInfo | None) -> None:
        if error is not None:
            self.end(error)
            return
        self._processed = True
        self._maybe_done()

    def _maybe_done(self) -> None:
        if self._processed and self._all_taken and not self._recording:
            self.end(None)
