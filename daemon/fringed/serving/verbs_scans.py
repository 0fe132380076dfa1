"""Requests about scans and jobs: begin, wait, cancel.

Owns these verbs: they read parameters, ask for leases where the rig moves, and leave the rest to `Scans`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fringed.errors import UsageError
from fringed.serving.house import House
from fringed.serving.leases import Leases
from fringed.serving.plans import ScanWish, plan_process, plan_scan
from fringed.serving.requests import Call, Verb
from fringed.serving.scans import Scans

_REPEATS_MAX = 1_000_000
_RUNNING_MAX = 100


@dataclass
class ScanVerbs:
    """The verbs, on what they need."""

    house: House
    scans: Scans
    leases: Leases

    def table(self) -> dict[str, Verb]:
        """Return the verbs by name."""
        return {
            "scan": self._scan, "process": self._process, "wait": self._wait, "cancel": self._cancel,
            "latency": self._latency, "republish": self._republish,
        }  # fmt: skip

    def _scan(self, call: Call) -> Any:
        call.allow(
            "pipeline", "preset", "roles", "encoder_params", "camera", "role_camera", "stages", "frame_sets", "truth",
            "process",
        )  # fmt: skip
        self._may_move(call)
        wish = ScanWish(
            call.get("pipeline", str, ""),
            call.get("preset", str, ""),
            _texts(call, "roles", call.get("roles", list, None)),
            call.get("encoder_params", dict, {}),
            call.get("camera", dict, {}),
            call.get("role_camera", dict, {}),
            call.get("stages", dict, {}),
            call.get("frame_sets", dict, {}),
            call.get("truth", bool, None),
            call.get("process", bool, True),
        )
        _texts(call, "frame_sets", list(wish.frame_sets.values()))
        plan = plan_scan(self.house.present.config, wish)
        if plan.to_take and self.house.no_scene:
            raise self.house.no_scene
        return self.scans.scan(plan)

    def _process(self, call: Call) -> Any:
        call.allow("pipeline", "stages", "inputs", "params")
        self._room()
        pipeline = call.get("pipeline", str, "")
        stages = call.get("stages", list, None)
        plan = plan_process(self.house.present.config, pipeline, stages, call.get("params", dict, {}))
        return self.scans.process(plan, call.get("inputs", dict, {}))

    def _wait(self, call: Call) -> Any:
        call.allow("id", "timeout_s", "seen")
        record = self.house.records.get(call.get("id", str))
        asked_s = call.within("timeout_s", 0.0, 86400.0)
        left_s = max(0.0, call.deadline_s - self.house.reactor.now() - 0.05)
        return self.house.records.wait(record, call, min(asked_s, left_s), call.get("seen", dict, None))

    def _cancel(self, call: Call) -> Any:
        call.allow("id")
        record_id, now = call.get("id", str), self.house.reactor.now()
        if self.scans.moves_rig(record_id) and self.leases.holder_of("rig", now) is not None:
            self.leases.check(call.request.lease, now)  # a lease that is over does not keep anybody from stopping
        return self.scans.cancel(record_id)

    def _latency(self, call: Call) -> Any:
        call.allow()
        self._may_move(call)
        return self.scans.latency()

    def _republish(self, call: Call) -> Any:
        call.allow("id", "times", "interval_s")
        self._room()
        times = call.get("times", int, 1)
        if not 1 <= times <= _REPEATS_MAX:
            raise UsageError(f"republish: times is {times}; expected 1 to {_REPEATS_MAX}")
        return self.scans.republish(call.get("id", str), times, call.within("interval_s", 0.0, 3600.0, 0.0))

    def _may_move(self, call: Call) -> None:
        self.leases.check(call.request.lease, self.house.reactor.now())
        self._room()

    def _room(self) -> None:
        running = len(self.house.records.running)
        if running >= _RUNNING_MAX:
            raise UsageError(f"{running} scans and jobs wait or run already; wait for some of them, or cancel them")


def _texts(call: Call, name: str, values: Any) -> Any:
    if values is not None and not all(isinstance(value, str) for value in values):
        raise UsageError(f"{call.request.verb}: {name} is {str(values)[:80]}; expected texts")
    return values
