"""The commands of HITACHI projectors: one table, with how surely each is known.

Owns the codes; knows nothing of frames, ports or time. Nothing here is confirmed on a CP-X260: its own table was
not found. SIBLINGS are published for the CP-X255, CP-X265, CP-X275 or ED-A100. FAMILY are published for later
models of the family only (such as the CP-X2510), with the same codes throughout. A laboratory that finds another
code on its CP-X260 corrects it here and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum

from fringed.errors import UsageError


class Action(IntEnum):
    """What a command does with its setting."""

    SET = 1
    GET = 2
    INCREMENT = 4
    DECREMENT = 5
    EXECUTE = 6


class Source(Enum):
    """How surely a code is known; neither means confirmed on the CP-X260."""

    SIBLINGS = "published for the CP-X255, CP-X265, CP-X275 or ED-A100"
    FAMILY = "published for later models of the family only"


@dataclass(frozen=True)
class Command:
    """One command: action, type and setting, each 16 bits."""

    action: int
    type: int
    setting: int = 0


@dataclass(frozen=True)
class Entry:
    """A row of the table. `allowed` are the values that a get may answer; None for any."""

    command: Command
    source: Source = Source.SIBLINGS
    allowed: tuple[int, ...] | None = None


POWER, INPUT, ERRORS = 0x6000, 0x2000, 0x6020
BLANK, BLANK_COLOUR, FREEZE = 0x3020, 0x3000, 0x3002
BRIGHTNESS, BRIGHTNESS_RESET, CONTRAST, CONTRAST_RESET = 0x2003, 0x7000, 0x2004, 0x7001
GAMMA, PICTURE_MODE = 0x30A1, 0x30BA
KEYSTONE, KEYSTONE_RESET, MAGNIFY = 0x2007, 0x700C, 0x3007
FRAME_LOCK_1, FRAME_LOCK_2 = 0x3050, 0x3054
AUTO_ADJUST, LAMP_HOURS, FILTER_HOURS = 0x200A, 0x1090, 0x10A0

POWER_OFF, POWER_ON, POWER_COOLING = 0, 1, 2
GAMMA_1_DEFAULT, PICTURE_NORMAL, COLOUR_BLACK = 0x20, 0, 6
INPUTS: Mapping[str, int] = {"rgb1": 0, "rgb2": 4}
INPUT_CODES = (0, 1, 2, 3, 4, 5, 6)  # video, S-video, component … : where a projector may stand when we meet it
ERROR_TEXTS: Mapping[int, str] = {
    0: "normal", 1: "the cover is open", 2: "a fan has failed", 3: "the lamp has failed",
    4: "it is too hot", 5: "the air flow is blocked", 6: "the lamp is past its time", 7: "it is too cold",
    8: "the filter is clogged or due", 0x0C: "the lens door is closed",
}  # fmt: skip

_F = Source.FAMILY
TABLE: Mapping[str, Entry] = {
    "power off": Entry(Command(Action.SET, POWER, POWER_OFF)),
    "power on": Entry(Command(Action.SET, POWER, POWER_ON)),
    "power get": Entry(Command(Action.GET, POWER), allowed=(POWER_OFF, POWER_ON, POWER_COOLING)),
    "input rgb1": Entry(Command(Action.SET, INPUT, INPUTS["rgb1"])),
    "input rgb2": Entry(Command(Action.SET, INPUT, INPUTS["rgb2"])),
    "input get": Entry(Command(Action.GET, INPUT), allowed=INPUT_CODES),
    "error get": Entry(Command(Action.GET, ERRORS)),
    "blank on": Entry(Command(Action.SET, BLANK, 1)),
    "blank off": Entry(Command(Action.SET, BLANK, 0)),
    "blank get": Entry(Command(Action.GET, BLANK), allowed=(0, 1)),
    "blank colour black": Entry(Command(Action.SET, BLANK_COLOUR, COLOUR_BLACK)),
    "blank colour get": Entry(Command(Action.GET, BLANK_COLOUR)),
    "freeze on": Entry(Command(Action.SET, FREEZE, 1)),
    "freeze off": Entry(Command(Action.SET, FREEZE, 0)),
    "freeze get": Entry(Command(Action.GET, FREEZE), allowed=(0, 1)),
    "brightness get": Entry(Command(Action.GET, BRIGHTNESS)),
    "brightness reset": Entry(Command(Action.EXECUTE, BRIGHTNESS_RESET)),
    "contrast get": Entry(Command(Action.GET, CONTRAST)),
    "contrast reset": Entry(Command(Action.EXECUTE, CONTRAST_RESET)),
    "gamma 1 default": Entry(Command(Action.SET, GAMMA, GAMMA_1_DEFAULT)),
    "gamma get": Entry(Command(Action.GET, GAMMA)),
    "picture mode normal": Entry(Command(Action.SET, PICTURE_MODE, PICTURE_NORMAL)),
    "picture mode get": Entry(Command(Action.GET, PICTURE_MODE), _F),
    "keystone get": Entry(Command(Action.GET, KEYSTONE)),
    "keystone reset": Entry(Command(Action.EXECUTE, KEYSTONE_RESET)),
    "magnify get": Entry(Command(Action.GET, MAGNIFY)),
    "magnify decrement": Entry(Command(Action.DECREMENT, MAGNIFY), _F),
    "frame lock rgb1 on": Entry(Command(Action.SET, FRAME_LOCK_1, 1), _F),
    "frame lock rgb1 get": Entry(Command(Action.GET, FRAME_LOCK_1), _F, (0, 1)),
    "frame lock rgb2 on": Entry(Command(Action.SET, FRAME_LOCK_2, 1), _F),
    "frame lock rgb2 get": Entry(Command(Action.GET, FRAME_LOCK_2), _F, (0, 1)),
    "auto adjust": Entry(Command(Action.EXECUTE, AUTO_ADJUST)),
    "lamp hours get": Entry(Command(Action.GET, LAMP_HOURS)),
    "filter hours get": Entry(Command(Action.GET, FILTER_HOURS)),
}

VERIFIED_ON_SIBLINGS = frozenset(name for name, entry in TABLE.items() if entry.source is Source.SIBLINGS)
"""Names of the commands that hardware manuals of its closest siblings print; the others come from later models."""


def entry_of(name: str) -> Entry:
    """Return the row of that name.

    Raises
    ------
    UsageError
        there is none; it lists the names.
    """
    if name not in TABLE:
        raise UsageError(f"HITACHI projectors have no command {name!r}; there are: {', '.join(TABLE)}")
    return TABLE[name]
