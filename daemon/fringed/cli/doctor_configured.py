"""`fringed doctor` on what the configuration names: is the port there, does the service reach the network.

Owns only options that all our drivers spell alike: `port` and `host`. Nothing is opened, no name is resolved.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fringed.cli.doctor_findings import Finding, Findings
from fringed.config import StationConfig
from fringed.errors import FringedError
from fringed.finding import Machine, installed
from fringed.finding.reading import entries, text

_ALLOW = re.compile(r"^\s*IPAddressAllow=(.*)$", re.M)
_LOCAL = ("localhost", "127.0.0.1", "::1")
PANEL_PX = (1024, 768)
FindPort = Callable[[str], str]


def configured_findings(config: StationConfig, machine: Machine, find_port: FindPort | None = None) -> Findings:
    """Yield what holds for the ports and hosts of the configuration."""
    for kind, options in (("projector", config.projector.options), ("camera", config.camera.options)):
        if isinstance(options.get("port"), str) and options["port"]:
            yield _port(kind, options["port"], find_port or _find_port)
        if isinstance(options.get("host"), str) and options["host"]:
            yield from _reach(machine, f"host of the {kind}", options["host"])
    if config.tcp is not None:
        yield from _reach(machine, "clients over TCP", config.tcp.bind)


def panel_px(options: Mapping[str, Any]) -> tuple[int, int]:
    """Return width and height of the projector's patterns: the driver's option, or the CP-X260's panel."""
    for name in ("panel_px", "size_px"):
        match options.get(name):
            case [int(width), int(height)]:
                return width, height
    return PANEL_PX


def _find_port(name: str) -> str:
    from fringed.transports.serial_finding import find_port

    return find_port(name)


def _port(kind: str, name: str, find_port: FindPort) -> Finding:
    what = f"port of the {kind}"
    try:
        found = find_port(name)
    except FringedError as error:
        return Finding("warn", what, error.message, "fringed devices lists what is plugged in, and how to name it")
    there = f"{name}: {Path(found).resolve()}" if Path(found).resolve() != Path(name) else name
    return Finding("ok", what, there)


def _reach(machine: Machine, what: str, host: str) -> Findings:
    """Say whether the service's unit lets it speak with `host`; nothing where no service is installed."""
    unit = installed(machine.root).unit
    if not unit or host in _LOCAL:
        return
    drop_ins = entries(machine.root / "etc/systemd/system/fringed.service.d", "*.conf")
    files = [machine.root / unit.lstrip("/"), *drop_ins]
    allowed = [word for file in files for line in _ALLOW.findall(text(file)) for word in line.split()]
    if any(_covers(network, host) for network in allowed):
        yield Finding("ok", what, f"{host}: the service may reach it")
    else:
        yield Finding("warn", what, f"{host}: the service may only reach {', '.join(allowed) or 'nothing'}",
                      "sudo systemctl edit fringed: under [Service], IPAddressAllow= with that network; then restart "
                      "it")  # fmt: skip


def _covers(network: str, host: str) -> bool:
    """Tell whether a network covers an address; of a name nobody knows, so any network beside this machine does."""
    if network == "any":
        return True
    try:
        wide = ipaddress.ip_network(network, strict=False)
    except ValueError:
        return False
    try:
        address = ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return not wide.is_loopback
    if address.is_unspecified:
        return not wide.is_loopback
    return address in wide
