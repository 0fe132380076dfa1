"""The camera settings that pipelines and presets name: which there are, and what is wrong with them.

Owns this check; the settings' types and limits are `CameraConfig`'s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from fringed.config.schema import CameraConfig, StationConfig
from fringed.errors import Problem

SETTINGS = ("exposure_us", "gain_db", "bits", "channel", "trigger")
FACTOR = "exposure_factor"  # of a role's set: how much longer than the scan's exposure

Check = Callable[[Mapping[str, Any], type[CameraConfig], str], list[Problem]]


def camera_problems(config: StationConfig, check: Check) -> list[Problem]:
    """Return every problem; `check` tells those of one table of settings."""
    return [problem for table, path in _tables(config) for problem in _table_problems(table, path, check)] + list(
        _role_problems(config)
    )


def _tables(config: StationConfig) -> Iterator[tuple[Mapping[str, Any], str]]:
    for kind, group in (("pipelines", config.pipelines), ("presets", config.presets)):
        for name, one in group.items():
            yield one.camera, f"{kind}.{name}.camera"
            for role, table in one.role_camera.items():
                yield table, f"{kind}.{name}.role_camera.{role}"


def _table_problems(table: Mapping[str, Any], path: str, check: Check) -> Iterator[Problem]:
    by_role = ".role_camera." in path
    known = (*SETTINGS, FACTOR) if by_role else SETTINGS
    yield from (Problem(f"{path}.{key}", "this key", f"one of {', '.join(known)}") for key in table if key not in known)
    yield from check({key: value for key, value in table.items() if key in SETTINGS}, CameraConfig, path)
    factor = table.get(FACTOR, 1.0)
    if by_role and (not isinstance(factor, (int, float)) or isinstance(factor, bool) or not factor > 0):
        yield Problem(f"{path}.{FACTOR}", repr(factor), "number > 0")


def _role_problems(config: StationConfig) -> Iterator[Problem]:
    for name, pipeline in config.pipelines.items():
        for role in pipeline.role_camera:
            if role not in pipeline.roles:
                yield Problem(
                    f"pipelines.{name}.role_camera.{role}", "this role", f"one of {', '.join(pipeline.roles)}"
                )
    for name, preset in config.presets.items():
        chosen = config.pipelines.get(preset.pipeline)
        for role in preset.role_camera if chosen else ():
            if chosen and role not in chosen.roles:
                yield Problem(f"presets.{name}.role_camera.{role}", "this role", f"one of {', '.join(chosen.roles)}")
