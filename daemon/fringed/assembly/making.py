"""Small objects that `app` needs, made from the configuration and from other objects.

Owns these conversions; decides nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import msgspec

from fringed import __version__, wire
from fringed.acquisition import Rig, Station
from fringed.config import StationConfig
from fringed.config.paths import endpoint
from fringed.data import Calibration
from fringed.devices.building import Devices
from fringed.errors import ConfigurationError, Problem
from fringed.hookspecs import ENTRY_POINT_GROUP
from fringed.loading import Catalogue
from fringed.serving.sockets import Remote, Sockets
from fringed.serving.status import Identity
from fringed.workers.supervisor import WorkerOptions

SOFTWARE = f"fringed {__version__}"


def rig_of(config: StationConfig, devices: Devices) -> Rig:
    """Return the rig as acquisition takes it."""
    simulated = devices.rig
    truth: Callable[[str], Any] | None = None if simulated is None else lambda role: simulated.truth()
    return Rig(devices.camera, devices.projector, config.camera.driver, config.projector.driver, truth)


def identity_of(config: StationConfig, devices: Devices, rig: Rig, data_dir: Path, path: Path | None) -> Identity:
    """Return what does not change while the daemon runs."""
    name = rig_name(config, devices)
    where = str(path.absolute()) if path else ""
    return Identity(config.name, name, rig.simulated, rig.replayed, str(data_dir), where)


def rig_name(config: StationConfig, devices: Devices) -> str:
    """Return how the rig is called in what it makes: a simulated one has a name of its own."""
    return devices.rig.identity if devices.rig else config.name


def station_of(rig: str, calibration: Calibration | None) -> Station:
    """Return who takes the frames."""
    return Station(rig, calibration.hash if calibration else "", SOFTWARE)


def worker_options(runtime: Path, config: StationConfig) -> WorkerOptions:
    """Return how local workers run."""
    workers = config.workers
    folders = [Path(folder).expanduser() for folder in workers.plugin_folders]
    return WorkerOptions(
        endpoint(runtime, "work"), workers.count, workers.threads, workers.memory_mb, folders, config.log.level
    )


def load_driver_plugins(config: StationConfig) -> Catalogue:
    """Load plug-ins, for a device driver that the configuration names and that is none of ours."""
    from fringed.loading import load_plugins

    return load_plugins([Path(folder).expanduser() for folder in config.workers.plugin_folders])


def without_foreign_scene(config: StationConfig) -> tuple[StationConfig, Mapping[str, Any] | None]:
    """Return a configuration that can be built at once, and the scene that a worker's plug-in has to make.

    Raises
    ------
    ConfigurationError
        no plug-in could provide the scene, for there is none but ours.
    """
    if "sim" not in (config.camera.driver, config.projector.driver):
        return config, None
    from fringed.simulation.shapes import OBJECTS

    scene = config.simulation.scene
    if scene.object in OBJECTS:
        return config, None
    if not _foreign_plugins(config):
        allowed = f"one of {', '.join(OBJECTS)}; there is no plug-in that could have another one"
        raise ConfigurationError("1 problem:", (Problem("simulation.scene.object", repr(scene.object), allowed),))
    stand_in = msgspec.structs.replace(scene, object="plane", options={})
    simulation = msgspec.structs.replace(config.simulation, scene=stand_in)
    return msgspec.structs.replace(config, simulation=simulation), msgspec.to_builtins(scene)


def _foreign_plugins(config: StationConfig) -> bool:
    """Tell whether a worker may have plug-ins of others; nothing is loaded."""
    installed = (entry.dist for entry in entry_points(group=ENTRY_POINT_GROUP))
    others = any(dist is None or dist.name != "fringed" for dist in installed)
    return others or bool(config.workers.plugin_folders) or config.tcp is not None


def hello(identity: Identity, sockets: Sockets, remote: Remote | None, for_remote: bool) -> dict[str, Any]:
    """Return what greets a client."""
    return {
        "name": identity.name, "version": __version__, "protocol": wire.VERSION, "pid": os.getpid(),
        "simulated": identity.simulated, "replayed": identity.replayed, **sockets.addresses(remote, for_remote),
    }  # fmt: skip


class Gauges:
    """Counters of other objects, under one roof: `add("control", …)` makes `control_requests` and so on."""

    def __init__(self) -> None:
        self._sources: dict[str, Mapping[str, int]] = {}

    def add(self, prefix: str, counters: Mapping[str, int]) -> None:
        """Show these too; they are read each time."""
        self._sources[prefix] = counters

    def __call__(self) -> dict[str, int]:
        """Return all counts."""
        return {f"{prefix}_{name}": n for prefix, counts in self._sources.items() for name, n in counts.items()}
