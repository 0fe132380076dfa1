"""How one scan or job stands, and who waits for news of it.

Owns the mutable record behind `ScanState`, the waiters, and how long finished ones are remembered.
"""

from __future__ import annotations

import logging
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

from fringed.data import new_id
from fringed.errors import NotFound
from fringed.messages import ErrorInfo, Event, ScanState
from fringed.serving.reactor import Reactor, Timer
from fringed.serving.requests import LATER, Call

_log = logging.getLogger(__name__)
StateName = Literal["queued", "encoding", "acquiring", "processing", "done", "failed", "cancelled"]
FINISHED = frozenset({"done", "failed", "cancelled"})
KEPT = 500
KEPT_S = 3600.0
_EVENT_INTERVAL_S = 0.1


@dataclass(eq=False)
class Record:
    """One scan, processing job, latency measurement or repetition."""

    id: str
    pipeline: str
    state: StateName = "queued"
    progress: float = 0.0
    text: str = ""
    frame_sets: dict[str, str] = field(default_factory=dict)
    products: list[Mapping[str, Any]] = field(default_factory=list)
    timings_s: dict[str, float] = field(default_factory=dict)
    retakes: int = 0
    error: ErrorInfo | None = None
    warnings: list[str] = field(default_factory=list)
    last_frame_s: float | None = None
    finished_s: float | None = None
    event_s: float = float("-inf")

    @property
    def finished(self) -> bool:
        """Whether nothing more will change."""
        return self.state in FINISHED

    def snapshot(self) -> ScanState:
        """Return how it is now."""
        return ScanState(
            self.id, self.state, self.pipeline, round(self.progress, 4), self.text, dict(self.frame_sets),
            tuple(self.products), dict(self.timings_s), self.retakes, self.error,
            tuple(self.warnings),
        )  # fmt: skip


@dataclass(eq=False)
class _Waiter:
    call: Call
    seen: tuple[str, float, int]
    timer: Timer


def _seen(state: Record) -> tuple[str, float, int]:
    return state.state, round(state.progress, 4), len(state.products)


class Records:
    """All scans that run or ended lately."""

    def __init__(self, reactor: Reactor, publish: Callable[[Event], Any]) -> None:
        self.counters: Counter[str] = Counter()
        self._reactor = reactor
        self._publish = publish
        self._records: OrderedDict[str, Record] = OrderedDict()
        self._waiters: dict[str, list[_Waiter]] = {}

    def new(self, pipeline: str) -> Record:
        """Begin one."""
        self._forget_old()
        record = Record(new_id(), pipeline)
        self._records[record.id] = record
        self._event(record, "scan.queued")
        return record

    def get(self, record_id: str) -> Record:
        """Return one; raises NotFound."""
        if record_id not in self._records:
            raise NotFound(
                f"no scan or job {record_id[:80]!r} is remembered; the station keeps those of the last hour, at most "
                f"{KEPT}; what they recorded is listed by `fringe list`"
            )
        return self._records[record_id]

    @property
    def running(self) -> list[Record]:
        """Those that have not ended, oldest first."""
        return [record for record in self._records.values() if not record.finished]

    def change(self, record: Record, state: StateName | None = None, progress: float = -1.0, text: str = "") -> None:
        """Change how it stands, and tell everybody; what has ended does not change any more."""
        if record.finished:
            return
        moved = state is not None and state != record.state
        record.state = state or record.state
        record.progress = max(record.progress, min(progress, 1.0))
        record.text = text or record.text
        now = self._reactor.now()
        if state in FINISHED:
            record.finished_s = now
            record.progress = 1.0 if state == "done" else record.progress
            self.counters[f"scans_{state}"] += 1
        if moved or now - record.event_s >= _EVENT_INTERVAL_S:
            self._event(record, f"scan.{record.state}" if moved else "scan.progress")
        self.touch(record)

    def fail(self, record: Record, error: ErrorInfo) -> None:
        """End it with an error; `Cancelled` is an end of its own."""
        if record.finished:
            return
        record.error = error
        self.change(record, "cancelled" if error.code == "Cancelled" else "failed", text=error.message)

    def touch(self, record: Record) -> None:
        """Answer those who waited for any change."""
        waiters = self._waiters.get(record.id, [])
        due = [waiter for waiter in waiters if record.finished or waiter.seen != _seen(record)]
        if due:
            self._waiters[record.id] = [waiter for waiter in waiters if waiter not in due]
            for waiter in due:
                waiter.timer.cancel()
                waiter.call.reply(record.snapshot())
        if not self._waiters.get(record.id):
            self._waiters.pop(record.id, None)

    def wait(self, record: Record, call: Call, timeout_s: float, seen: Mapping[str, Any] | None) -> Any:
        """Answer when the record differs from what was seen, or time is over."""
        now = _seen(record)
        if seen is not None:
            known = (seen.get("state", now[0]), seen.get("progress", now[1]), seen.get("products", now[2]))
        else:
            known = now
        if record.finished or known != now:
            return record.snapshot()

        def over() -> None:
            self._waiters[record.id] = [w for w in self._waiters.get(record.id, []) if w is not waiter]
            if not self._waiters[record.id]:
                del self._waiters[record.id]
            call.reply(record.snapshot())

        waiter = _Waiter(call, now, self._reactor.call_later(timeout_s, over))
        self._waiters.setdefault(record.id, []).append(waiter)
        return LATER

    def _event(self, record: Record, name: str) -> None:
        record.event_s = self._reactor.now()
        level: Literal["info", "warning"] = "warning" if record.state == "failed" else "info"
        if name != "scan.progress":
            _log.log(
                logging.WARNING if level == "warning" else logging.INFO,
                "%s %s", name, record.id, extra={"scan": record.id, "detail": record.text},
            )  # fmt: skip
        detail = {
            "id": record.id, "state": record.state, "pipeline": record.pipeline, "progress": round(record.progress, 4),
            "products": [str(product["id"]) for product in record.products],
        }  # fmt: skip
        if record.error is not None:
            detail["error"] = record.error.code
        self._publish(Event(name, iso_now(), level, record.text, detail))

    def _forget_old(self) -> None:
        now = self._reactor.now()
        ended = [record for record in self._records.values() if record.finished_s is not None]
        old = [record for record in ended if now - (record.finished_s or now) > KEPT_S]
        for record in {r.id: r for r in (*old, *ended[: max(0, len(ended) - KEPT)])}.values():
            del self._records[record.id]


def iso_now() -> str:
    """Return the time for events and provenance."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
