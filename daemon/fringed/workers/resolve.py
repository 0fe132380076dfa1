"""Which object each input of a plug-in gets: by name where the pipeline says so, else by type.

Owns the rule; knows neither sockets nor plug-ins' work. `pool` holds the job's inputs, then the products of
earlier stages, in order. For an input of type T, in turn:

1. what the stage's `inputs` names;
2. what has the input's own name and the type T;
3. the newest product of type T, else the only job input of type T. Two unnamed inputs of one type are ambiguous.

An optional input takes by type only what is alone in its type and serves no other input. An input declared
as `(T,)` takes a sequence: what 1 or 2 give, else everything of type T.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import UnionType
from typing import Any, Union, get_args, get_origin

from fringed.errors import DataError


@dataclass
class Pool:
    """What a stage may take: `given` are the job's inputs, `made` the products of earlier stages."""

    given: Mapping[str, Any]
    made: dict[str, Any] = field(default_factory=dict)

    def all(self) -> dict[str, Any]:
        """Return everything by name; a product hides a job input of its name."""
        return {**self.given, **self.made}


HINTS = {
    "Calibration": "; none is in force: make one with `fringe calibrate --use`, or put one in force with "
    "`fringe calibration use`"
}


def resolve(
    wanted: Mapping[str, Any], optional: Iterable[str], sources: Mapping[str, str], pool: Pool, stage: str
) -> dict[str, Any]:
    """Return an object for each of `wanted` (name -> type, or (type,) for a sequence).

    Raises
    ------
    DataError
        an input is missing, ambiguous or of another type, or `sources` names what is not there.
    """
    _check_sources(sources, wanted, pool, stage)
    found: dict[str, Any] = {}
    for name, kind in wanted.items():
        if name in sources:
            found[name] = _explicit(name, kind, sources[name], pool, stage)
        elif name in pool.all() and _fits(pool.all()[name], kind):
            found[name] = _shaped(pool.all()[name], kind)
    required = [name for name in wanted if name not in found and name not in set(optional)]
    for name in required:
        found[name] = _by_type(name, wanted, required, pool, stage)
    for name in sorted(set(wanted) - set(found)):
        taken = {id(value) for value in found.values()}
        loose = [value for value in pool.all().values() if _fits(value, wanted[name]) and id(value) not in taken]
        if len(loose) == 1:
            found[name] = _shaped(loose[0], wanted[name])
    return {name: found[name] for name in wanted if name in found}


def _check_sources(sources: Mapping[str, str], wanted: Mapping[str, Any], pool: Pool, stage: str) -> None:
    unknown = sorted(set(sources) - set(wanted))
    if unknown:
        allowed = ", ".join(sorted(wanted)) or "none"
        raise DataError(f"stage {stage!r} maps the inputs {', '.join(unknown)}; its plug-in has: {allowed}")


def _explicit(name: str, kind: Any, source: str, pool: Pool, stage: str) -> Any:
    everything = pool.all()
    if source not in everything:
        there = ", ".join(sorted(everything)) or "nothing"
        raise DataError(f"stage {stage!r} takes its input {name!r} from {source!r}; there is: {there}")
    value = everything[source]
    if not _fits(value, kind):
        raise DataError(
            f"stage {stage!r} takes its input {name!r} from {source!r}, which is {_describe(value)}; "
            f"it needs {type_name(kind)}"
        )
    return _shaped(value, kind)


def _by_type(name: str, wanted: Mapping[str, Any], unnamed: list[str], pool: Pool, stage: str) -> Any:
    kind = wanted[name]
    made = [value for value in pool.made.values() if _fits(value, kind)]
    given = {key: value for key, value in pool.given.items() if _fits(value, kind)}
    if isinstance(kind, tuple):
        return _sequence(name, kind, pool, stage)
    rivals = [other for other in unnamed if wanted[other] == kind]
    if (made or given) and len(rivals) > 1:
        raise DataError(
            f"stage {stage!r} has several inputs of type {type_name(kind)} ({', '.join(rivals)}); "
            f"name the source of each in its `inputs`; there is: {', '.join(pool.all())}"
        )
    if made:
        return made[-1]
    if len(given) == 1:
        return next(iter(given.values()))
    if given:
        raise DataError(
            f"stage {stage!r}: input {name!r} could be {' or '.join(given)}, all of type {type_name(kind)}; "
            f"name one in its `inputs`"
        )
    raise _missing(name, kind, pool, stage)


def _sequence(name: str, kind: Any, pool: Pool, stage: str) -> tuple[Any, ...]:
    values = list(pool.all().values())
    lists = [value for value in values if isinstance(value, (list, tuple)) and _fits(value, kind)]
    if len(lists) == 1:
        return tuple(lists[0])
    single = tuple(value for value in values if isinstance(value, kind[0]))
    if lists or not single:
        raise _missing(name, kind, pool, stage)
    return single


def _missing(name: str, kind: Any, pool: Pool, stage: str) -> DataError:
    there = ", ".join(f"{key} ({_describe(value)})" for key, value in pool.all().items()) or "nothing"
    hint = HINTS.get(type_name(kind), "")
    return DataError(f"stage {stage!r} needs {type_name(kind)} for its input {name!r}; there is: {there}{hint}")


def _fits(value: Any, kind: Any) -> bool:
    if isinstance(kind, tuple):
        if isinstance(value, (list, tuple)):
            return bool(value) and all(isinstance(item, kind[0]) for item in value)
        return isinstance(value, kind[0])
    return isinstance(value, kind)


def _shaped(value: Any, kind: Any) -> Any:
    if not isinstance(kind, tuple):
        return value
    return tuple(value) if isinstance(value, (list, tuple)) else (value,)


def _describe(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        counts = Counter(type(item).__name__ for item in value)
        return " and ".join(f"{count} x {name}" for name, count in counts.items()) or "an empty list"
    return type(value).__name__


def type_name(kind: Any) -> str:
    """Return a declared type as people read it, such as "one or more RangeImage" or "PhaseMap or RangeImage"."""
    if isinstance(kind, tuple):
        return f"one or more {type_name(kind[0])}"
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(type_name(one) for one in get_args(kind))
    return str(getattr(kind, "__name__", kind))
