"""Keep the local workers alive: start, watch, end, start again with growing pauses.

Owns the local processes; tells the dispatcher of each end and carries out its sentences. Never blocks, except
for `stop`; driven by `tick`, which the reactor calls a few times a second, always in the main thread: the kernel
ends a worker together with the thread that started it.
"""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from fringed.messages import PluginInfo, QuarantineEntry, WorkerState
from fringed.workers.dispatch import Dispatcher
from fringed.workers.process import WorkerProcess

_log = logging.getLogger(__name__)

_FIRST_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 30.0
_GOOD_RUN_S = 60.0
_MEMORY_INTERVAL_S = 0.25
_START_TIMEOUT_S = 60.0
_RELOADED = "was ended to load its plug-ins anew"
_LOAD_CRASHES = 2  # a plug-in that ends its worker that often while it is loaded is left out


@dataclass(frozen=True)
class WorkerOptions:
    """How local workers run; `threads` and `count` as in the configuration."""

    endpoint: str
    count: int = 2
    threads: int = 0
    memory_mb: int = 1800
    folders: Sequence[Path] = ()
    log_level: str = "info"
    warm_up: bool = True
    start_timeout_s: float = _START_TIMEOUT_S
    skip: Mapping[str, str] = field(default_factory=dict)  # plug-ins that are not loaded, with the reason


@dataclass
class _Slot:
    """A place for one worker, with what happened to its predecessors."""

    number: int
    process: WorkerProcess | None = None
    generation: int = 0
    started_s: float = 0.0
    next_start_s: float = 0.0
    pause_s: float = _FIRST_PAUSE_S
    memory_mb: float = 0.0
    detail: str = ""
    warm_up: bool = True
    retired: bool = False


@dataclass
class _Loading:
    """Plug-ins that took workers down while they were loaded."""

    crashes: dict[str, int] = field(default_factory=dict)
    skip: dict[str, str] = field(default_factory=dict)


class Supervisor:
    """Own `options.count` local workers on behalf of `dispatcher`."""

    def __init__(self, options: WorkerOptions, dispatcher: Dispatcher) -> None:
        self.options = options
        self._dispatcher = dispatcher
        self._slots = [_Slot(number + 1, warm_up=options.warm_up) for number in range(options.count)]
        self._loading = _Loading(skip=dict(self.options.skip))
        self._next_memory_s = 0.0
        self._stopped = False

    def tick(self, now: float) -> None:
        """Look at every worker and do what is due; `now` as in `time.monotonic`."""
        if self._stopped:
            return
        self._carry_out_sentences()
        measure = now >= self._next_memory_s
        if measure:
            self._next_memory_s = now + _MEMORY_INTERVAL_S
        self._slots = [slot for slot in self._slots if slot.process is not None or not slot.retired]
        for slot in self._slots:
            if slot.process is None:
                if now >= slot.next_start_s:
                    self._start(slot, now)
            elif slot.process.ended():
                self._bury(slot, slot.process, now)
            else:
                if measure:
                    self._check_memory(slot, slot.process)
                self._check_start(slot, slot.process, now)

    def states(self) -> tuple[WorkerState, ...]:
        """Return how every worker is, remote ones included."""
        local = [self._state(slot) for slot in self._slots]
        names = {state.worker for state in local}
        remote = [
            WorkerState(peer.name, peer.pid, "busy" if peer.jobs else "idle", peer.jobs[0] if peer.jobs else "")
            for peer in self._dispatcher.peers.values()
            if peer.name not in names
        ]
        return (*local, *remote)

    def plugins(self) -> tuple[PluginInfo, ...]:
        """Return what the workers loaded, broken plug-ins included."""
        return self._dispatcher.peers.plugins()

    def schemas(self) -> dict[str, dict[str, Any]]:
        """Return the JSON Schemas of all parameters, by kind and name."""
        return self._dispatcher.peers.schemas()

    def quarantined(self) -> tuple[QuarantineEntry, ...]:
        """Return what is not tried again."""
        return self._dispatcher.quarantine.entries

    def clear_quarantine(self, subject: str = "") -> int:
        """Allow a subject (empty: all) again; return how many entries went."""
        return self._dispatcher.quarantine.clear(subject)

    def reload(self, now: float, options: WorkerOptions | None = None) -> None:
        """Start all workers anew, so that they load changed plug-ins; what they work on is done again."""
        self.options = options or self.options
        self._loading = _Loading(skip=dict(self.options.skip))
        numbers = {slot.number for slot in self._slots}
        self._slots += [_Slot(number) for number in range(1, self.options.count + 1) if number not in numbers]
        for slot in self._slots:
            slot.pause_s, slot.next_start_s, slot.warm_up = _FIRST_PAUSE_S, now, self.options.warm_up
            slot.retired = slot.number > self.options.count
            if slot.process is not None:
                slot.process.kill(_RELOADED)

    def retire(self) -> None:
        """Start no worker any more: those that were sent home are not missed."""
        self._stopped = True

    def stop(self, timeout_s: float = 2.0) -> None:
        """End all workers: ask, then kill; returns within `timeout_s` and a little."""
        self.retire()
        processes = [slot.process for slot in self._slots if slot.process is not None]
        for process in processes:
            process.signal(signal.SIGTERM)
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s and not all(process.ended() for process in processes):
            time.sleep(0.01)
        for process in processes:
            process.kill("the station stops")
            process.reap()
        for slot in self._slots:
            slot.process = None

    def _carry_out_sentences(self) -> None:
        for name, reason in self._dispatcher.take_condemned():
            for slot in self._slots:
                if slot.process is not None and slot.process.name == name:
                    slot.process.kill(reason)

    def _start(self, slot: _Slot, now: float) -> None:
        options = self.options
        slot.generation += 1
        arguments = ["--endpoint", options.endpoint, "--threads", str(options.threads)]
        arguments += ["--memory-mb", str(options.memory_mb), "--log-level", options.log_level]
        arguments += [part for folder in options.folders for part in ("--plugin-folder", str(folder))]
        if not slot.warm_up:
            arguments.append("--no-warm-up")
        try:
            slot.process = WorkerProcess(f"worker-{slot.number}.{slot.generation}", arguments, self._loading.skip)
        except OSError as error:
            self._pause(slot, f"cannot be started: {error}", now)
            return
        slot.started_s = now

    def _bury(self, slot: _Slot, process: WorkerProcess, now: float) -> None:
        doing = process.doing
        reason = process.reap()
        slot.process, slot.memory_mb = None, 0.0
        if doing.startswith("loading plug-in "):
            self._blame_plugin(doing.removeprefix("loading plug-in "), reason)
        elif doing.startswith("warming up "):
            slot.warm_up = False
        peer = self._dispatcher.peers.get(process.name)
        if now - slot.started_s > _GOOD_RUN_S or (peer is not None and peer.done):
            slot.pause_s = _FIRST_PAUSE_S  # it was of use: what ended it is one job's fault, not the worker's
        self._pause(slot, reason, now)
        self._dispatcher.lost(process.name, reason, now, blame=reason != _RELOADED)

    def _blame_plugin(self, plugin: str, reason: str) -> None:
        crashes = self._loading.crashes
        crashes[plugin] = crashes.get(plugin, 0) + 1
        if crashes[plugin] >= _LOAD_CRASHES:
            self._loading.skip[plugin] = f"its worker {reason}, {crashes[plugin]} times"
            _log.error("plug-in %s is left out: %s", plugin, self._loading.skip[plugin])

    def _pause(self, slot: _Slot, reason: str, now: float) -> None:
        slot.detail = reason
        slot.next_start_s = now + slot.pause_s
        _log.warning("worker-%d %s; the next one starts in %.1f s", slot.number, reason, slot.pause_s)
        slot.pause_s = min(slot.pause_s * 2, _LONGEST_PAUSE_S)

    def _check_memory(self, slot: _Slot, process: WorkerProcess) -> None:
        slot.memory_mb = process.memory_mb()
        limit_mb = self.options.memory_mb
        if slot.memory_mb > limit_mb * 1.05:  # a little over, it leaves by itself after the job
            doing = f" in {process.doing}" if process.doing else ""
            process.kill(f"grew to {slot.memory_mb:.0f} MB{doing}, over the {limit_mb} MB of workers.memory_mb; killed")

    def _check_start(self, slot: _Slot, process: WorkerProcess, now: float) -> None:
        starting = process.name not in self._dispatcher.peers and not process.reason
        if starting and now - slot.started_s > self.options.start_timeout_s:
            doing = f" while {process.doing}" if process.doing else ""
            process.kill(f"was not ready after {self.options.start_timeout_s:g} s{doing}; killed")

    def _state(self, slot: _Slot) -> WorkerState:
        name = f"worker-{slot.number}"
        restarts = max(0, slot.generation - 1)
        if slot.process is None:
            return WorkerState(name, 0, "restarting", restarts=restarts, detail=slot.detail)
        peer = self._dispatcher.peers.get(slot.process.name)
        state: Literal["starting", "idle", "busy"] = "starting" if peer is None else "busy" if peer.jobs else "idle"
        job = peer.jobs[0] if peer and peer.jobs else ""
        return WorkerState(slot.process.name, slot.process.pid, state, job, restarts, slot.memory_mb, slot.detail)
