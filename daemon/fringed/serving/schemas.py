"""Parameters checked against the JSON Schemas that workers sent, so that a slip is told before a scan starts.

Owns the part of JSON Schema that msgspec writes for a plug-in's `Params`; pure. The plug-in's own check comes
later, in its worker; what this one does not know, it lets pass.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from fringed.errors import ConfigurationError, NotFound, Problem
from fringed.messages import StageCall

_LIMITS: tuple[tuple[str, str, Callable[[Any, Any], bool]], ...] = (
    ("minimum", "at least", operator.ge),
    ("exclusiveMinimum", "more than", operator.gt),
    ("maximum", "at most", operator.le),
    ("exclusiveMaximum", "less than", operator.lt),
)
_WORDS = {"object": "a table", "array": "a list", "string": "text", "boolean": "true or false", "null": "nothing"}
_TYPES: dict[str, tuple[type, ...]] = {
    "object": (Mapping,), "array": (list, tuple), "string": (str,), "boolean": (bool,), "integer": (int,),
    "number": (int, float), "null": (type(None),),
}  # fmt: skip


def check_stages(stages: Iterable[StageCall], schemas: Mapping[str, Mapping[str, Any]]) -> None:
    """Check plug-ins' names and parameters; nothing is checked while no worker has told its plug-ins.

    Raises
    ------
    NotFound
        no plug-in of that name.
    ConfigurationError
        with every wrong parameter.
    """
    problems: list[Problem] = []
    for stage in stages if schemas else ():
        known = schemas.get(stage.kind, {})
        if stage.plugin not in known:
            there = ", ".join(sorted(known)) or "none"
            raise NotFound(f"no {stage.kind} is called {stage.plugin!r} (stage {stage.name!r}); there are {there}")
        _walk(stage.params, known[stage.plugin], f"{stage.name}.params", problems, known[stage.plugin])
    if problems:
        raise ConfigurationError(f"{len(problems)} problem{'s' * (len(problems) > 1)}:", tuple(problems))


def _walk(value: Any, schema: Any, path: str, problems: list[Problem], root: Any) -> None:
    schema = _resolved(schema, root)
    options = schema.get("anyOf")
    if options:
        found: list[list[Problem]] = []
        for option in options:
            mine: list[Problem] = []
            _walk(value, option, path, mine, root)
            found.append(mine)
        nested = [mine for mine in found if any(problem.path != path for problem in mine)]
        if all(found) and nested:
            problems.extend(sorted(nested, key=len)[0])
        elif all(found):
            told = dict.fromkeys(problem.allowed for mine in found for problem in mine if problem.allowed != "nothing")
            problems.append(Problem(path, repr(value)[:80], " or ".join(told)))
        return
    wanted = _TYPES.get(schema.get("type", ""))
    if "enum" in schema and value not in schema["enum"]:
        problems.append(Problem(path, repr(value)[:80], "one of " + ", ".join(map(repr, schema["enum"]))))
    elif wanted and (not isinstance(value, wanted) or (isinstance(value, bool) and bool not in wanted)):
        problems.append(Problem(path, repr(value)[:80], f"{_words(schema)}{_units(schema)}"))
    elif isinstance(value, Mapping):
        _walk_table(value, schema, path, problems, root)
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            _walk(item, schema.get("items") or {}, f"{path}[{index}]", problems, root)
    elif isinstance(value, (int, float)):
        limits = [(text, schema[key], holds) for key, text, holds in _LIMITS if key in schema]
        if not all(holds(value, limit) for _, limit, holds in limits):
            allowed = " and ".join(f"{text} {limit}" for text, limit, _ in limits)
            problems.append(Problem(path, repr(value)[:80], allowed + _units(schema)))


def _walk_table(value: Mapping[str, Any], schema: Any, path: str, problems: list[Problem], root: Any) -> None:
    properties = schema.get("properties", {})
    for key, item in value.items():
        if key in properties:
            _walk(item, properties[key], f"{path}.{key}", problems, root)
        elif schema.get("additionalProperties", True) is False:
            close = get_close_matches(str(key), properties, 1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            allowed = f"one of {', '.join(sorted(properties)) or 'nothing'}{hint}"
            problems.append(Problem(f"{path}.{key}", "this key", allowed))
    for key in schema.get("required", ()):
        if key not in value:
            problems.append(Problem(f"{path}.{key}", "nothing", "a value; it has no default"))


def _resolved(schema: Any, root: Any) -> Mapping[str, Any]:
    for _ in range(8):
        reference = schema.get("$ref") if isinstance(schema, Mapping) else None
        if not isinstance(reference, str):
            break
        own = root.get("$defs", {}).get(reference.rpartition("/")[2], {})
        schema = {**own, **{key: item for key, item in schema.items() if key not in ("$ref", "$defs")}}
    return schema if isinstance(schema, Mapping) else {}


def _words(schema: Mapping[str, Any]) -> str:
    kind = str(schema["type"])
    return _WORDS.get(kind, kind)


def _units(schema: Mapping[str, Any]) -> str:
    return f" {schema['units']}" if "units" in schema else ""
