"""The configuration that a command line means: a file or the simulated rig, with single settings changed.

Owns `--set`; the rules of configurations are in `fringed.config`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fringed.config import StationConfig, merged, read_toml, simulated_station, station_of
from fringed.config.defaults import PIPELINES
from fringed.errors import UsageError


def configuration(path: Path | None, settings: Iterable[str] = ()) -> StationConfig:
    """Return the station's configuration.

    Raises
    ------
    ConfigurationError
        with every problem.
    UsageError
        a setting that is not KEY=VALUE.
    """
    over = parsed_settings(settings)
    if path is None:
        return simulated_station(over)
    return station_of(merged(merged(PIPELINES, read_toml(path)), over))


def parsed_settings(settings: Iterable[str]) -> dict[str, Any]:
    """Return `a.b=value` settings as nested tables; raises UsageError."""
    result: dict[str, Any] = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        names = key.strip().split(".")
        if not equals or not all(names):
            raise UsageError(f"--set {setting!r}; expected KEY=VALUE, such as workers.count=1")
        table: Any = _value(text.strip())
        for name in reversed(names):
            table = {name: table}
        result = merged(result, table)
    return result


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
