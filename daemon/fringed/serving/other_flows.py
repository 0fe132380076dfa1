"""The lives of processing jobs, latency measurements and repeated announcements.

Owns their order; what they share with scans is in `flow`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from fringed import wire
from fringed.data import FrameSet, PatternSequence
from fringed.errors import FringedError, UsageError
from fringed.messages import Event
from fringed.serving.flow import Flow
from fringed.serving.house import House
from fringed.serving.jobs import JobRun
from fringed.serving.plans import Plan
from fringed.serving.ports import Rig
from fringed.serving.records import Record
from fringed.serving.verbs_records import given

_log = logging.getLogger(__name__)
_PACE_S = 0.001
_AT_ONCE = 64  # announcements before others have their turn; without a subscriber nothing else would stop them


class ProcessFlow(Flow):
    """Run stages on what is recorded or given."""

    def __init__(self, house: House, record: Record, plan: Plan, inputs: Mapping[str, Any], software: str) -> None:
        super().__init__(house, record)
        self._plan = plan
        self._inputs = inputs
        self._software = software

    def start(self) -> None:
        """Load the inputs that are named by their ids."""
        self.house.records.change(self.record, "processing", 0.0, "loading inputs")
        self.house.load(self._inputs, self._loaded, self.fail)

    def _loaded(self, found: dict[str, Any]) -> None:
        if self.record.finished:
            return
        inputs = {name: self._own(value) for name, value in found.items()}
        calibration = self.house.present.calibration
        if calibration is not None and "calibration" not in inputs and self._wants_calibration():
            inputs["calibration"] = calibration
        self.record.frame_sets.update(
            {name: value.id for name, value in inputs.items() if isinstance(value, FrameSet) and value.id}
        )
        self.job = JobRun(self.house, self.record, self.end)
        self.job.start(self._plan.stages, inputs, self._plan.pipeline)

    def _wants_calibration(self) -> bool:
        return any(stage.kind == "processor" for stage in self._plan.stages)

    def _own(self, value: Any) -> Any:
        """Give a data object that came without an id one, and record it: products name their inputs by id."""
        if isinstance(value, list):
            return [self._own(item) for item in value]
        if getattr(value, "id", None) != "" or isinstance(value, PatternSequence) or not hasattr(value, "provenance"):
            return value
        content = given(value, self._software)
        self.house.record(content, _nothing, self.fail, lambda: not self.record.finished)
        return content


class LatencyFlow(Flow):
    """Measure the delay from display to camera."""

    moves_rig = True

    def __init__(self, house: House, record: Record, rig: Rig) -> None:
        super().__init__(house, record)
        self._rig = rig

    def start(self) -> None:
        """Queue the measurement, unless it was cancelled before it began."""
        if self.record.finished:
            return
        self.house.records.change(self.record, "acquiring", 0.0, "measuring the display-to-camera delay")
        try:
            self._rig.calibrate_latency(self.record.id)
        except FringedError as error:
            self.fail(error)

    def cancel(self) -> None:
        """Stop it."""
        super().cancel()
        self._rig.cancel(self.record.id)

    def acquiring(self, fraction: float, text: str) -> None:
        """Show how far it is."""
        self.house.records.change(self.record, progress=fraction, text=text)

    def told(self, event: Event) -> None:
        """Keep what was measured among the timings."""
        if event.name == "latency.measured":
            for name in ("latency", "uncertainty", "settle"):
                self.record.timings_s[name] = round(float(event.detail[f"{name}_s"]), 6)

    def acquired_all(self) -> None:
        """End: the delay is in force."""
        self.end(None)


class RepublishFlow(Flow):
    """Announce a recorded object again and again."""

    def __init__(self, house: House, record: Record, item: str, plan: tuple[int, float]) -> None:
        super().__init__(house, record)
        self._item = item
        self._times, self._interval_s = plan
        self._done = 0
        self._content: Any = None
        self._encoded: wire.Encoded | None = None
        self._due_s = 0.0

    def start(self) -> None:
        """Load it."""
        self.house.records.change(self.record, "processing", 0.0, "loading")
        self.house.load({"item": self._item}, self._loaded, self.fail)

    def _loaded(self, found: dict[str, Any]) -> None:
        self._content = found["item"]
        if wire.topic_of(self._content) not in wire.TOPICS:
            self.fail(UsageError(f"{self._item} is a {type(self._content).__name__}, which the stream does not carry"))
            return
        self._encoded = wire.prepare(self._content)
        self._due_s = self.house.reactor.now()
        self._next()

    def _next(self) -> None:
        """Announce when it is time and the socket has room for it, and come back."""
        now = self.house.reactor.now()
        for _ in range(_AT_ONCE):
            if self.record.finished or now < self._due_s or self.house.stream.outlet.waiting:
                break
            self.house.stream.publish(self._content, encoded=self._encoded)
            self._done += 1
            self._due_s = max(self._due_s + self._interval_s, now - self._interval_s)
            self.house.records.change(self.record, progress=self._done / self._times, text=f"{self._done} times")
            if self._done >= self._times:
                self.end(None)
        if not self.record.finished:
            self.house.reactor.call_later(max(_PACE_S, self._due_s - now), self._next)


def _nothing(_: wire.Encoded) -> None:
    return
