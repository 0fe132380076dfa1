"""What `fringe device` reads and sets of a HITACHI projector, by the control that it already has.

Owns the names. All are marked as not verified: nothing is confirmed on a CP-X260.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fringed.devices.projector.hitachi_control import ErrorStatus, HitachiControl
from fringed.devices.projector.hitachi_power import Lamp
from fringed.errors import UsageError
from fringed.hookspecs import Setting
from fringed.protocols.hitachi_commands import INPUTS

LAMP, ON, OFF = "lamp", "on", "standby"


def settings_of(control: HitachiControl) -> Sequence[Setting]:
    """Ask for all that it tells now: with the lamp off, only lamp, errors and hours. Raises DeviceError."""
    lamp = control.look()
    found = [
        Setting(LAMP, lamp.name.lower(), choices=(ON, OFF), verified=False, help=control.state_text()),
        _read("error", _error(control.value("error get")), "", "what the projector complains of"),
        _read("lamp_hours", control.value("lamp hours get"), "h", "the lamp's age"),
        _read("filter_hours", control.value("filter hours get"), "h", "since the filter was cleaned"),
    ]
    if lamp is not Lamp.ON:
        return found
    neutral = "; ".join(control.picture.problems()) or "neutral"
    return [
        *found,
        Setting(
            "input", control.input(), choices=tuple(INPUTS), verified=False, help="where the computer is plugged in"
        ),
        Setting("blank", control.blanked(), verified=False, help="dark, the lamp burning: the shutter"),
        Setting("freeze", control.frozen(), verified=False, help="the picture stands still whatever the cable says"),
        Setting("picture", neutral, choices=("neutral",), verified=False, help="set to neutral: reset what is not"),
    ]


def adjust(control: HitachiControl, name: str, value: bool | float | str) -> None:
    """Set one, checked before; raises DeviceError, or UsageError where it cannot be now."""
    doing: dict[str, Callable[[], None]] = {
        LAMP: lambda: _switch(control, str(value)),
        "input": lambda: control.select_input(str(value)),
        "blank": lambda: control.blank(bool(value)),
        "freeze": lambda: control.freeze(bool(value)),
        "picture": control.picture.reset,
    }
    if name not in doing:
        raise UsageError(f"projector {name} can be read only")
    doing[name]()


def _switch(control: HitachiControl, value: str) -> None:
    lamp = control.look()
    if (value == ON and lamp is Lamp.COOLING) or (value == OFF and lamp is Lamp.WARMING):
        raise UsageError(f"{control.state_text()}; it can be switched then")
    if value == ON:
        control.power_on()
    else:
        control.power_off()


def _read(name: str, value: int | str | None, unit: str, text: str) -> Setting:
    return Setting(name, value, unit, writable=False, verified=False, help=text)


def _error(code: int | None) -> str | None:
    return None if code is None else ErrorStatus(code).text
