"""What changes when a configuration is read again: what can be applied at once, and what needs a restart.

Owns the comparison, pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fringed.config import StationConfig, effective

AT_ONCE = frozenset(
    {
        "acquisition",
        "checks",
        "pipelines",
        "presets",
        "default_pipeline",
        "log",
        "calibration",
        "record_truth",
        "board",
        "workers",
    }
)
CAMERA_AT_ONCE = frozenset({"exposure_us", "gain_db", "bits", "channel", "trigger"})


def changes(old: StationConfig, new: StationConfig) -> tuple[list[str], list[str]]:
    """Return the paths that are applied at once, and those that need a restart, each sorted."""
    at_once: list[str] = []
    restart: list[str] = []
    for path in _different(effective(old), effective(new)):
        top, _, rest = path.partition(".")
        soon = top in AT_ONCE or (top == "camera" and rest in CAMERA_AT_ONCE)
        (at_once if soon else restart).append(path)
    return sorted(at_once), sorted(restart)


def _different(old: Any, new: Any, path: str = "") -> list[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        names = sorted({*old, *new})
        return [
            found
            for name in names
            for found in _different(old.get(name), new.get(name), f"{path}.{name}" if path else str(name))
        ]
    return [] if old == new else [path]
