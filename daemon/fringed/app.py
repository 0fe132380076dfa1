"""Builds a station: every object of the daemon is made here, and nowhere else.

Owns the wiring. Nothing runs until `RunningStation.run`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import zmq

from fringed import wire
from fringed.acquisition import AcquisitionRequest, AcquisitionRunner
from fringed.acquisition.adjusting import SettingsRequest
from fringed.assembly import making
from fringed.assembly.adopting import Adopter
from fringed.assembly.life import Parts, RunningStation
from fringed.assembly.loading import make_replay
from fringed.assembly.simulator import Simulator
from fringed.config import StationConfig
from fringed.config.paths import data_dir, runtime_dir
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
from fringed.serving.status import Status
from fringed.serving.stream import Stream
from fringed.serving.verbs_calibration import CalibrationVerbs
from fringed.serving.verbs_devices import DeviceVerbs
from fringed.serving.verbs_patterns import PatternVerbs
from fringed.serving.verbs_records import RecordVerbs
from fringed.serving.verbs_scans import ScanVerbs
from fringed.serving.verbs_station import StationVerbs
from fringed.serving.work import WorkSocket
from fringed.workers.dispatch import Dispatcher
from fringed.workers.jobs import Limits
from fringed.workers.supervisor import Supervisor

Context = zmq.Context[zmq.Socket[bytes]]


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
        at_once, scene = making.without_foreign_scene(config)
        load = partial(making.load_driver_plugins, config)
        devices = build_devices(at_once, load, lambda c: make_replay(c, store))
        adopter = Adopter(store, devices, making.rig_name(config, devices))
        present = Present(config, adopter.read(config))
        context: Context = zmq.Context(io_threads=1)
        undo.callback(context.destroy, linger=0)
        house, parts = _parts(store, lock, devices, present, context)
        simulator = Simulator(house, devices.rig) if devices.rig else None
        rig = making.rig_of(config, devices)
        identity = making.identity_of(config, devices, rig, store.data_dir, config_path)
        station = _station(parts, (rig, identity, simulator, remote), read_config, adopter)
        if simulator is not None and scene is not None:
            simulator.set_first_scene(scene)
        undo.pop_all()
    return station


def _parts(
    store: Store, lock: RuntimeLock, devices: Devices, present: Present, context: Context
) -> tuple[House, dict[str, Any]]:
    """Build everything that knows neither the rig nor who asks."""
    config, reactor = present.config, Reactor()
    sockets = Sockets(context, lock.folder, config.stream.high_water_mark)
    stream = Stream(reactor, sockets.stream, config.stream.high_water_mark)
    records = Records(reactor, partial(stream.publish, topic=wire.TOPIC_EVENT))
    recorder, loader = Recorder(), Recorder(length=1000, name="loader")
    dispatcher = Dispatcher(Limits(config.workers.attempts, config.workers.job_timeout_s))
    supervisor = Supervisor(making.worker_options(lock.folder, config), dispatcher)
    work = WorkSocket(context, dispatcher, (supervisor.tick,))
    house = House(reactor, stream, records, present, store, recorder, loader, work, supervisor)
    link = RigLink(AcquisitionRequest, lambda: devices.projector.size_px, lambda: present.config.camera)
    parts = {
        "house": house, "store": store, "scans": Scans(house, link, making.SOFTWARE), "recorder": recorder,
        "loader": loader, "dispatcher": dispatcher, "supervisor": supervisor, "work": work, "sockets": sockets,
        "lock": lock, "context": context, "link": link,
    }  # fmt: skip
    return house, parts


def _station(
    made: dict[str, Any], rest: Any, read_config: Callable[[], StationConfig], adopter: Adopter
) -> RunningStation:
    """Build what acquires, answers and publishes; bind the sockets last."""
    rig, identity, simulator, remote = rest
    house, scans, link, sockets = made["house"], made["scans"], made.pop("link"), made["sockets"]
    config, leases, gauges = house.present.config, Leases(), making.Gauges()
    status = Status(house, leases, scans, identity, gauges)
    make_station = partial(making.station_of, identity.rig)
    link.runner = runner = AcquisitionRunner(
        rig, make_station(house.present.calibration), RigListener(house, scans, status), made["store"].begin_set,
        config.acquisition, config.checks,
    )  # fmt: skip
    make = (make_station, partial(making.worker_options, made["lock"].folder))
    parts = Parts(**made, status=status, runner=runner)
    running = RunningStation(parts, Notifier(os.environ), read_config, adopter.read, make)
    hello = partial(making.hello, identity, sockets, remote)
    verbs = {
        **StationVerbs(house, leases, hello, status.state, running.reload, simulator).table(),
        **ScanVerbs(house, scans, leases).table(),
        **RecordVerbs(house, making.SOFTWARE).table(),
        **CalibrationVerbs(house, leases, adopter, running.put_in_force).table(),
        **PatternVerbs(house, scans.sequences, link).table(),
        **DeviceVerbs(house, leases, lambda *asked: link.settings(SettingsRequest(*asked))).table(),
    }
    control = Control(house.reactor, sockets.control, verbs)
    gauges.add("control", control.counters)
    gauges.add("work", made["dispatcher"].counters)
    sockets.bind(made["work"].socket, remote)
    return running
