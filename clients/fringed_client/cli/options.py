"""Options that every command has, and how `key=value` options are read.

Owns the words of the command line; talks to nobody.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Options:
    """What every command is told."""

    station: str | None = None
    json: bool = False


def common(function: F) -> F:
    """Add --station, --json and --debug; the command gets them as `options`."""

    @click.option("--station", metavar="ADDRESS", help="Runtime folder or tcp://host:port. [env: FRINGED_STATION]")
    @click.option("--json", "as_json", is_flag=True, help="One JSON document on stdout, nothing else there.")
    @click.option("--debug", is_flag=True, help="Show tracebacks.")
    @functools.wraps(function)
    def wrapped(*args: Any, station: str | None, as_json: bool, debug: bool, **more: Any) -> Any:
        return function(*args, options=Options(station, as_json), **more)

    return wrapped  # type: ignore[return-value]


def value_of(text: str) -> Any:
    """Return a number, true, false, a list or a table where `text` is JSON, else the text itself."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def pairs(ctx: click.Context | None, parameter: click.Parameter, given: tuple[str, ...]) -> dict[str, Any]:
    """Return `key=value` options as a table."""
    table: dict[str, Any] = {}
    for item in given:
        key, sign, text = item.partition("=")
        if not sign or not key.strip():
            raise click.BadParameter(f"{item!r}; expected key=value, such as steps=6", ctx, parameter)
        table[key.strip()] = value_of(text.strip())
    return table


def staged(ctx: click.Context | None, parameter: click.Parameter, given: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Return `stage.key=value` options as a table of tables."""
    tables: dict[str, dict[str, Any]] = {}
    for key, value in pairs(ctx, parameter, given).items():
        stage, dot, name = key.partition(".")
        if not dot or not name:
            raise click.BadParameter(
                f"{key!r}; expected stage.key=value, such as phase.min_modulation_dn=8", ctx, parameter
            )
        tables.setdefault(stage, {})[name] = value
    return tables


def triple(ctx: click.Context | None, parameter: click.Parameter, given: str | None) -> tuple[float, ...] | None:
    """Return `x,y,z` as three numbers."""
    if given is None:
        return None
    try:
        numbers = tuple(float(part) for part in given.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3:
        raise click.BadParameter(f"{given!r}; expected three numbers, such as 0,25,0", ctx, parameter)
    return numbers
