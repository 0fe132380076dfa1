"""Which camera settings a set is taken with: those of station, pipeline, preset and request, and its role's own.

Owns this merge; pure. What belongs to a role lies over everything that holds for the whole scan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fringed.config import CameraConfig, merged, validate
from fringed.config.cameras import FACTOR, SETTINGS
from fringed.data import CameraSettings
from fringed.errors import ConfigurationError, Problem, UsageError

Tables = Mapping[str, Any]


def camera_settings(config: CameraConfig, over: Tables, path: str = "camera") -> CameraSettings:
    """Return the camera's settings; raises ConfigurationError with every wrong one."""
    unknown = [
        Problem(f"{path}.{key}", "this key", f"one of {', '.join(SETTINGS)}") for key in over if key not in SETTINGS
    ]
    if unknown:
        raise ConfigurationError(f"{len(unknown)} problem{'s' * (len(unknown) > 1)} in {path}:", tuple(unknown))
    chosen = validate({**{name: getattr(config, name) for name in SETTINGS}, **over}, CameraConfig, path)
    return CameraSettings(**{name: getattr(chosen, name) for name in SETTINGS})


def merged_roles(base: Tables, over: Tables) -> dict[str, Any]:
    """Return tables of roles merged; who gives an exposure for a role does not mean a share of it."""
    kept = {
        role: {key: value for key, value in table.items() if key != FACTOR} if _sets_exposure(over.get(role)) else table
        for role, table in base.items()
    }
    return merged(kept, over)


def _sets_exposure(table: Any) -> bool:
    return isinstance(table, Mapping) and "exposure_us" in table


def settings_by_role(
    config: CameraConfig, over: Tables, by_role: Tables, roles: Sequence[str]
) -> dict[str, CameraSettings]:
    """Return the settings of each role's set.

    Raises
    ------
    ConfigurationError
        with every wrong setting.
    UsageError
        settings for a role that is not there.
    """
    unknown = sorted(set(by_role) - set(roles))
    if unknown:
        raise UsageError(f"camera settings for the role {', '.join(unknown)}; the roles are {', '.join(roles)}")
    return {role: _of_role(config, over, by_role.get(role, {}), role) for role in roles}


def _of_role(config: CameraConfig, over: Tables, own: Any, role: str) -> CameraSettings:
    path = f"role_camera.{role}"
    if not isinstance(own, Mapping):
        raise ConfigurationError("1 problem:", (Problem(path, repr(own)[:80], "a table"),))
    base = camera_settings(config, over)
    own = dict(own)
    factor = own.pop(FACTOR, 1.0)
    if not isinstance(factor, (int, float)) or isinstance(factor, bool) or not factor > 0:
        raise ConfigurationError("1 problem:", (Problem(f"{path}.{FACTOR}", repr(factor), "number > 0"),))
    if factor != 1.0:
        own["exposure_us"] = own.get("exposure_us", base.exposure_us) * factor
    return camera_settings(config, {**over, **own}, path)
