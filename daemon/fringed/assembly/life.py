"""The life of a running station: start, serve, reload, stop within five seconds.

Owns the order in which parts start and stop, and what a reload changes. `app` builds the parts.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import msgspec
import zmq

from fringed import logs
from fringed.acquisition import AcquisitionRunner, Station
from fringed.assembly.memory import INTERVAL_S, Trimmer
from fringed.assembly.quarantining import QuarantineKeeper
from fringed.config import StationConfig
from fringed.data import Calibration
from fringed.errors import FringedError
from fringed.messages import Event
from fringed.recording import Recorder, Store
from fringed.sdnotify import Notifier
from fringed.serving.house import House, InForce
from fringed.serving.records import iso_now
from fringed.serving.reload import AT_ONCE, CAMERA_AT_ONCE, changes
from fringed.serving.runtime import RuntimeLock
from fringed.serving.scans import Scans
from fringed.serving.sockets import Sockets
from fringed.serving.status import Status
from fringed.serving.work import WorkSocket
from fringed.workers.dispatch import Dispatcher
from fringed.workers.jobs import Limits
from fringed.workers.supervisor import Supervisor, WorkerOptions

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class Parts:
    """Everything that has to be started and stopped."""

    house: House
    store: Store
    scans: Scans
    status: Status
    runner: AcquisitionRunner
    recorder: Recorder
    loader: Recorder
    dispatcher: Dispatcher
    supervisor: Supervisor
    work: WorkSocket
    sockets: Sockets
    lock: RuntimeLock
    context: zmq.Context[zmq.Socket[bytes]]


class RunningStation:
    """A built station; `run` serves until `stop`."""

    def __init__(
        self,
        parts: Parts,
        notifier: Notifier,
        read_config: Callable[[], StationConfig],
        read_calibration: Callable[[StationConfig], InForce],
        make: tuple[Callable[[Calibration | None], Station], Callable[[StationConfig], WorkerOptions]],
    ) -> None:
        self._parts = parts
        self._notifier = notifier
        self._read_config = read_config
        self._read_calibration = read_calibration
        self._make_station, self._worker_options = make

    @property
    def reactor_post(self) -> Callable[[Callable[[], Any]], None]:
        """How other threads and signal handlers have something done in the loop."""
        return self._parts.house.reactor.post

    def run(self) -> None:
        """Serve until `stop` is called; then stop everything."""
        parts, reactor = self._parts, self._parts.house.reactor
        try:
            parts.recorder.start()
            parts.loader.start()
            parts.runner.start()
            parts.work.attach(reactor)
            parts.status.start()
            reactor.every(0.25, parts.status.watch)
            reactor.every(1.0, parts.scans.sweep)
            reactor.every(1.0, QuarantineKeeper(parts.house, parts.dispatcher.quarantine, parts.store))
            reactor.every(INTERVAL_S, Trimmer(lambda: bool(parts.house.records.running)))
            if self._notifier.watchdog_s:
                reactor.every(self._notifier.watchdog_s / 2, self._notifier.alive)
            self._notifier.ready(self._line())
            _log.info("READY: %s", self._line())
            reactor.run()
        finally:
            self._shut_down()

    def stop(self, reason: str) -> None:
        """Leave the loop; in the reactor's thread or posted to it."""
        _log.info("stopping: %s", reason)
        self._notifier.stopping()
        self._parts.house.reactor.stop()

    def reload(self) -> dict[str, list[str]]:
        """Read the configuration again and apply what can be; a bad one changes nothing.

        Raises
        ------
        ConfigurationError
            it has problems; they are logged too.
        """
        parts, present = self._parts, self._parts.house.present
        try:
            new = self._read_config()
            in_force = self._read_calibration(new)
        except FringedError as error:
            _log.error("the configuration is not reloaded, nothing changes: %s", error)
            raise
        applied, needs_restart = changes(present.config, new)
        present.config = _kept(present.config, new)
        self.put_in_force(in_force)
        if any(path.startswith("workers.") for path in applied):
            self._reload_workers(new)
        parts.sockets.read_clients_again()
        logs.set_up(new.log)
        _log.info("reloaded; applied: %s; needs a restart: %s", applied or "nothing", needs_restart or "nothing")
        parts.house.stream.publish(
            Event("station.reloaded", iso_now(), "info", "", {"applied": applied, "needs_restart": needs_restart}),
            "event",
        )
        return {"applied": applied, "needs_restart": needs_restart}

    def put_in_force(self, found: InForce) -> None:
        """Use a calibration from the next set on: its name in the frames, its tone curve in the patterns."""
        parts, present = self._parts, self._parts.house.present
        present.in_force = found
        parts.runner.reconfigure(
            present.config.acquisition, present.config.checks, self._make_station(found.calibration)
        )
        parts.scans.sequences.clear()
        parts.status.changed()

    def _reload_workers(self, new: StationConfig) -> None:
        """Apply limits; start the workers anew where their options changed."""
        parts = self._parts
        parts.dispatcher.set_limits(Limits(new.workers.attempts, new.workers.job_timeout_s))
        options = self._worker_options(new)
        if options != parts.supervisor.options:
            parts.supervisor.reload(parts.house.reactor.now(), options)

    def reload_quietly(self) -> None:
        """Reload for SIGHUP: problems are logged, and that is all."""
        self._notifier.reloading()
        with suppress(FringedError):
            self.reload()
        self._notifier.ready(self._line())

    def _line(self) -> str:
        identity = self._parts.status.identity
        kind = "SIMULATED " if identity.simulated else "REPLAYED " if identity.replayed else ""
        return f"{kind}station {identity.name!r} serves in {self._parts.sockets.runtime}"

    def _shut_down(self) -> None:
        """Stop everything in an order in which nothing that is announced is lost; about four seconds at worst."""
        parts, house = self._parts, self._parts.house
        parts.supervisor.retire()
        parts.scans.cancel_all("the station stops")
        parts.dispatcher.shutdown("the station stops")
        parts.work.flush()
        stopped = parts.runner.stop(1.2)
        house.reactor.run_until(lambda: house.pending == 0, 0.5)
        if not stopped:
            _log.warning("a device did not stop in time; it is left to its end")
        if not (parts.recorder.stop(1.0) and parts.loader.stop(0.3)):
            _log.warning("the disk did not finish in time; what was not whole is removed at the next start")
        parts.supervisor.stop(0.8)
        house.stream.publish(Event("station.stopped", iso_now(), "info", "the station stops"), "event")
        house.reactor.run_until(lambda: house.stream.outlet.idle, 0.1)
        parts.work.close()
        parts.sockets.close()
        parts.context.term()
        house.reactor.close()
        parts.lock.release()
        self._notifier.close()
        _log.info("stopped")


def _kept(old: StationConfig, new: StationConfig) -> StationConfig:
    """Return the new configuration with what needs a restart as it was."""
    camera = msgspec.structs.replace(old.camera, **{name: getattr(new.camera, name) for name in CAMERA_AT_ONCE})
    return msgspec.structs.replace(old, camera=camera, **{name: getattr(new, name) for name in AT_ONCE})
