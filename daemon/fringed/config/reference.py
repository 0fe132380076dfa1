"""The configuration's reference page, generated from the schema.

Owns the text of `docs/configuration.md` between its introduction and its end; a test keeps it current.
"""

from __future__ import annotations

import types
import typing
from typing import Annotated, Any, Literal

import msgspec

from fringed.config.schema import StationConfig


def reference() -> str:
    """Return every section of the configuration as Markdown tables."""
    lines: list[str] = []
    _section(StationConfig, "", lines)
    return "\n".join(lines).strip() + "\n"


def _section(cls: type[msgspec.Struct], path: str, lines: list[str]) -> None:
    title = f"`[{path}]`" if path else "Top level"
    doc = (cls.__doc__ or "").strip().splitlines()[0]
    lines += [f"## {title}", "", doc, "", "| key | type and limits | default | meaning |", "| --- | --- | --- | --- |"]
    hints = typing.get_type_hints(cls, include_extras=True)
    below: list[tuple[type[msgspec.Struct], str]] = []
    for item in msgspec.structs.fields(cls):
        where = f"{path}.{item.name}" if path else item.name
        nested = _nested(hints[item.name])
        if nested is not None:
            below.append((nested[0], where + nested[1]))
            continue
        kind, meaning = _described(hints[item.name])
        lines.append(f"| `{item.name}` | {kind} | {_default(item)} | {meaning} |")
    lines.append("")
    for nested_cls, where in below:
        _section(nested_cls, where, lines)


def _nested(hint: Any) -> tuple[type[msgspec.Struct], str] | None:
    """Return the section that a field holds, and how its path goes on."""
    bare = typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint
    origin, args = typing.get_origin(bare), typing.get_args(bare)
    if isinstance(bare, type) and issubclass(bare, msgspec.Struct):
        return bare, ""
    if origin in (dict, list) and args:
        inner = _nested(args[-1])
        suffix = ".NAME" if origin is dict else "[]"
        return (inner[0], suffix + inner[1]) if inner else None
    if origin in (typing.Union, types.UnionType):
        others = [a for a in args if a is not types.NoneType]
        return _nested(others[0]) if len(others) == 1 else None
    return None


def _described(hint: Any) -> tuple[str, str]:
    args = typing.get_args(hint)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        kind, meaning = _described(args[0])
        return f"{kind}, or unset", meaning
    if typing.get_origin(hint) is not Annotated:
        return _type_name(hint), ""
    metas = [a for a in args[1:] if isinstance(a, msgspec.Meta)]
    limits = [
        f"{sign} {getattr(meta, name):g}"
        for meta in metas
        for name, sign in (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))
        if getattr(meta, name) is not None
    ]
    units = [str(m.extra_json_schema["units"]) for m in metas if m.extra_json_schema and "units" in m.extra_json_schema]
    meaning = "; ".join(m.description for m in metas if m.description)
    return " ".join([_type_name(args[0]), ", ".join(limits), *units]).replace("  ", " ").strip(), meaning


def _type_name(hint: Any) -> str:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        return " \\| ".join(f"`{a}`" for a in args)
    if origin is tuple:
        return f"{len(args)} x {_type_name(args[0])}"
    if origin is list:
        return f"list of {_type_name(args[0])}"
    if origin is dict:
        return "table"
    return {"str": "text", "int": "integer", "float": "number", "bool": "true or false"}.get(
        getattr(hint, "__name__", ""), str(hint)
    )


def _default(item: Any) -> str:
    if item.required:
        return "none: must be given"
    value = item.default if item.default is not msgspec.NODEFAULT else item.default_factory()
    if isinstance(value, float):
        return f"{value:g}"
    return f"`{value}`" if value not in ("", None) else "empty"
