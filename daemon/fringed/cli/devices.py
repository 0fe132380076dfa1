"""`fringed devices`: ports, displays and cameras, each with a name that stays and an id that tells it from its like.

Owns the printing; what is there, `fringed.finding` reads.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import click

from fringed.errors import EXIT_OK, UsageError
from fringed.finding import (
    Access,
    Connector,
    FoundCamera,
    Holder,
    Machine,
    SerialPort,
    UsbDevice,
    access,
    cameras,
    connectors,
    holders,
    installed,
    serial_ports,
    this_machine,
)  # fmt: skip

_EMPTY = {
    "serial ports": "none: plug the adapter in; `fringed doctor` says what else can be wrong",
    "displays": "none: this machine has no graphics card that the kernel lists",
    "cameras": "none on USB; cameras on the network are not looked for",
}


def list_devices(root: Path | None, as_json: bool) -> int:
    """Print every device; raises UsageError where `root` is no folder."""
    if root is not None and not root.is_dir():
        raise UsageError(f"--root {root}: no such folder; expected one with the folders sys, dev and proc of a machine")
    found = look(this_machine(root))
    if as_json:
        click.echo(json.dumps(found, indent=2))
        return EXIT_OK
    for title, key in (("serial ports", "serial_ports"), ("displays", "displays"), ("cameras", "cameras")):
        click.echo(click.style(title, bold=True))
        for line in _lines(found[key]) if found[key] else [f"  {_EMPTY[title]}"]:
            click.echo(line)
    if found["links"]:
        click.echo(click.style("names", bold=True))
        for name, node in found["links"].items():
            click.echo(f"  {name} -> {node}")
    return EXIT_OK


def look(machine: Machine) -> dict[str, Any]:
    """Return what `fringed devices --json` prints."""
    root = machine.root
    return {
        "serial_ports": [_port(machine, port) for port in serial_ports(root, machine.listed)],
        "displays": [_display(machine, item) for item in connectors(root)],
        "cameras": [_camera(machine, camera) for camera in cameras(root)],
        "links": installed(root).links,
    }


def _port(machine: Machine, port: SerialPort) -> dict[str, Any]:
    return {
        "id": port.id, "node": port.node, "stable_name": port.stable, "names": list(port.links),
        "setting": port.setting, "description": port.description, "driver": port.driver, "usb": _usb(port.usb),
        "interface": port.interface, "id_is_the_port_because": port.by_port, "latency_ms": port.latency_ms,
        "access": _access(access(machine.root, port.node, machine.user)),
        "open_by": _holders(holders(machine.root, port.node)),
    }  # fmt: skip


def _display(machine: Machine, item: Connector) -> dict[str, Any]:
    return {
        "id": item.id, "node": item.node, "stable_name": f"{item.card}-{item.name}", "names": [],
        "description": item.display or ("a display" if item.connected else "nothing"), "driver": item.driver,
        "connected": item.connected, "enabled": item.enabled, "modes": list(item.modes),
        "access": _access(access(machine.root, item.node, machine.user)),
    }  # fmt: skip


def _camera(machine: Machine, camera: FoundCamera) -> dict[str, Any]:
    return {
        "id": camera.id, "node": camera.node, "stable_name": camera.stable, "names": list(camera.links),
        "kind": camera.kind, "description": camera.description, "usb": _usb(camera.usb),
        "id_is_the_port_because": camera.by_port, "access": _access(access(machine.root, camera.node, machine.user)),
        "open_by": _holders(holders(machine.root, camera.node)),
    }  # fmt: skip


def _usb(device: UsbDevice | None) -> dict[str, Any] | None:
    if device is None:
        return None
    return {
        "vendor_id": device.vendor_id, "product_id": device.product_id, "serial": device.serial,
        "manufacturer": device.manufacturer, "product": device.product, "port": device.port, "path": device.path,
        "speed_mbps": device.speed_mbps,
    }  # fmt: skip


def _access(found: Access | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"usable": found.usable, "owner": found.owner, "group": found.group, "mode": found.mode,
            "access_list": found.has_acl}  # fmt: skip


def _holders(found: Iterable[Holder]) -> list[dict[str, Any]]:
    return [{"process": holder.pid, "program": holder.program} for holder in found]


def _lines(items: list[dict[str, Any]]) -> Iterator[str]:
    width = max(len(item["id"]) for item in items)
    for item in items:
        yield f"  {item['id']:{width}}  {item['node']}  {item['description']}"
        for detail in _details(item):
            yield f"  {'':{width}}  {detail}"


def _details(item: dict[str, Any]) -> Iterator[str]:
    if "connected" in item:
        state = f"connected, {', '.join(item['modes'][:4]) or 'no modes'}" if item["connected"] else "nothing connected"
        yield f"{item['stable_name']}: {state}"
    elif item["stable_name"] != item["node"]:
        yield f"always {item['stable_name']}"
    if item.get("setting", item["node"]) != item["node"]:
        yield f"in a configuration: {item['setting']}"
    if item.get("usb"):
        speed = f", {item['usb']['speed_mbps']:g} Mbit/s" if item["usb"]["speed_mbps"] else ""
        yield f"USB port {item['usb']['port']}{speed}" + (f" ({item['usb']['path']})" if item["usb"]["path"] else "")
    if item.get("id_is_the_port_because"):
        yield f"told by its port, because {item['id_is_the_port_because']}: keep it in this socket"
    rights = item["access"]
    if rights is not None and not rights["usable"]:
        yield f"this user may not open it: {rights['mode']} {rights['owner']}:{rights['group']}"
    for holder in item.get("open_by", ()):
        yield f"open in {holder['program'] or 'a program'} (process {holder['process']})"
