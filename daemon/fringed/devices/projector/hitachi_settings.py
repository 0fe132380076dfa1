"""What `fringe device` reads and sets of a HITACHI projector, by the control that it already has.

Owns the names; whether a command is confirmed is in the table of commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fringed.devices.projector.hitachi_control import HitachiControl
from fringed.errors import UsageError
from fringed.hookspecs import Setting

_INPUTS = ("rgb1", "rgb2")


def settings_of(control: HitachiControl) -> Sequence[Setting]:
    """Ask for all of them; raises DeviceError."""
    neutral = "; ".join(control.picture.problems()) or "neutral"
    return [
        Setting("lamp", control.state_text(), writable=False, verified=False, help="standby, warming, on or cooling"),
        Setting("input", control.input(), choices=_INPUTS, verified=False, help="where the computer is plugged in"),
        Setting("blank", control.blanked(), verified=False, help="dark, the lamp burning: the shutter"),
        Setting("freeze", control.frozen(), verified=False, help="the picture stands still whatever the cable says"),
        Setting("error", str(control.error()), writable=False, verified=False, help="what the projector complains of"),
        Setting("lamp_hours", control.lamp_hours(), "h", writable=False, verified=False),
        Setting("filter_hours", control.filter_hours(), "h", writable=False, verified=False),
        Setting("picture", neutral, choices=("neutral",), verified=False, help="set to neutral: reset what is not"),
    ]


def adjust(control: HitachiControl, name: str, value: bool | float | str) -> None:
    """Set one, checked before; raises DeviceError."""
    doing: dict[str, Callable[[], None]] = {
        "input": lambda: control.select_input(str(value)),
        "blank": lambda: control.blank(bool(value)),
        "freeze": lambda: control.freeze(bool(value)),
        "picture": control.picture.reset,
    }
    if name not in doing:
        raise UsageError(f"projector {name} can be read only")
    doing[name]()
