"""Build the devices that a configuration names.

Owns the drivers' names; imports what a driver needs only when it is named, plug-ins included.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fringed.config import StationConfig, validate
from fringed.config.schema import DeviceConfig
from fringed.devices.camera.base import AbsentCamera, MachineClock
from fringed.devices.projector.base import AbsentProjector
from fringed.errors import ConfigurationError, FringedError, PluginError, Problem
from fringed.hookspecs import Camera, Clock, Driver, Projector
from fringed.kernels import forget_stale_kernels
from fringed.loading import Catalogue

if TYPE_CHECKING:
    from fringed.simulation.rig import SimulatedRig

NONE, SIMULATED, REPLAY = "none", "sim", "replay"
_CAMERAS, _PROJECTORS = "fringed.devices.camera", "fringed.devices.projector"
BUILT_IN: Mapping[str, Mapping[str, str]] = {
    "camera": {
        "duncantech": f"{_CAMERAS}.duncantech:DUNCANTECH",
        "usb3vision": f"{_CAMERAS}.usb3vision:USB3_VISION",
        "gige": f"{_CAMERAS}.gige:GIGE",
        "webcam": f"{_CAMERAS}.webcam:WEBCAM",
    },
    "projector": {
        "hitachi": f"{_PROJECTORS}.hitachi:HITACHI",
        "window": f"{_PROJECTORS}.window:WINDOW",
    },
}
"""Our drivers of real devices, by kind and name: `module:class`, imported when a configuration names one."""
LoadPlugins = Callable[[], Catalogue]
MakeReplay = Callable[[StationConfig], tuple[Camera, Projector]]


@dataclass(frozen=True)
class Devices:
    """A station's devices; `rig` is what simulated ones share."""

    camera: Camera
    projector: Projector
    rig: SimulatedRig | None = None


@dataclass(frozen=True)
class DriverContext:
    """What a plug-in's driver is told beside its options."""

    station: str
    clock: Clock


def build_devices(
    config: StationConfig, load_plugins: LoadPlugins | None = None, make_replay: MakeReplay | None = None
) -> Devices:
    """Build camera and projector; nothing is opened. Plug-ins are loaded only for a driver that is none of ours.

    `make_replay` returns the camera and the projector of a recording; a driver "replay" takes its half.

    Raises
    ------
    ConfigurationError
        options that a driver does not have, or a scene that cannot be.
    NotFound
        no plug-in has a driver of that name.
    PluginError
        a plug-in's driver could not be built.
    """
    chosen = (config.camera.driver, config.projector.driver)
    rig = _rig(config) if SIMULATED in chosen else None
    replayed = _replay(config, make_replay) if REPLAY in chosen else None
    catalogue = _needed(chosen, load_plugins)
    return Devices(_camera(config, rig, replayed, catalogue), _projector(config, rig, replayed, catalogue), rig)


def _rig(config: StationConfig) -> SimulatedRig:
    from fringed.simulation import rig

    forget_stale_kernels(Path(rig.__file__).parent)
    return rig.SimulatedRig(config.simulation)


def _replay(config: StationConfig, make_replay: MakeReplay | None) -> tuple[Camera, Projector]:
    if make_replay is None:
        problem = Problem("camera.driver", "'replay'", "another driver: nothing here can replay")
        raise ConfigurationError("1 problem:", (problem,))
    return make_replay(config)


def _needed(chosen: tuple[str, str], load_plugins: LoadPlugins | None) -> Catalogue:
    ours = {NONE, SIMULATED, REPLAY, *BUILT_IN["camera"], *BUILT_IN["projector"]}
    if load_plugins is not None and set(chosen) - ours:
        return load_plugins()
    return Catalogue()


def _camera(
    config: StationConfig, rig: SimulatedRig | None, replayed: tuple[Camera, Projector] | None, catalogue: Catalogue
) -> Camera:
    if config.camera.driver == SIMULATED and rig is not None:
        from fringed.devices.camera.sim import SimulatedCamera

        return SimulatedCamera(rig, config.camera.options)
    if config.camera.driver == REPLAY and replayed is not None:
        return replayed[0]
    if config.camera.driver == NONE:
        return AbsentCamera()
    camera: Camera = _from_plugin("camera", config.camera, config.name, catalogue)
    return camera


def _projector(
    config: StationConfig, rig: SimulatedRig | None, replayed: tuple[Camera, Projector] | None, catalogue: Catalogue
) -> Projector:
    if config.projector.driver == SIMULATED and rig is not None:
        from fringed.devices.projector.sim import SimulatedProjector

        _no_options(config.projector.options)
        return SimulatedProjector(rig)
    if config.projector.driver == REPLAY and replayed is not None:
        return replayed[1]
    if config.projector.driver == NONE:
        return AbsentProjector()
    projector: Projector = _from_plugin("projector", config.projector, config.name, catalogue)
    return projector


def _no_options(options: Mapping[str, Any]) -> None:
    problems = tuple(
        Problem(f"projector.options.{key}", "this key", "nothing: its options are in [simulation.projector]")
        for key in options
    )
    if problems:
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)}:", problems)


def built_in(kind: str, name: str) -> Driver | None:
    """Return our own driver of a real device, imported now; None where none has that name."""
    place = BUILT_IN[kind].get(name)
    if place is None:
        return None
    module, _, attribute = place.partition(":")
    driver: Driver = getattr(importlib.import_module(module), attribute)
    return driver


def _from_plugin(kind: str, config: DeviceConfig, station: str, catalogue: Catalogue) -> Any:
    driver: Driver = built_in(kind, config.driver) or catalogue.get(kind, config.driver)
    options = validate(config.options, driver.Options, f"{kind}.options")
    try:
        return driver.create(options, DriverContext(station, MachineClock()))
    except FringedError:
        raise
    except Exception as error:
        raise PluginError(f"the {kind} driver {config.driver!r} could not be built: {error!r}") from error
