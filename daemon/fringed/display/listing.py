"""`python -m fringed.display --list [BACKEND]`: the displays that SDL has, and the kernel's connectors.

For a lab that looks for the right index or name, and for whoever diagnoses. It opens no window.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import msgspec

from fringed.display import environment, screens
from fringed.display.screens import Connector, Screen
from fringed.errors import DeviceAbsent


class Listing(msgspec.Struct, frozen=True):
    """What there is; `problem` says why SDL has no displays."""

    backend: str
    displays: tuple[Screen, ...] = ()
    connectors: tuple[Connector, ...] = ()
    problem: str = ""


def listing(wanted: str, drm_folder: str = "/sys/class/drm") -> Listing:
    """Return what there is in this process's session; starts and ends SDL."""
    backend = environment.backend(wanted, os.environ)
    os.environ.update(environment.ENVIRONMENT, SDL_VIDEODRIVER=backend)
    from fringed.display import sdl

    plugs = screens.connectors(Path(drm_folder))
    try:
        sdl.start(backend)
        found = sdl.screens()
    except DeviceAbsent as error:
        return Listing(backend, connectors=plugs, problem=error.message)
    finally:
        sdl.stop()
    return Listing(backend, found, plugs)


def main(argv: list[str]) -> int:
    """Print it, as text or with `--json` as JSON; return the exit status."""
    words = [word for word in argv if word != "--json"]
    found = listing(words[0] if words else "auto")
    if "--json" in argv:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
        return 0
    lines = [f"backend {found.backend}", *(f"display {one}, {one.hz:g} Hz" for one in found.displays)]
    for plug in found.connectors:
        modes = ", ".join(screens.size_text(mode) for mode in plug.modes[:4])
        lines.append(f"connector {plug.name} {'connected' if plug.connected else 'empty'} {modes}".rstrip())
    sys.stdout.write("\n".join([*lines, *([found.problem] if found.problem else [])]) + "\n")
    return 1 if found.problem else 0
