"""What `fringe device` reads and sets of an MS3100, by the control that it already has.

Owns the names: gain, offset and integration of each CCD. Opcodes that nobody has confirmed are read and set only where
the configuration enables them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fringed.devices.camera.duncantech_control import COLOURS, DuncanTechControl
from fringed.errors import UsageError
from fringed.hookspecs import Setting
from fringed.protocols.duncantech import Colour


def settings_of(control: DuncanTechControl) -> Sequence[Setting]:
    """Ask for all of them; a value whose opcode may not be sent is unknown. Raises DeviceError."""
    read: dict[str, Callable[[Colour], int]] = {
        "gain": control.gain, "offset": control.offset, "integration": control.integration_lines,
    }  # fmt: skip
    found = []
    for colour in COLOURS:
        for parameter in control.parameters():
            readable, settable = parameter.verified
            found.append(
                Setting(
                    f"{colour}_{parameter.name}", _value(read[parameter.name], colour), parameter.units, parameter.low,
                    parameter.high, verified=readable and settable,
                )
            )  # fmt: skip
    return found


def adjust(control: DuncanTechControl, name: str, value: bool | float | str) -> None:
    """Set one; raises DeviceError, or UsageError where there is none such, or its opcode may not be sent."""
    colour, _, parameter = name.partition("_")
    setters: dict[str, Callable[[Colour, int], object]] = {
        "gain": control.set_gain, "offset": control.set_offset, "integration": control.set_integration_lines,
    }  # fmt: skip
    if colour not in COLOURS or parameter not in setters:
        there = ", ".join(f"{one}_{what}" for one in COLOURS for what in setters)
        raise UsageError(f"the MS3100 has no setting {name!r}; it has {there}")
    setters[parameter](_colour(colour), int(value))


def _value(read: Callable[[Colour], int], colour: Colour) -> int | None:
    try:
        return read(colour)
    except UsageError:  # an unverified opcode that is not enabled
        return None


def _colour(name: str) -> Colour:
    return next(colour for colour in COLOURS if colour == name)
