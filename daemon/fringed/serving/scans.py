"""All scans and jobs of the station: begun by requests, told what acquisition tells, stopped, waited for.

Owns which flow an acquisition's news belong to; the flows own what happens. In the reactor's thread.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from fringed.data import Array, Truth
from fringed.errors import FringedError
from fringed.messages import Event, ScanState
from fringed.serving.flow import Flow
from fringed.serving.house import House
from fringed.serving.other_flows import LatencyFlow, ProcessFlow, RepublishFlow
from fringed.serving.plans import Plan
from fringed.serving.ports import AcquiredSet, Rig, SetUnderWay
from fringed.serving.records import Record
from fringed.serving.requests import error_info
from fringed.serving.scan_flow import ScanFlow
from fringed.serving.schemas import check_stages
from fringed.serving.sequences import Sequences

_log = logging.getLogger(__name__)


class Scans:
    """Begin, find, stop."""

    def __init__(self, house: House, rig: Rig, software: str) -> None:
        self.sequences = Sequences(house.jobs)
        self._house = house
        self._rig = rig
        self._software = software
        self._flows: dict[str, Flow] = {}

    def scan(self, plan: Plan) -> ScanState:
        """Begin a scan; raises NotFound or ConfigurationError for plug-ins or parameters that do not exist."""
        encoder = (plan.encoder,) if plan.encoder and plan.to_take else ()
        check_stages((*encoder, *plan.stages), self._house.hosts.schemas())
        record = self._house.records.new(plan.pipeline)
        return self._begin(ScanFlow(self._house, record, plan, self._rig, self.sequences))

    def process(self, plan: Plan, inputs: Mapping[str, Any]) -> ScanState:
        """Begin a processing job; raises as `scan` does."""
        check_stages(plan.stages, self._house.hosts.schemas())
        record = self._house.records.new(plan.pipeline)
        return self._begin(ProcessFlow(self._house, record, plan, inputs, self._software))

    def latency(self) -> ScanState:
        """Begin a measurement of the delay from display to camera."""
        return self._begin(LatencyFlow(self._house, self._house.records.new("latency"), self._rig))

    def republish(self, item: str, times: int, interval_s: float) -> ScanState:
        """Begin to announce a recording again."""
        record = self._house.records.new("republish")
        return self._begin(RepublishFlow(self._house, record, item, (times, interval_s)))

    def cancel(self, record_id: str) -> ScanState:
        """Stop one; harmless when it has ended."""
        record = self._house.records.get(record_id)
        flow = self._flows.get(record_id)
        if flow is not None and not record.finished:
            flow.cancel()
        return record.snapshot()

    def moves_rig(self, record_id: str) -> bool:
        """Tell whether something that runs needs the rig."""
        flow = self._flows.get(record_id)
        return flow is not None and flow.moves_rig

    def cancel_all(self, reason: str) -> None:
        """Stop everything, because the station stops."""
        for flow in list(self._flows.values()):
            if not flow.record.finished:
                flow.cancel()
                _log.info("%s stopped: %s", flow.record.id, reason)

    def sweep(self) -> None:
        """Forget the flows of what has ended, and with them the sets that they hold."""
        self._flows = {name: flow for name, flow in self._flows.items() if not flow.record.finished}

    @property
    def current(self) -> Record | None:
        """The oldest that runs."""
        running = self._house.records.running
        return running[0] if running else None

    # What acquisition tells.

    def acquiring(self, scan: str, fraction: float, text: str) -> None:
        """Pass on how far the sets of a scan are."""
        flow = self._flows.get(scan)
        if flow is not None:
            flow.acquiring(fraction, text)

    def frame_kept(self, of: SetUnderWay, index: int, image: Array) -> None:
        """Pass on a frame of a set that is being taken."""
        flow = self._flows.get(of.scan)
        if flow is not None:
            flow.frame_kept(of, index, image)

    def set_acquired(self, acquired: AcquiredSet) -> None:
        """Count and pass on a good set."""
        self._house.counters["sets_taken"] += 1
        flow = self._flows.get(acquired.frame_set.scan)
        if flow is None:
            acquired.discard()
        else:
            flow.set_acquired(acquired)

    def frames_discarded(self, count: int) -> None:
        """Count frames that came and were of no use."""
        self._house.counters["frames_discarded"] += count

    def set_retaken(self, scan: str) -> None:
        """Count that a set failed its check, or could not be taken, and is taken again."""
        self._house.counters["sets_retaken"] += 1
        flow = self._flows.get(scan)
        if flow is not None:
            flow.record.retakes += 1
            self._house.records.touch(flow.record)

    def latency_measured(self, latency_s: float, text: str) -> None:
        """Tell the measured delay to who asked for it, or to the scan that needed it first."""
        self._house.counters["latency_measured"] += 1
        for flow in self._flows.values():
            if flow.record.state == "acquiring":
                flow.record.timings_s["latency"] = round(latency_s, 6)
                self._house.records.change(flow.record, text=text)

    def truth_known(self, truth: Truth) -> None:
        """Pass on what a simulated rig knows; the scan whose set it is takes it."""
        for flow in list(self._flows.values()):
            flow.truth_known(truth)

    def told(self, event: Event) -> None:
        """Pass on what the rig says of itself."""
        for flow in list(self._flows.values()):
            flow.told(event)

    def acquired_all(self, scan: str) -> None:
        """Pass on that nothing more is to be taken."""
        flow = self._flows.get(scan)
        if flow is not None:
            flow.acquired_all()

    def acquisition_failed(self, scan: str, error: FringedError) -> None:
        """Count and pass on a failure."""
        info = error_info(error)
        if info.code != "Cancelled":
            self._house.counters["sets_failed"] += 1
        flow = self._flows.get(scan)
        if flow is not None:
            flow.acquisition_failed(info)

    def _begin(self, flow: Flow) -> ScanState:
        self.sweep()
        self._flows[flow.record.id] = flow
        state = flow.record.snapshot()
        self._house.reactor.post(flow.start)  # its answer leaves first: "queued"
        return state
