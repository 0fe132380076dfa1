"""What every scan needs at hand: the loop, the stream, the store's threads, workers, and what is configured now.

Owns the bundle, and the one way in which anything is recorded and announced.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fringed import wire
from fringed.config import StationConfig
from fringed.data import Calibration
from fringed.errors import Cancelled, FringedError, StorageError
from fringed.serving import ports
from fringed.serving.reactor import Reactor
from fringed.serving.records import Records
from fringed.serving.stream import Stream

_log = logging.getLogger(__name__)
Failed = Callable[[FringedError], None]


@dataclass(frozen=True)
class InForce:
    """The calibration that scans use; `origin` says where it comes from, `problem` why it is not the adopted one."""

    calibration: Calibration | None
    origin: str = ""
    problem: str = ""


@dataclass(eq=False)
class Present:
    """What a reload can change."""

    config: StationConfig
    in_force: InForce = field(default_factory=lambda: InForce(None))

    @property
    def calibration(self) -> Calibration | None:
        """The calibration that scans use."""
        return self.in_force.calibration


@dataclass(eq=False)
class House:
    """Everything that scans and verbs share; built by `app`."""

    reactor: Reactor
    stream: Stream
    records: Records
    present: Present
    store: ports.Records
    recorder: ports.Thread
    loader: ports.Thread
    jobs: ports.Jobs
    hosts: ports.Hosts
    counters: Counter[str] = field(default_factory=Counter)
    pending: int = 0
    no_scene: FringedError | None = None  # why a simulated rig has not the scene that was configured

    def record(
        self, product: Any, announced: Callable[[wire.Encoded], None], failed: Failed, wanted: Callable[[], bool]
    ) -> None:
        """Record a product in the recorder's thread, then announce it; `wanted` is asked just before it is written."""
        self.write(partial(self._save, product, wanted), product, announced, failed)

    def write(
        self, work: Callable[[], wire.Encoded], product: Any, announced: Callable[[wire.Encoded], None], failed: Failed
    ) -> None:
        """Have the recorder do `work`, which records `product`; then announce it on the stream."""

        def recorded(encoded: wire.Encoded) -> None:
            self.stream.publish(product, encoded=encoded)
            self.counters["recorded"] += 1
            announced(encoded)

        self.in_thread(self.recorder, work, recorded, failed)

    def in_thread(
        self, thread: ports.Thread, work: Callable[[], Any], done: Callable[[Any], None], failed: Failed
    ) -> None:
        """Do work in a thread and answer in the reactor's; a thread that takes no more answers with its error."""
        self.pending += 1

        def finish(callback: Callable[[Any], None], value: Any) -> None:
            self.pending -= 1
            if isinstance(value, StorageError):
                self.counters["storage_errors"] += 1
                _log.error("%s", value)
            callback(value)

        def post(callback: Callable[[Any], None], value: Any) -> None:
            self.reactor.post(partial(finish, callback, value))

        try:
            thread.submit(work, partial(post, done), partial(post, failed))
        except StorageError as error:
            post(failed, error)

    def load(self, ids: Mapping[str, Any], done: Callable[[dict[str, Any]], None], failed: Failed) -> None:
        """Load recordings: each value of `ids` is an id, a list of ids, or passed on as it is."""
        self.in_thread(self.loader, partial(self._load, ids), done, failed)

    def _save(self, product: Any, wanted: Callable[[], bool]) -> wire.Encoded:
        if not wanted():
            raise Cancelled("not recorded: what it belongs to has failed or was cancelled meanwhile")
        encoded = wire.prepare(product)
        self.store.save(product, encoded=encoded)
        return encoded

    def _load(self, ids: Mapping[str, Any]) -> dict[str, Any]:
        def value_of(value: Any) -> Any:
            if isinstance(value, str):
                return self.store.load(value)
            if isinstance(value, (list, tuple)):
                return [value_of(item) for item in value]
            return value

        return {name: value_of(value) for name, value in ids.items()}
