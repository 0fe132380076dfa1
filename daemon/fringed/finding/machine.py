"""A machine to look at: this one, or a copy of what it would show.

Owns the question to pyserial, which knows ports of systems without /sys.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fringed.finding.permissions import User, current_user

SLASH = Path("/")


@dataclass(frozen=True)
class Machine:
    """Where to look, for whom, and in which environment; `listed` are ports as pyserial names and describes them."""

    root: Path
    user: User
    environment: Mapping[str, str] = field(default_factory=dict)
    listed: tuple[tuple[str, str], ...] = ()


def this_machine(root: Path | None = None) -> Machine:
    """Return this machine; with `root`, the copy of one that lies there, seen by the present user."""
    if root is not None and root.resolve() != SLASH:
        return Machine(root.resolve(), current_user())
    return Machine(SLASH, current_user(), dict(os.environ), _listed())


def _listed() -> tuple[tuple[str, str], ...]:
    try:
        from serial.tools import list_ports
    except ImportError:
        return ()
    return tuple((port.device, port.description or "") for port in list_ports.comports())
