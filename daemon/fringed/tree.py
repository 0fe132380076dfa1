"""Data objects <-> a tree of plain JSON types and their arrays: what the wire and the recordings share.

Owns how arrays, dataclasses and numbers that JSON lacks are written in the tree; knows neither the data
types nor bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from math import isfinite
from typing import Any

import msgspec
import numpy as np

from fringed.errors import DataError

Array = np.ndarray[Any, np.dtype[Any]]

MAX_DEPTH = 64
_ESCAPED = {"": "~", ".": "~."}
_NOT_FINITE = {"nan": float("nan"), "inf": float("inf"), "-inf": float("-inf")}


def split(value: Any, path: str, arrays: dict[str, Array], tag: bool = False) -> Any:
    """Return `value` as plain JSON types, its arrays moved to `arrays` under their paths.

    An array leaves `{"$array": path}` in its place, a number that JSON lacks `{"$float": "nan"}` (or
    "inf", "-inf"), a dataclass where any type may stand `{"$kind": name, ...}` when `tag` is set. In
    keys of mappings a leading `$` is doubled; in paths `~`, `/` and NUL of a key are `~0`, `~1` and
    `~2`, an empty key is `~`, and `.` is `~.`, so that every path is one in a file too.

    Raises
    ------
    DataError
        a value that is none of these, or a nesting deeper than 64.
    """
    if isinstance(value, np.ndarray):
        arrays[path] = value
        return {"$array": path}
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        if isinstance(value, str) and not _is_unicode(value):
            raise DataError(f"{path} is {ascii(value)[:80]}, which is not valid Unicode")
        if type(value) is int and not -(2**63) <= value < 2**64:
            raise DataError(f"{path} is {str(value)[:40]}; a message carries integers of 64 bits")
        return value
    if isinstance(value, float):
        return value if isfinite(value) else {"$float": str(value)}
    if path.count("/") > MAX_DEPTH:
        raise DataError(f"{path[:80]}… is nested deeper than {MAX_DEPTH}")
    if hasattr(type(value), "__dataclass_fields__"):
        tree: dict[str, Any] = {"$kind": type(value).__name__} if tag else {}
        for item in fields(value):
            tree[item.name] = split(getattr(value, item.name), _below(path, item.name), arrays, item.type == "Any")
        return tree
    if isinstance(value, Mapping):
        return {
            _key(str(key), path): split(item, _below(path, str(key)), arrays, tag=True) for key, item in value.items()
        }
    if isinstance(value, (list, tuple)):
        return [split(item, _below(path, str(i)), arrays, tag) for i, item in enumerate(value)]
    raise DataError(f"{path or 'it'} is a {type(value).__name__}, which does not travel: {str(value)[:80]}")


def _key(key: str, path: str) -> str:
    if not _is_unicode(key):
        raise DataError(f"{path} has the key {ascii(key)[:80]}, which is not valid Unicode")
    return f"${key}" if key.startswith("$") else key


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _below(path: str, key: str) -> str:
    escaped = _ESCAPED.get(key) or key.replace("~", "~0").replace("/", "~1").replace("\0", "~2")
    return f"{path}/{escaped}" if path else escaped


def join(tree: Any, cls: type[Any], arrays: Mapping[str, Array], kinds: Mapping[str, type[Any]]) -> Any:
    """Undo `split`: build a `cls` from plain JSON types and arrays.

    Raises
    ------
    DataError
        a field is missing or of another type, or an array is not there.
    """
    try:
        if isinstance(tree, dict):
            tree = {key: item for key, item in tree.items() if key != "$kind"}
        return msgspec.convert(_revive(tree, arrays, kinds, 0), cls, dec_hook=_array_hook)
    except (ValueError, TypeError, RecursionError, OverflowError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"not a valid {cls.__name__}: {error}") from error


def _array_hook(kind: type[Any], value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value
    raise ValueError(f"expected an array, got {str(value)[:80]}")


def _revive(node: Any, arrays: Mapping[str, Array], kinds: Mapping[str, type[Any]], depth: int) -> Any:
    if depth > MAX_DEPTH + 2:
        raise DataError(f"a message is nested deeper than {MAX_DEPTH}")
    if isinstance(node, list):
        return [_revive(item, arrays, kinds, depth + 1) for item in node]
    if not isinstance(node, dict):
        return node
    if node.keys() == {"$array"}:
        return _named(str(node["$array"]), arrays, "array")
    if node.keys() == {"$float"}:
        return _named(str(node["$float"]), _NOT_FINITE, "number")
    plain = {
        key[1:] if key.startswith("$") else key: _revive(item, arrays, kinds, depth + 1)
        for key, item in node.items()
        if key != "$kind"
    }
    if "$kind" not in node:
        return plain
    return msgspec.convert(plain, _named(str(node["$kind"]), kinds, "kind"), dec_hook=_array_hook)


def _named(name: str, known: Mapping[str, Any], what: str) -> Any:
    if name not in known:
        raise DataError(
            f"a message names the {what} {name[:80]!r}; there are {', '.join(sorted(known))[:800] or 'none'}"
        )
    return known[name]
