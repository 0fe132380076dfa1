"""What a worker tells of the plug-ins that it loaded.

Owns the table of JSON Schemas that `WorkerReady` carries; runs no plug-in.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import msgspec

from fringed.config import describe
from fringed.loading import Catalogue
from fringed.workers.resolve import type_name

_log = logging.getLogger(__name__)


def schemas_of(catalogue: Catalogue) -> dict[str, dict[str, Any]]:
    """Return the JSON Schema of every Params (of every driver's Options), by kind and name.

    `x-plugin` of each holds its version, summary, inputs and output, and whether it streams.
    """
    found: dict[str, dict[str, Any]] = {}
    for kind, items in catalogue.provided.items():
        for name, item in items.items():
            params = getattr(item, "Params", None) or getattr(item, "Options", None)
            if isinstance(params, type) and issubclass(params, msgspec.Struct):
                found.setdefault(kind, {})[name] = {**_schema(params), "x-plugin": _about(item)}
    return found


def _schema(params: type[msgspec.Struct]) -> dict[str, Any]:
    try:
        return describe(params)
    except Exception as error:  # noqa: BLE001  a plug-in's types may defy description; its parameters still work
        _log.warning("no JSON Schema for %s: %s", params, error)
        return {}


def _about(item: Any) -> dict[str, Any]:
    about: dict[str, Any] = {"version": str(getattr(item, "version", "")), "summary": str(item.summary)}
    if isinstance(getattr(item, "inputs", None), Mapping):
        about["inputs"] = {name: _type_text(kind) for name, kind in item.inputs.items()}
        about["optional"] = sorted(item.optional)
        about["output"] = _type_text(item.output)
        about["streams"] = hasattr(item, "begin")
    for name in ("suffix", "media_type"):
        if hasattr(item, name):
            about[name] = str(getattr(item, name))
    if hasattr(item, "decoders"):
        about["decoders"] = list(item.decoders)
    return about


def _type_text(kind: Any) -> str:
    if isinstance(kind, tuple):
        return f"{_type_text(kind[0])}[]"
    return type_name(kind)
