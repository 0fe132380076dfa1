"""The rules that give this lab's devices their names: /dev/fringed/projector and /dev/fringed/camera.

Owns the text of 61-fringed-names.rules, which builds on what 60-fringed.rules found out; what an id is, `fringed
devices` prints.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from fringed.errors import UsageError
from fringed.finding.usb import PLAIN_SERIAL

ROLES = ("projector", "camera")
SERVICE = "fringed.service"
_PORT = re.compile(r"\d+-\d+(\.\d+)*")
_PATH = re.compile(r"(?:pci|platform)-[A-Za-z0-9:._-]+-usb-0:\d+(\.\d+)*")
_INTERFACE = re.compile(r"(.+)-if([0-9a-f]{2})")
_HEAD = """\
# The devices of this lab by name. Written by `fringed install-service`; to change it, run that again.
# ids: {ids}
"""
_IDS = re.compile(r"^# ids: (.*)$", re.M)


def name_rules(ids: Mapping[str, str]) -> str:
    """Return the rules for `ids` (role to id: a serial number, a USB port or its path, each with `-ifNN` or without).

    Raises
    ------
    UsageError
        an id that no rule can match, a role that is none, or one id for two roles.
    """
    if len(set(ids.values())) < len(ids):
        raise UsageError(
            f"{' and '.join(ids)} have the same id {next(iter(ids.values()))!r}; each needs its own, "
            f"as `fringed devices` lists them (an adapter with two ports: NUMBER-if00 and NUMBER-if01)"
        )
    head = _HEAD.format(ids=" ".join(f"{role}={identity}" for role, identity in ids.items()))
    return "\n".join([head, *(_rules(role, identity) for role, identity in ids.items())])


def named_ids(rules: str) -> dict[str, str]:
    """Return the ids, by role, that a file of rules was written for; none where it is none of ours."""
    line = _IDS.search(rules)
    pairs = [word.partition("=") for word in line[1].split()] if line else []
    return {role: identity for role, _, identity in pairs if role in ROLES and identity}


def _rules(role: str, identity: str) -> str:
    if role not in ROLES:
        raise UsageError(f"{role!r} is no role; expected one of {', '.join(ROLES)}")
    match = _INTERFACE.fullmatch(identity)
    name, interface = (match[1], match[2]) if match else (identity, "")
    tty, usb, kind = _matches(role, name)
    tty += f', ENV{{.FRINGED_INTERFACE}}=="{interface}"' if interface else ""
    wants = f'TAG+="systemd", ENV{{SYSTEMD_WANTS}}+="{SERVICE}"'
    lines = [
        f"# {role}: {kind} {identity}; its serial line, and plugging it in starts the service.",
        f'ACTION!="remove", SUBSYSTEM=="tty", {tty}, SYMLINK+="fringed/{role}", GROUP="dialout", MODE="0660", '
        f'TAG+="uaccess", {wants}',
    ]
    if role == "camera" and not interface:
        lines += [
            "# The same camera where its pictures come through libusb or V4L2.",
            f'ACTION!="remove", SUBSYSTEM=="usb", ENV{{FRINGED_U3V}}=="1", {usb}, '
            f'SYMLINK+="fringed/camera-usb", {wants}',
            f'ACTION!="remove", SUBSYSTEM=="video4linux", ATTR{{index}}=="0", {_above(name)}, '
            f'SYMLINK+="fringed/camera-video", {wants}',
        ]
    return "\n".join(lines) + "\n"


def _matches(role: str, name: str) -> tuple[str, str, str]:
    """Return how a tty and a USB device with this id are matched, and what the id is."""
    if _PORT.fullmatch(name):
        return f'ENV{{.FRINGED_PORT}}=="{name}"', f'KERNEL=="{name}"', "USB port"
    if _PATH.fullmatch(name):
        return f'ENV{{ID_PATH}}=="{name}:*"', f'ENV{{ID_PATH}}=="{name}"', "USB path"
    if PLAIN_SERIAL.fullmatch(name):
        return f'ENV{{.FRINGED_SERIAL}}=="{name}"', f'ATTR{{serial}}=="{name}"', "serial number"
    raise UsageError(
        f"the {role}'s id {name!r} cannot be matched by udev; expected a serial number (letters, digits and ._+@=-), "
        f"a USB port such as 1-3.2, or a USB path such as pci-0000:00:14.0-usb-0:3.2, as `fringed devices` lists them"
    )


def _above(name: str) -> str:
    if _PORT.fullmatch(name):
        return f'KERNELS=="{name}"'
    if _PATH.fullmatch(name):
        return f'ENV{{ID_PATH}}=="{name}:*"'
    return f'ATTRS{{serial}}=="{name}"'
