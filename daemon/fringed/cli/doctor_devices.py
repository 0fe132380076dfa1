"""`fringed doctor` on serial ports and cameras: who may open them, who has them, how fast they answer.

Owns the advice; what is there, `fringed.finding` reads. Nothing is opened.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from fringed.cli.doctor_findings import Finding, Findings
from fringed.finding import (
    FoundCamera,
    Machine,
    SerialPort,
    access,
    cameras,
    connectors,
    holders,
    installed,
    serial_ports,
)  # fmt: skip
from fringed.finding.cameras import U3V
from fringed.finding.displays import cards
from fringed.finding.installed import other_rules
from fringed.finding.reading import entries, number, text

USBFS = "sys/module/usbcore/parameters/usbfs_memory_mb"
USBFS_MB, SUPER_SPEED_MBPS, LATENCY_MS = 256, 5000.0, 1
INSTALL = f"sudo {Path(sys.prefix) / 'bin' / 'fringed'} install-service --yes"


def device_findings(machine: Machine) -> Findings:
    """Yield what holds for serial ports and cameras."""
    ports, seen = serial_ports(machine.root, machine.listed), cameras(machine.root)
    yield from _ports(machine, ports)
    yield from _cameras(machine, seen)
    yield from _groups(machine, [*(port.node for port in ports), *(camera.node for camera in seen)])
    yield from _meddlers(machine, ports)


def how_to_get_access(machine: Machine, group: str, mode: str) -> str:
    """Return what lets the user open a node of `group`."""
    if group in machine.user.to_be():
        return f"log out and in again: {machine.user.name} is in the group {group} from the next login on"
    if group == "root" or mode[-2] not in "67":
        return f"no group may open it: {INSTALL} sets a group by rules of udev, then plug it in again"
    return f"sudo usermod -aG {group} {machine.user.name}, then log in again"


def _ports(machine: Machine, ports: list[SerialPort]) -> Findings:
    if not ports:
        yield Finding("ok", "serial ports", "none; a simulated rig needs none, a projector's line needs an adapter")
        return
    yield Finding("ok", "serial ports", ", ".join(port.node for port in ports))
    for port in ports:
        yield _port(machine, port)
        if port.latency_ms is not None and port.latency_ms > LATENCY_MS:
            yield Finding(
                "warn", f"latency timer of {port.node}", f"{port.latency_ms} ms: replies are held back so long",
                f"{INSTALL} sets {LATENCY_MS} ms for good; for now: echo {LATENCY_MS} | sudo tee {port.latency_file}",
            )  # fmt: skip
    for port in ports:
        if port.by_port:
            yield Finding("ok", f"name of {port.node}", f"told by its USB port {port.id}, because {port.by_port}",
                          "keep it in this socket, or give the station adapters with serial numbers")  # fmt: skip


def _port(machine: Machine, port: SerialPort) -> Finding:
    what, about = f"serial port {port.node}", f"{port.description}, id {port.id}"
    return _opened(machine, what, about, port.node)


def _opened(machine: Machine, what: str, about: str, node: str) -> Finding:
    rights = access(machine.root, node, machine.user)
    if rights is None:
        return Finding("warn", what, f"{about}; the kernel knows it, but {node} is not there",
                       "start udev, or plug it in again; in a container, pass the device in")  # fmt: skip
    if not rights.usable:
        return Finding("warn", what, f"{about}; {rights}: not usable by {machine.user.name}",
                       how_to_get_access(machine, rights.group, rights.mode))  # fmt: skip
    others = holders(machine.root, node)
    if others:
        return Finding("ok", what, f"{about}; {rights}; open in {', '.join(map(str, others))}",
                       "where that is not the station, stop it: a port serves one program")  # fmt: skip
    return Finding("ok", what, f"{about}; {rights}: usable")


def _cameras(machine: Machine, seen: list[FoundCamera]) -> Findings:
    if not seen:
        yield Finding("ok", "cameras", "none on USB; a simulated rig needs none, the network is not searched")
    for camera in seen:
        yield _opened(machine, f"camera {camera.id}", f"{camera.kind} {camera.description}, {camera.node}", camera.node)
        if camera.kind == U3V and camera.usb and 0 < camera.usb.speed_mbps < SUPER_SPEED_MBPS:
            yield Finding("warn", f"speed of camera {camera.id}", f"{camera.usb.speed_mbps:g} Mbit/s",
                          f"plug it into a USB 3 socket with a USB 3 cable: {SUPER_SPEED_MBPS:g} Mbit/s")  # fmt: skip
    yield from _usb_memory(machine, any(camera.kind == U3V for camera in seen))


def _usb_memory(machine: Machine, needed: bool) -> Findings:
    limit_mb = number(machine.root / USBFS)
    if limit_mb is None:
        yield Finding("ok", "USB memory", "this kernel has no USB, or hides it")
    elif needed and 0 < limit_mb < USBFS_MB:
        yield Finding("warn", "USB memory", f"{limit_mb} MB for all USB transfers together: frames will be cut off",
                      f"echo {USBFS_MB} | sudo tee /{USBFS}; {INSTALL} makes it last")  # fmt: skip
    else:
        yield Finding("ok", "USB memory", f"{limit_mb} MB" if limit_mb else "0: without a limit")


def _groups(machine: Machine, nodes: Iterable[str]) -> Findings:
    """Say once which groups are missing, of those that present devices have."""
    there = [*nodes, *(item.node for item in connectors(machine.root)), *cards(machine.root)]
    rights = [found for node in there if (found := access(machine.root, node, machine.user)) is not None]
    missing = sorted({item.group for item in rights if not item.usable and item.group != "root"})
    name = machine.user.name
    inside = ", ".join(sorted(machine.user.groups))
    if not missing:
        yield Finding("ok", "groups", f"{name} is in {inside}: enough for what is plugged in")
        return
    late = [group for group in missing if group in machine.user.to_be()]
    rest = [group for group in missing if group not in late]
    steps = [f"sudo usermod -aG {','.join(rest)} {name}"] if rest else []
    yield Finding("warn", "groups", f"{name} is in {inside}; what is plugged in belongs to {', '.join(missing)}",
                  ", then ".join([*steps, "log out and in again"]))  # fmt: skip


def _meddlers(machine: Machine, ports: list[SerialPort]) -> Findings:
    """Name programs that take serial adapters for something else."""
    if not any(port.usb for port in ports):
        return
    braille = other_rules(machine.root, "brltty")
    if braille:
        yield Finding("warn", "brltty", f"{', '.join(braille)}: it takes some serial adapters for braille displays",
                      "unless somebody here needs it: sudo apt remove brltty")  # fmt: skip
    running = {text(process / "comm") for process in entries(machine.root / "proc", "[0-9]*")}
    if "ModemManager" in running and not installed(machine.root).rules:
        yield Finding("warn", "ModemManager", "it sends AT commands to serial adapters that are plugged in",
                      f"{INSTALL} tells it to leave them alone; or: sudo systemctl disable --now ModemManager",
                      )  # fmt: skip
