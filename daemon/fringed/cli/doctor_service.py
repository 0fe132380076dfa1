"""`fringed doctor` on the service: unit, user, rules of udev, the names that they give.

Owns the advice; `fringed install-service` does what it says.
"""

from __future__ import annotations

import re
from pathlib import Path

from fringed.cli.doctor_devices import INSTALL
from fringed.cli.doctor_findings import Finding, Findings
from fringed.finding import Installed, Machine, cameras, installed, serial_ports
from fringed.finding.naming import named_ids
from fringed.finding.reading import entries, text

_GROUPS = ("dialout", "video", "render", "input", "tty")
_PROGRAM = re.compile(r"^ExecStart=(\S+)", re.M)
SYSTEMD = "run/systemd/system"


def service_findings(machine: Machine) -> Findings:
    """Yield what holds for rules, links and unit."""
    there = installed(machine.root)
    yield from _rules(machine, there)
    yield from _links(machine, there)
    yield from _unit(machine, there)


def _rules(machine: Machine, there: Installed) -> Findings:
    plugged = any(port.usb for port in serial_ports(machine.root, machine.listed)) or bool(cameras(machine.root))
    if there.rules:
        named = f", names in {there.names}" if there.names else "; no device is named"
        do = "" if there.names else "fringed devices lists ids for install-service --projector ID --camera ID"
        yield Finding("ok", "udev rules", f"{there.rules}{named}", do)
    elif plugged:
        yield Finding("warn", "udev rules", "not installed: names of adapters change with the order of plugging in",
                      f"{INSTALL}; fringed devices lists ids for --projector ID --camera ID")  # fmt: skip
    else:
        yield Finding("ok", "udev rules", "not installed; a simulated rig needs none", INSTALL)


def _links(machine: Machine, there: Installed) -> Findings:
    for name in there.dangling:
        yield Finding("warn", f"link {name}", "it leads nowhere: the device was unplugged and udev did not notice",
                      "plug the device in again, or: sudo udevadm trigger")  # fmt: skip
    if there.links:
        listed = ", ".join(f"{name} -> {node}" for name, node in there.links.items())
        yield Finding("ok", "udev links", listed)
    elif there.rules:
        yield Finding("ok", "udev links", "none in /dev/fringed: nothing that the rules know is plugged in",
                      "where something is: sudo udevadm control --reload && sudo udevadm trigger")  # fmt: skip
    if there.names:
        for role in named_ids(text(machine.root / there.names.lstrip("/"))):
            if not any(name.startswith(f"/dev/fringed/{role}") for name in there.links):
                yield Finding("warn", f"the {role}'s name", f"there is no /dev/fringed/{role}",
                              f"plug the {role} in; fringed devices shows its id, {there.names} the one that is "
                              "expected")  # fmt: skip


def _unit(machine: Machine, there: Installed) -> Findings:
    booted = (machine.root / SYSTEMD).is_dir()
    if not there.unit:
        about = "not installed: the station runs while somebody runs `fringed run`"
        yield Finding("ok", "service", about if booted else f"{about}; systemd does not run here", INSTALL)
        return
    state = "starts at boot" if there.enabled else "does not start at boot"
    do = "" if there.enabled else "sudo systemctl enable --now fringed"
    yield Finding("ok" if there.enabled else "warn", "service", f"{there.unit}, {state}", do)
    program = _PROGRAM.search(text(machine.root / there.unit.lstrip("/")))
    if program and not (machine.root / program[1].lstrip("/")).exists():
        yield Finding("fail", "service's program", f"{program[1]} is not there", f"{INSTALL} --force, from where it is")
    yield from _user(machine.root)


def _user(root: Path) -> Findings:
    names = {line.partition(":")[0] for line in text(root / "etc/passwd").splitlines()}
    if "fringed" not in names:
        yield Finding("fail", "service's user", "there is no user fringed", "sudo systemd-sysusers")
        return
    groups = {line.split(":")[0]: line.split(":")[-1].split(",") for line in text(root / "etc/group").splitlines()}
    missing = [group for group in _GROUPS if group not in groups]
    if missing:
        yield Finding("fail", "service's groups", f"there are no groups {', '.join(missing)}: the unit cannot start",
                      "sudo systemd-sysusers, or sudo groupadd --system GROUP")  # fmt: skip
    running = any(text(process / "comm").startswith("fringed") for process in entries(root / "proc", "[0-9]*"))
    yield Finding("ok", "service's user", "fringed is there" + ("; a fringed process runs" if running else ""))
