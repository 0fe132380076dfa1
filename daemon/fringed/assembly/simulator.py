"""Orders for a simulated rig: another scene, faults.

Owns where a scene's object comes from: built in, or made by a plug-in in a worker.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec

from fringed.config import validate
from fringed.config.simulated import SceneConfig
from fringed.data import Mesh, new_id
from fringed.errors import FringedError, NotFound, PluginError, UsageError, error_classes
from fringed.messages import ErrorInfo, Job, JobDone, JobProgress, StageCall, StageDone
from fringed.serving.house import House
from fringed.serving.ports import JobWatcher

if TYPE_CHECKING:
    from fringed.simulation.rig import SimulatedRig

_log = logging.getLogger(__name__)
Done = Callable[[Any], None]
Failed = Callable[[FringedError], None]


class Simulator:
    """The simulated rig as requests see it; in the reactor's thread."""

    def __init__(self, house: House, rig: SimulatedRig) -> None:
        self._house = house
        self._rig = rig

    def set_scene(self, scene: Mapping[str, Any], done: Done, failed: Failed) -> None:
        """Put another scene in front of the rig; `done`, with the former scene, or `failed` is called later."""
        from fringed.simulation.shapes import OBJECTS

        config = validate(scene, SceneConfig, "simulation.scene")
        if config.object in OBJECTS:
            self._place(config, None, done, failed)
            return
        if (told := self._house.hosts.schemas()) and config.object not in told.get("scene", {}):
            failed(self._unknown(config.object))
            return
        meshes: list[Mesh] = []
        call = StageCall("scene", "scene", config.object, config.options)
        watcher = JobWatcher(
            partial(_made, meshes),
            partial(self._ready, config, meshes, (done, failed)),
            partial(self._refused, config.object, failed),
            _ignore,
        )
        self._house.jobs.submit(Job(new_id(), (call,), {}, f"scene {config.object}", simulated=True), watcher)

    def set_first_scene(self, scene: Mapping[str, Any]) -> None:
        """Have a worker make the configured scene; until it has, there are no scans, and that is said."""
        name = scene["object"]
        _log.warning("the scene %r comes from a plug-in; until a worker has made it, there are no scans", name)
        self._house.no_scene = UsageError(f"a plug-in is still making the scene {name!r}; ask again in a moment")
        self.set_scene(scene, lambda _: _log.info("the scene %r stands there now", name), self._first_failed)

    def _first_failed(self, error: FringedError) -> None:
        _log.error("the configured scene cannot be made, so there are no scans: %s", error)
        if self._house.no_scene is not None:  # else another one was ordered meanwhile
            self._house.no_scene = error

    def order_fault(self, fault: str, count: int) -> None:
        """Have the next `count` occasions struck by a fault."""
        self._rig.faults.order(fault, count)

    def _ready(self, config: SceneConfig, meshes: list[Mesh], then: tuple[Done, Failed], _: JobDone) -> None:
        done, failed = then
        if meshes:
            self._place(config, meshes[0], done, failed)
        else:
            failed(PluginError(f"the scene {config.object!r} answered without a mesh"))

    def _place(self, config: SceneConfig, mesh: Mesh | None, done: Done, failed: Failed) -> None:
        """Build it in the loader's thread: a mesh file is read from the disk."""
        before = msgspec.to_builtins(self._rig.scene)
        placed = partial(self._placed, done, before)
        self._house.in_thread(self._house.loader, partial(self._rig.set_scene, config, mesh), placed, failed)

    def _placed(self, done: Done, before: Mapping[str, Any], _: Any) -> None:
        self._house.no_scene = None
        done(before)

    def _refused(self, name: str, failed: Failed, error: ErrorInfo, _: bool) -> None:
        if error.code == "NotFound":
            failed(self._unknown(name))
        else:
            failed(error_classes().get(error.code, PluginError)(error.message))

    def _unknown(self, name: str) -> NotFound:
        from fringed.simulation.shapes import OBJECTS

        others = ", ".join(sorted(self._house.hosts.schemas().get("scene", {}))) or "none"
        return NotFound(f"no scene is called {name!r}; built in are {', '.join(OBJECTS)}; of plug-ins: {others}")


def _made(meshes: list[Mesh], answer: StageDone) -> None:
    if isinstance(answer.product, Mesh):
        meshes.append(answer.product)


def _ignore(_: JobProgress) -> None:
    return
