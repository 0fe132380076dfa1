"""Read and check configurations and parameters, naming *every* problem with its path.

Owns the walk over a msgspec struct that collects problems instead of stopping at the first one.
"""

from __future__ import annotations

import tomllib
import types
import typing
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union

import msgspec

from fringed.config.cameras import camera_problems
from fringed.config.references import reference_problems
from fringed.config.schema import StationConfig
from fringed.config.wording import allowed
from fringed.errors import ConfigurationError, Problem

T = TypeVar("T", bound=msgspec.Struct)


def validate(raw: Mapping[str, Any], cls: type[T], path: str = "") -> T:
    """Build a `cls` from plain values.

    Raises
    ------
    ConfigurationError
        with one Problem for each wrong value, unknown key or missing field.
    """
    problems: list[Problem] = []
    _walk_struct(raw, cls, path, problems)
    if problems:
        where = path or cls.__name__
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)} in {where}:", tuple(problems))
    try:
        return msgspec.convert(raw, cls, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigurationError(
            f"{path or cls.__name__}: {error}", (Problem(path, str(raw)[:80], str(error)),)
        ) from error


def read_toml(path: Path) -> dict[str, Any]:
    """Return the file's tables.

    Raises
    ------
    ConfigurationError
        the file is missing, unreadable or not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigurationError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path} cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path} is not TOML: {error}") from error


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with the values of `over`, tables merged key by key."""
    result = dict(base)
    for key, value in over.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


def describe(cls: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the JSON Schema of a struct, with limits, help and units."""
    return msgspec.json.schema(cls)


def _walk_struct(raw: Any, cls: type[msgspec.Struct], path: str, problems: list[Problem]) -> None:
    if not isinstance(raw, Mapping):
        problems.append(Problem(path, repr(raw)[:80], "a table"))
        return
    hints = typing.get_type_hints(cls, include_extras=True)
    required = {f.name for f in msgspec.structs.fields(cls) if f.required}
    for key, value in raw.items():
        where = f"{path}.{key}" if path else str(key)
        if key not in hints:
            close = get_close_matches(str(key), hints, 1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            problems.append(Problem(where, "this key", f"one of {', '.join(sorted(hints))}{hint}"))
        else:
            _walk(value, hints[key], where, problems)
    for key in sorted(required - set(raw)):
        problems.append(Problem(f"{path}.{key}" if path else key, "nothing", "a value; it has no default"))


def _walk(value: Any, hint: Any, path: str, problems: list[Problem]) -> None:
    bare = typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint
    origin, args = typing.get_origin(bare), typing.get_args(bare)
    if origin in (Union, types.UnionType) and value is not None:
        others = [a for a in args if a is not types.NoneType]
        if len(others) == 1:
            _walk(value, others[0], path, problems)
            return
    if isinstance(bare, type) and issubclass(bare, msgspec.Struct):
        _walk_struct(value, bare, path, problems)
    elif origin is dict and isinstance(value, Mapping) and args[1] is not Any:
        for key, item in value.items():
            _walk(item, args[1], f"{path}.{key}", problems)
    elif origin is list and isinstance(value, list) and value:
        for index, item in enumerate(value):
            _walk(item, args[0], f"{path}[{index}]", problems)
    else:
        try:
            msgspec.convert(value, hint)
        except msgspec.ValidationError:
            problems.append(Problem(path, repr(value)[:80], allowed(hint)))
        else:
            if not _finite(value):
                problems.append(Problem(path, repr(value)[:80], "finite numbers"))


def _finite(value: Any) -> bool:
    """Tell whether no number is NaN or infinite: TOML can write them, and no setting can mean them."""
    if isinstance(value, Mapping):
        return all(map(_finite, value.values()))
    if isinstance(value, (list, tuple)):
        return all(map(_finite, value))
    return not isinstance(value, float) or isfinite(value)


_NOTHING: Any = object()


def sound_part(raw: Any, hint: Any) -> Any:
    """Return `raw` without what is wrong in it, so that the rest can be checked; `_NOTHING` where nothing is left.

    A list is whole or left out, for its other entries would change their places.
    """
    problems: list[Problem] = []
    _walk(raw, hint, "", problems)
    if not problems:
        return raw
    bare = typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint
    origin, args = typing.get_origin(bare), typing.get_args(bare)
    if isinstance(raw, Mapping) and isinstance(bare, type) and issubclass(bare, msgspec.Struct):
        hints = typing.get_type_hints(bare, include_extras=True)
        parts = {key: sound_part(value, hints[key]) for key, value in raw.items() if key in hints}
        found = {key: part for key, part in parts.items() if part is not _NOTHING}
        required = {field.name for field in msgspec.structs.fields(bare) if field.required}
        return found if required <= set(found) else _NOTHING
    if isinstance(raw, Mapping) and origin is dict:
        parts = {key: sound_part(value, args[1]) for key, value in raw.items()}
        return {key: part for key, part in parts.items() if part is not _NOTHING}
    if isinstance(raw, list) and origin is list:
        items = [sound_part(value, args[0]) for value in raw]
        return _NOTHING if any(item is _NOTHING for item in items) else items
    return _NOTHING


def examined(raw: Mapping[str, Any]) -> tuple[StationConfig, list[Problem]]:
    """Return a station's configuration without what is wrong in it, and every problem at once."""
    problems: list[Problem] = []
    _walk_struct(raw, StationConfig, "", problems)
    config = msgspec.convert(sound_part(raw, StationConfig), StationConfig, strict=True)
    pipelines = raw.get("pipelines")
    named = set(config.pipelines) | set(pipelines if isinstance(pipelines, Mapping) else ())
    problems += reference_problems(config, named, {problem.path for problem in problems})
    problems += camera_problems(config, _problems_of)
    return config, problems


def _problems_of(raw: Mapping[str, Any], cls: type[msgspec.Struct], path: str) -> list[Problem]:
    problems: list[Problem] = []
    _walk_struct(raw, cls, path, problems)
    return problems


def station_of(raw: Mapping[str, Any]) -> StationConfig:
    """Return the configuration that plain values mean.

    Raises
    ------
    ConfigurationError
        with every problem.
    """
    config, problems = examined(raw)
    raise_problems(problems)
    return config


def raise_problems(problems: Sequence[Problem]) -> None:
    """Raise ConfigurationError where there are problems."""
    if problems:
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)}:", tuple(problems))


def load_station(path: Path) -> StationConfig:
    """Read a station's configuration over the built-in pipelines and presets.

    Raises
    ------
    ConfigurationError
        with every problem.
    """
    from fringed.config.defaults import PIPELINES

    return station_of(merged(PIPELINES, read_toml(path)))


def simulated_station(over: Mapping[str, Any] | None = None) -> StationConfig:
    """Return the station that runs without a configuration: a simulated rig, named so."""
    from fringed.config.defaults import PIPELINES, SIMULATED

    return station_of(merged(merged(PIPELINES, SIMULATED), over or {}))


def check_station(config: StationConfig) -> StationConfig:
    """Check what one value cannot tell alone: names that refer to each other; raises ConfigurationError."""
    raise_problems([*reference_problems(config, set(config.pipelines)), *camera_problems(config, _problems_of)])
    return config


def effective(config: StationConfig) -> dict[str, Any]:
    """Return the configuration as plain values, every default written out."""
    return dict(msgspec.to_builtins(config))
