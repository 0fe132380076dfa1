"""Builds a station: every object of the daemon is made here, and nowhere else.

Owns the wiring. Nothing runs until `RunningStation.run`.
"""

from __future__ import annotations

import logging
import os
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import zmq

from fringed import __version__, wire
from fringed.acquisition import AcquisitionRequest, AcquisitionRunner, Rig, Station
from fringed.assembly.life import Parts, RunningStation
from fringed.assembly.loading import load_calibration, make_replay
from fringed.assembly.simulator import Simulator
from fringed.config import StationConfig
from fringed.config.paths import data_dir, endpoint, runtime_dir
from fringed.devices.building import Devices, build_devices
from fringed.recording import Recorder, Store
from fringed.sdnotify import Notifier
from fringed.serving.control import Control
from fringed.serving.house import House, Present
from fringed.serving.leases import Leases
from fringed.serving.reactor import Reactor
from fringed.serving.records import Records
from fringed.serving.rig_link import RigLink, RigListener
from fringed.serving.runtime import RuntimeLock
from fringed.serving.scans import Scans
from fringed.serving.sockets import Remote, Sockets
from fringed.serving.status import Identity, Status
from fringed.serving.stream import Stream
from fringed.serving.verbs_records import RecordVerbs
from fringed.serving.verbs_scans import ScanVerbs
from fringed.serving.verbs_station import StationVerbs
from fringed.serving.work import WorkSocket
from fringed.workers.dispatch import Dispatcher
from fringed.workers.jobs import Limits
from fringed.workers.supervisor import Supervisor, WorkerOptions

_log = logging.getLogger(__name__)
SOFTWARE = f"fringed {__version__}"


def build(config: StationConfig, config_path: Path | None, read_config: Callable[[], StationConfig]) -> RunningStation:
    """Build a station and bind its sockets; what was taken is given back when something fails.

    Raises
    ------
    StationBusy
        another daemon serves there.
    StorageError
        the data or runtime folder cannot be used.
    ConfigurationError
        devices, calibration or keys that cannot be had.
    """
    with ExitStack() as undo:
        remote = Remote.of(config.tcp)
        lock = RuntimeLock(runtime_dir(config.runtime_dir).absolute())
        lock.acquire()
        undo.callback(lock.release)
        store = Store(data_dir(config.data_dir).absolute())
        store.recover()
        devices = build_devices(config, partial(_load_plugins, config), lambda c: make_replay(c, store))
        read_calibration = partial(load_calibration, rig=devices.rig)
        present = Present(config, read_calibration(config))
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context(io_threads=1)
        undo.callback(context.destroy, linger=0)
        station = _wire_up(store, lock, devices, present, (context, remote, config_path, read_config, read_calibration))
        undo.pop_all()
    return station


def _wire_up(store: Store, lock: RuntimeLock, devices: Devices, present: Present, rest: Any) -> RunningStation:
    context, remote, config_path, read_config, read_calibration = rest
    config, reactor = present.config, Reactor()
    sockets = Sockets(context, lock.folder, config.stream.high_water_mark)
    stream = Stream(reactor, sockets.stream, config.stream.high_water_mark)
    records = Records(reactor, partial(stream.publish, topic=wire.TOPIC_EVENT))
    recorder, loader = Recorder(), Recorder(length=1000, name="loader")
    limits = Limits(attempts=config.workers.attempts, job_timeout_s=config.workers.job_timeout_s)
    dispatcher = Dispatcher(limits)
    supervisor = Supervisor(_worker_options(config, lock.folder), dispatcher)
    work = WorkSocket(context, dispatcher, (supervisor.tick,))
    house = House(reactor, stream, records, present, store, recorder, loader, work, supervisor)
    link = RigLink(AcquisitionRequest, lambda: devices.projector.size_px, lambda: present.config.camera)
    scans = Scans(house, link, SOFTWARE)
    leases = Leases()
    rig = Rig(devices.camera, devices.projector, config.camera.driver, config.projector.driver, _truth(devices))
    name = devices.rig.identity if devices.rig else config.name
    identity = Identity(
        config.name,
        name,
        rig.simulated,
        rig.replayed,
        str(store.data_dir),
        str(config_path.absolute()) if config_path else "",
    )
    gauges: dict[str, Callable[[], Mapping[str, int]]] = {}
    status = Status(
        house, leases, scans, identity, lambda: {k: v for read in gauges.values() for k, v in read().items()}
    )
    own = Station(name, present.calibration.hash if present.calibration else "", SOFTWARE)
    link.runner = runner = AcquisitionRunner(
        rig, own, RigListener(house, scans, status), store.begin_set, config.acquisition, config.checks
    )
    parts = Parts(
        house, scans, status, runner, recorder, loader, dispatcher, supervisor, work, sockets, lock, context
    )  # fmt: skip
    running = RunningStation(parts, Notifier(os.environ), read_config, read_calibration)
    simulator = Simulator(house, devices.rig) if devices.rig else None
    hello = partial(_hello, identity, sockets, remote)
    verbs = {
        **StationVerbs(house, leases, hello, status.state, running.reload, simulator).table(),
        **ScanVerbs(house, scans, leases).table(),
        **RecordVerbs(house, SOFTWARE).table(),
    }
    control = Control(reactor, sockets.control, verbs)
    gauges["control"] = lambda: _named("control", control.counters)
    gauges["work"] = lambda: _named("work", dispatcher.counters)
    sockets.bind(work.socket, remote)
    return running


def _named(prefix: str, counters: Counter[str]) -> dict[str, int]:
    return {f"{prefix}_{name}": count for name, count in counters.items()}


def _hello(identity: Identity, sockets: Sockets, remote: Remote | None, for_remote: bool) -> dict[str, Any]:
    return {
        "name": identity.name, "version": __version__, "protocol": wire.VERSION, "pid": os.getpid(),
        "simulated": identity.simulated, "replayed": identity.replayed, **sockets.addresses(remote, for_remote),
    }  # fmt: skip


def _worker_options(config: StationConfig, runtime: Path) -> WorkerOptions:
    workers = config.workers
    folders = [Path(folder).expanduser() for folder in workers.plugin_folders]
    return WorkerOptions(
        endpoint(runtime, "work"), workers.count, workers.threads, workers.memory_mb, folders, config.log.level
    )


def _truth(devices: Devices) -> Callable[[str], Any] | None:
    rig = devices.rig
    return None if rig is None else lambda role: rig.truth()


def _load_plugins(config: StationConfig) -> Any:
    from fringed.loading import load_plugins

    return load_plugins([Path(folder).expanduser() for folder in config.workers.plugin_folders])
