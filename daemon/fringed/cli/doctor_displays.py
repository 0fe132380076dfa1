"""`fringed doctor` on what shows the patterns: displays, graphics cards, pygame's drivers, the X server.

Owns the advice. SDL is asked in a process of its own, and only for the names of its drivers: no video is started.
"""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from collections.abc import Callable

from fringed.cli.doctor_devices import how_to_get_access
from fringed.cli.doctor_findings import Finding, Findings
from fringed.finding import Connector, Machine, access, connectors, holders
from fringed.finding.displays import cards

_ASK_SDL = """
import ctypes, pygame
lines = open("/proc/self/maps").read().splitlines()
library = ctypes.CDLL(next(line.split()[-1] for line in lines if "libSDL2-2" in line or "libSDL2.so" in line))
library.SDL_GetVideoDriver.restype = ctypes.c_char_p
print(*(library.SDL_GetVideoDriver(k).decode().lower() for k in range(library.SDL_GetNumVideoDrivers())))
"""
_ASK_TIMEOUT_S = 30.0
SdlDrivers = Callable[[], tuple[str, ...]]


def display_findings(
    machine: Machine, panel_px: tuple[int, int], sdl_drivers: SdlDrivers | None = None, pygame: str | None = None
) -> Findings:
    """Yield what holds for displays; `panel_px` is the size that the projector's patterns have."""
    found = connectors(machine.root)
    yield from _connectors(found, f"{panel_px[0]}x{panel_px[1]}")
    yield from _session(machine)
    yield from _cards(machine)
    yield from _sdl((sdl_drivers or video_drivers)(), pygame_conflict() if pygame is None else pygame)


def video_drivers() -> tuple[str, ...]:
    """Return the names of the video drivers that pygame's SDL was built with, in small letters; none without pygame."""
    environment = {"PYGAME_HIDE_SUPPORT_PROMPT": "1", "PATH": ""}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _ASK_SDL], capture_output=True, text=True, check=False, env=environment,
            timeout=_ASK_TIMEOUT_S,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return ()
    return tuple(done.stdout.split()) if done.returncode == 0 else ()


def pygame_conflict() -> str:
    """Return the version of `pygame` where it is installed: it and `pygame-ce` overwrite each other's files."""
    try:
        return importlib.metadata.version("pygame")
    except importlib.metadata.PackageNotFoundError:
        return ""


def _connectors(found: list[Connector], wanted: str) -> Findings:
    connected = [item for item in found if item.connected]
    if found and not connected:
        names = ", ".join(f"{item.card}-{item.name}" for item in found)
        yield Finding("warn", "displays", f"nothing is connected to {names}",
                      "connect the projector and switch it on before the station starts")  # fmt: skip
    elif not found:
        yield Finding("ok", "displays", "the kernel lists no connector; a simulated rig needs none")
    for item in connected:
        what = f"display {item.card}-{item.name}"
        modes = ", ".join(item.modes[:4]) + (", …" if len(item.modes) > 4 else "")
        about = f"{item.display or 'unnamed'}, id {item.id}, {modes or 'no modes'}" + ("" if item.enabled else "; off")
        if wanted in item.modes:
            yield Finding("ok", what, about)
        else:
            yield Finding("warn", what, f"{about}: no {wanted}, which is the size of the patterns",
                          "patterns would be scaled: use a display that has this mode, or set "
                          "the size in projector.options to its own")  # fmt: skip


def _session(machine: Machine) -> Findings:
    shown = {name: machine.environment[name] for name in ("DISPLAY", "WAYLAND_DISPLAY")
             if machine.environment.get(name)}  # fmt: skip
    if not shown:
        yield Finding("ok", "DISPLAY", "neither DISPLAY nor WAYLAND_DISPLAY is set: windows would need KMS")
        return
    about = ", ".join(f"{name}={value}" for name, value in shown.items())
    display = shown.get("DISPLAY", "")
    number = display.removeprefix(":").partition(".")[0]
    if display.startswith(":") and not (machine.root / "tmp/.X11-unix" / f"X{number}").exists():
        yield Finding("warn", "DISPLAY", f"{about}; there is no socket /tmp/.X11-unix/X{number}: no X server serves it",
                      "start the X server, correct DISPLAY, or unset it to use KMS")  # fmt: skip
    else:
        yield Finding("ok", "DISPLAY", about)


def _cards(machine: Machine) -> Findings:
    there = cards(machine.root)
    if not there:
        yield Finding("ok", "KMS", "no graphics card in /dev/dri: only X or a simulated rig")
    for node in there:
        rights = access(machine.root, node, machine.user)
        if rights is None:
            continue
        masters = [holder for holder in holders(machine.root, node) if holder.pid != 1]
        if not rights.usable:
            yield Finding("warn", f"KMS {node}", f"{rights}: not usable by {machine.user.name}",
                          how_to_get_access(machine, rights.group, rights.mode))  # fmt: skip
        elif masters and not machine.environment.get("DISPLAY") and not machine.environment.get("WAYLAND_DISPLAY"):
            yield Finding("warn", f"KMS {node}", f"{rights}; open in {', '.join(map(str, masters))}",
                          "one program draws at a time: run the station in that session, or end it "
                          "(sudo systemctl isolate multi-user.target)")  # fmt: skip
        else:
            yield Finding("ok", f"KMS {node}", f"{rights}: usable")


def _sdl(drivers: tuple[str, ...], pygame: str) -> Findings:
    again = "pip uninstall pygame; pip install --force-reinstall pygame-ce"
    if not drivers:
        yield Finding("warn", "pygame's drivers", "pygame cannot be imported, or does not tell them", again)
    elif "kmsdrm" not in drivers:
        yield Finding("warn", "pygame's drivers", f"{', '.join(drivers)}: no KMSDRM, so a window needs an X server",
                      again)  # fmt: skip
    else:
        yield Finding("ok", "pygame's drivers", f"{', '.join(drivers)}: KMSDRM is there, no X server is needed")
    if pygame:
        yield Finding("warn", "pygame", f"pygame {pygame} is installed beside pygame-ce: they share their files", again)
