"""Recordings that a configuration names: the calibration, and what a replay shows.

Owns how they are found: by id in the store, or as a file's path.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from fringed.config import StationConfig, validate
from fringed.data import Calibration, FrameSet
from fringed.errors import ConfigurationError, FringedError, Problem
from fringed.hookspecs import Camera, Params, Projector
from fringed.recording.store import Store, load_file

if TYPE_CHECKING:
    from fringed.simulation.rig import SimulatedRig

_ID = re.compile(r"\d{8}T\d{6}\.\d{6}Z-[0-9a-f]{4}")


class ReplayOptions(Params, frozen=True, kw_only=True):
    """Options of `camera.driver = "replay"`."""

    recordings: Annotated[list[str], Meta(min_length=1, description="ids of frame sets, or their files")]
    real_time: Annotated[bool, Meta(description="false: as fast as it can")] = False


def load_calibration(config: StationConfig, rig: SimulatedRig | None) -> Calibration | None:
    """Return the calibration that the configuration says by itself, None where it says none.

    Raises
    ------
    ConfigurationError
        it cannot be loaded, or is something else.
    """
    if config.calibration in ("", "adopted"):
        return None
    if config.calibration == "simulated":
        if rig is None:
            raise _wrong("calibration", "'simulated'", "a calibration file, since the rig is not simulated")
        return rig.calibration()
    found = _loaded("calibration", config.calibration, None)
    if not isinstance(found, Calibration):
        kind = type(found).__name__
        raise _wrong("calibration", repr(config.calibration), f"the file of a Calibration; this one holds a {kind}")
    return found


def make_replay(config: StationConfig, store: Store) -> tuple[Camera, Projector]:
    """Return the camera and the projector of recordings; raises ConfigurationError."""
    from fringed.devices.camera.base import MachineClock
    from fringed.devices.camera.replay import ReplayCamera
    from fringed.devices.projector.replay import ReplayProjector

    options = validate(config.camera.options, ReplayOptions, "camera.options")
    sets = []
    for index, name in enumerate(options.recordings):
        found = _loaded(f"camera.options.recordings[{index}]", name, store)
        if not isinstance(found, FrameSet):
            kind = type(found).__name__
            raise _wrong(f"camera.options.recordings[{index}]", repr(name), f"a frame set; this is a {kind}")
        sets.append(found)
    camera = ReplayCamera(sets, MachineClock(), options.real_time)
    return camera, ReplayProjector(camera)


def _loaded(path: str, name: str, store: Store | None) -> Any:
    try:
        if store is not None and _ID.fullmatch(name):
            return store.load(name)
        return load_file(Path(name).expanduser())
    except FringedError as error:
        raise _wrong(path, repr(name), f"a recording that can be read ({error.message})") from error


def _wrong(path: str, value: str, allowed: str) -> ConfigurationError:
    return ConfigurationError("1 problem:", (Problem(path, value, allowed),))
