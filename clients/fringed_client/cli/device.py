"""`fringe device`: a device's own settings, with units and limits."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import click

from fringed_client.cli import output
from fringed_client.cli.options import Options, common

_DEVICE = click.argument("device", type=click.Choice(["camera", "projector"]))


@click.group("device")
def device_command() -> None:
    """Read, set and watch what the camera and the projector have of their own."""


@device_command.command("get")
@_DEVICE
@click.argument("names", nargs=-1, metavar="[NAME]...")
@common
def _get(device: str, names: tuple[str, ...], options: Options) -> None:
    """List the settings of a device, or some of them."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        _show(_chosen(station.device_settings(device), names), options)


@device_command.command("set")
@_DEVICE
@click.argument("name")
@click.argument("value")
@common
def _set(device: str, name: str, value: str, options: Options) -> None:
    """Set one; the others are asked again, for one may have changed another."""
    from fringed_client.station import Station

    with Station(options.station) as station:
        _show(_chosen(station.set_device(device, name, value), (name,)), options)


@device_command.command("watch")
@_DEVICE
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--every", default=2.0, show_default=True, type=click.FloatRange(min=0.2), help="Seconds.")
@click.option("--count", type=click.IntRange(min=1), help="How often; until Ctrl-C by default.")
@common
def _watch(device: str, names: tuple[str, ...], every: float, count: int | None, options: Options) -> None:
    """Tell what changes."""
    from fringed_client.station import Station

    known: dict[str, Any] = {}
    asked = 0
    with Station(options.station) as station:
        while count is None or asked < count:
            if asked:
                time.sleep(every)
            asked += 1
            for setting in _chosen(station.device_settings(device), names):
                name = setting["name"]
                if name not in known or known[name] != setting["value"]:
                    known[name] = setting["value"]
                    _tell(setting, options)


def _chosen(found: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[Mapping[str, Any]]:
    from fringed.errors import UsageError

    by_name = {str(setting["name"]): setting for setting in found}
    unknown = [name for name in names if name not in by_name]
    if unknown:
        raise UsageError(f"there is no setting {', '.join(unknown)}; there are {', '.join(by_name)}")
    return [by_name[name] for name in names] if names else list(found)


def _show(found: Sequence[Mapping[str, Any]], options: Options) -> None:
    if options.json:
        output.emit(list(found))
        return
    rows = [(s["name"], _value(s), _allowed(s), _remark(s)) for s in found]
    output.table(("setting", "value", "allowed", ""), rows)


def _tell(setting: Mapping[str, Any], options: Options) -> None:
    if options.json:
        output.emit(dict(setting))
    else:
        output.facts({str(setting["name"]): _value(setting)})


def _value(setting: Mapping[str, Any]) -> str:
    value = setting["value"]
    if isinstance(value, bool):
        return "on" if value else "off"
    text = "unknown" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
    return f"{text} {setting['unit']}".strip()


def _allowed(setting: Mapping[str, Any]) -> str:
    if not setting["writable"]:
        return "read only"
    if setting["choices"]:
        return ", ".join(setting["choices"])
    if isinstance(setting["value"], bool):
        return "on, off"
    least, most = setting["least"], setting["most"]
    return " ".join(["" if least is None else f"{least:g}", "to", "" if most is None else f"{most:g}"]).strip()


def _remark(setting: Mapping[str, Any]) -> str:
    return str(setting["help"]) + ("" if setting["verified"] else " (not confirmed on this model)")
