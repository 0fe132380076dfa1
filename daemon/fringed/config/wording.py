"""What a setting allows, in the words of people who write TOML.

Owns these words only; `validation` finds what is wrong.
"""

from __future__ import annotations

import types
import typing
from typing import Annotated, Any, Literal

import msgspec

_LIMITS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
_LENGTHS = (("min_length", "at least"), ("max_length", "at most"))
_ONE = {str: "text", int: "integer", float: "number", bool: "true or false", dict: "a table", types.NoneType: "nothing"}
_MANY = {str: "texts", int: "integers", float: "numbers", dict: "tables"}


def allowed(hint: Any) -> str:
    """Return what a type with its limits and units allows, such as "integer >= 3 or a list of integers"."""
    bare, metas = _parts(hint)
    origin, args = typing.get_origin(bare), typing.get_args(bare)
    if origin is Literal:
        return "one of " + ", ".join(map(repr, args))
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(allowed(one) for one in args if one is not types.NoneType))
    if isinstance(bare, type) and issubclass(bare, msgspec.Struct):
        return "a table"
    return " ".join(filter(None, (_several(bare) or _single(bare), _limits(metas, bare is str), _units(metas))))


def _parts(hint: Any) -> tuple[Any, list[msgspec.Meta]]:
    if typing.get_origin(hint) is not Annotated:
        return hint, []
    bare, *rest = typing.get_args(hint)
    inner, metas = _parts(bare)
    return inner, [*metas, *(one for one in rest if isinstance(one, msgspec.Meta))]


def _single(bare: Any) -> str:
    if typing.get_origin(bare) is dict:
        return "a table"
    return _ONE.get(bare, "any value" if bare is Any else str(getattr(bare, "__name__", bare)))


def _several(bare: Any) -> str:
    """Return the words for a list or a tuple, nothing for anything else."""
    origin, args = typing.get_origin(bare), typing.get_args(bare)
    if bare in (list, tuple):
        return "a list"
    if origin is tuple and args[-1] is not Ellipsis:
        return f"{len(args)} {_plural(args[0])}" if len(set(args)) == 1 else f"{len(args)} values"
    return f"a list of {_plural(args[0])}" if origin in (list, tuple) else ""


def _plural(hint: Any) -> str:
    bare, metas = _parts(hint)
    if typing.get_origin(bare) in (list, tuple):
        return f"lists of {_several(bare).removeprefix('a list of ')}"
    if bare not in _MANY:
        return "tables" if allowed(hint) == "a table" else f"values, each {allowed(hint)}"
    limits = _limits(metas, bare is str)
    return f"{_MANY[bare]} {limits}".strip()


def _limits(metas: list[msgspec.Meta], text: bool) -> str:
    what = "characters" if text else "of them"
    signs = [
        f"{sign} {_number(getattr(m, key))}" for m in metas for key, sign in _LIMITS if getattr(m, key) is not None
    ]
    notes = [
        f"({'not empty' if (key, getattr(m, key)) == ('min_length', 1) else f'{word} {getattr(m, key)} {what}'})"
        for m in metas
        for key, word in _LENGTHS
        if getattr(m, key) is not None
    ]
    patterns = [f"matching {m.pattern}" for m in metas if m.pattern is not None]
    return " ".join(filter(None, (" and ".join(signs), *patterns, *notes)))


def _number(value: float) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _units(metas: list[msgspec.Meta]) -> str:
    known = [meta.extra_json_schema for meta in metas if meta.extra_json_schema]
    return next((str(extra["units"]) for extra in known if "units" in extra), "")
