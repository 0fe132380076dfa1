"""Which display is meant, and whether it is what the patterns need.

Owns the choice and the refusals, and what the kernel says of connectors (`/sys/class/drm`). It draws nothing.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fringed.errors import DeviceAbsent

_MADE_UP = ("dummy", "offscreen")


@dataclass(frozen=True)
class Screen:
    """One display as SDL has it; `hz` is 0 where nobody says."""

    index: int
    name: str
    size_px: tuple[int, int]
    hz: float

    def __str__(self) -> str:
        return f"{self.index} {self.name!r} {size_text(self.size_px)}"


@dataclass(frozen=True)
class Connector:
    """One plug of a graphics card as the kernel has it; the preferred mode comes first."""

    name: str
    connected: bool
    modes: tuple[tuple[int, int], ...]


def size_text(size_px: Sequence[int]) -> str:
    """Return a size for messages."""
    return " x ".join(str(n) for n in size_px)


def chosen(screens: Sequence[Screen], wanted: int | str, size_px: tuple[int, int], backend: str) -> Screen:
    """Return the display that is meant.

    Raises
    ------
    DeviceAbsent
        there is none of that index or name, two have that name, or its desktop is not as large as the panel.
    """
    seen = "; ".join(str(screen) for screen in screens) or "none"
    found = [screen for screen in screens if wanted in (screen.index, screen.name)]
    if not found:
        raise DeviceAbsent(
            f"there is no display {wanted!r}; {backend} has: {seen}. Plug it in and switch it on, or set "
            "projector.options.display to one of these indices or names"
        )
    if len(found) > 1:
        raise DeviceAbsent(
            f"{len(found)} displays are called {wanted!r}: {seen}. Set projector.options.display to an index"
        )
    screen = found[0]
    if screen.size_px != tuple(size_px) and backend not in _MADE_UP:
        raise DeviceAbsent(
            f"display {screen.index} {screen.name!r} has a desktop of {size_text(screen.size_px)}; the patterns need "
            f"{size_text(size_px)}, the panel's own size, without scaling. All displays: {seen}. Set this mode and "
            f"a scale of 1 (xrandr --output OUTPUT --mode {size_px[0]}x{size_px[1]} --scale 1x1), or choose "
            "another one with projector.options.display, or correct projector.options.size_px"
        )
    return screen


def require_8_bits(masks: Sequence[int], backend: str) -> None:
    """Refuse a desktop whose channels have another depth than 8 bits: levels would be rounded.

    Raises
    ------
    DeviceAbsent
        with the depths that were seen.
    """
    bits = [mask.bit_count() for mask in masks[:3]]
    if bits != [8, 8, 8]:
        raise DeviceAbsent(
            f"{backend} runs with {bits[0]}, {bits[1]} and {bits[2]} bits of red, green and blue; patterns need 8 of "
            "each: set the colour depth to 24 (X: DefaultDepth 24 in the Screen section)"
        )


def connectors(folder: Path) -> tuple[Connector, ...]:
    """Return the kernel's connectors, in the kernel's order; none where it has no graphics card."""
    paths = sorted(folder.glob("card*-*"), key=lambda path: (path.name.partition("-")[0], _number(path), path.name))
    return tuple(_connector(path) for path in paths)


def _number(path: Path) -> int:
    try:
        return int((path / "connector_id").read_text())
    except (OSError, ValueError):
        return 0


def _connector(path: Path) -> Connector:
    try:
        status = (path / "status").read_text().strip()
        lines = (path / "modes").read_text().split()
    except OSError:  # a dock that went while we looked
        return Connector(path.name, connected=False, modes=())
    return Connector(path.name, status == "connected", tuple(size for line in lines if (size := _mode(line))))


def _mode(line: str) -> tuple[int, int] | None:
    width, _, height = line.rstrip("i").partition("x")
    return (int(width), int(height)) if width.isdigit() and height.isdigit() else None


def watched(found: Sequence[Connector], wanted: str, screen: Screen) -> Connector | None:
    """Return the connector of a display: the one that is named, or for "auto" the one that can only be it.

    [A] that the kernel's "card0-HDMI-A-1" is X's "HDMI-1" or "HDMI-A-1" is a habit of drivers and no rule: where
    the names do not decide, the only connected one is taken, and with several none is watched.

    Raises
    ------
    DeviceAbsent
        there is no connector of the name that was given, or nothing is plugged into it.
    """
    if not wanted:
        return None
    if wanted != "auto":
        named = [one for one in found if one.name == wanted]
        if named and named[0].connected:
            return named[0]
        what = "nothing is plugged into" if named else "there is no"
        seen = ", ".join(f"{one.name} {'connected' if one.connected else 'empty'}" for one in found) or "none"
        raise DeviceAbsent(
            f"{what} connector {wanted!r}; the kernel has: {seen}. Plug the projector in and switch it on"
        )
    live = [one for one in found if one.connected]
    alike = [one for one in live if _plain(one.name.partition("-")[2]) == _plain(screen.name)]
    if len(alike) == 1:
        return alike[0]
    return live[0] if len(live) == 1 else None


def _plain(name: str) -> str:
    """Return "HDMI1" of "HDMI-A-1" and of "HDMI-1"."""
    return "".join(part for part in name.split("-") if part not in ("A", "D", "I"))


def doubts(connector: Connector | None, size_px: tuple[int, int], backend: str) -> tuple[str, ...]:
    """Return what cannot be excluded: that somebody between the window and the panel scales.

    Raises
    ------
    DeviceAbsent
        the panel does not have this size at all.
    """
    if connector is None or not connector.modes:
        if backend == "wayland":
            return ("a Wayland compositor may scale unseen: set projector.options.connector, or use kmsdrm or x11",)
        return ()
    if size_px not in connector.modes:
        offered = ", ".join(dict.fromkeys(size_text(mode) for mode in connector.modes[:8]))
        raise DeviceAbsent(
            f"the display on {connector.name} has no mode of {size_text(size_px)}; it has {offered}: a desktop of that "
            "size would be scaled. Correct projector.options.size_px, or choose another display"
        )
    if connector.modes[0] == size_px:
        return ()
    preferred = size_text(connector.modes[0])
    if backend == "wayland":
        raise DeviceAbsent(
            f"the display on {connector.name} prefers {preferred}; a Wayland desktop of {size_text(size_px)} is then "
            "scaled by the compositor. Use kmsdrm or x11, or set that size as the panel's if it is"
        )
    return (f"the display on {connector.name} prefers {preferred}: make sure {size_text(size_px)} is its panel's size",)


def hints(backend: str, environment: Mapping[str, str], dri: Path = Path("/dev/dri")) -> str:
    """Return what to do when SDL cannot use `backend`."""
    if backend == "kmsdrm":
        cards = sorted(dri.glob("card*"))
        if not cards:
            return f"there is no {dri}/card*: no graphics driver of the kernel is loaded, or the service may not see it"
        shut = [str(card) for card in cards if not os.access(card, os.R_OK | os.W_OK)]
        if shut:
            return f"no permission for {', '.join(shut)}: add the daemon's user to the group video, and log in again"
        return "another program (X, a compositor, a boot splash) holds the display: end it, and use a free console"
    if backend == "x11":
        return (
            f"no X server answers at DISPLAY={environment.get('DISPLAY', '')!r}: start it, set "
            "projector.options.x_display (such as ':0') and x_authority, and let the daemon's user in "
            "(xhost +si:localuser:USER)"
        )
    if backend == "wayland":
        return f"no compositor answers at WAYLAND_DISPLAY={environment.get('WAYLAND_DISPLAY', '')!r}"
    return "set projector.options.backend to kmsdrm, x11, wayland or dummy"


def is_connected(folder: Path) -> bool:
    """Tell whether a display is plugged into a connector's folder; one that has gone has none."""
    try:
        return (folder / "status").read_text().strip() == "connected"
    except OSError:
        return False
