"""A device's own settings: read, checked, set. Owns the check of a value against what its setting allows."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from fringed.acquisition.port import RigPort
from fringed.errors import DeviceAbsent, FringedError, UsageError
from fringed.hookspecs import Adjustable, Setting


@dataclass(frozen=True)
class SettingsRequest:
    """Ask "camera" or "projector" for its settings; set `name` to `value` first where a name is given.

    `done` and `failed` are called in the acquisition thread and return at once.
    """

    which: str
    done: Callable[[list[Setting]], None]
    failed: Callable[[FringedError], None]
    name: str = ""
    value: Any = None
    scan: str = ""


def answered(port: RigPort, request: SettingsRequest) -> list[Setting]:
    """Return a device's settings, one of them set before where that is wanted.

    Raises
    ------
    UsageError
        no such device or setting, a value that it does not allow, a device without settings.
    DeviceError
        the device is not there, or does not answer.
    """
    devices = {"camera": (port.camera, port.rig.camera), "projector": (port.projector, port.rig.projector)}
    if request.which not in devices:
        raise UsageError(f"no device is called {request.which!r}; there are {', '.join(devices)}")
    device, driver = devices[request.which]
    if not isinstance(driver, Adjustable):
        raise UsageError(f"the {request.which}'s driver {device.driver!r} has no settings of its own")
    if not device.is_open:
        raise DeviceAbsent(f"the {request.which} is {device.state}: {device.detail or 'it is not open'}")
    with device.guarded("read its settings"):
        found = list(driver.settings())
    if not request.name:
        return found
    value = checked(found, request.which, request.name, request.value)
    with device.guarded(f"set {request.name}"):
        driver.adjust(request.name, value)
        return list(driver.settings())


def checked(found: Sequence[Setting], which: str, name: str, value: Any) -> bool | float | str:
    """Return a value as its setting takes it; raise UsageError with what is allowed."""
    by_name = {setting.name: setting for setting in found}
    if name not in by_name:
        close = difflib.get_close_matches(name, by_name, 3)
        hint = f"did you mean {' or '.join(close)}? " if close else ""
        raise UsageError(f"the {which} has no setting {name!r}; {hint}it has {', '.join(by_name)}")
    setting = by_name[name]
    if not setting.writable:
        raise UsageError(f"{which} {name} can be read only")
    if setting.choices:
        if str(value) not in setting.choices:
            raise UsageError(f"{which} {name} = {value!r}; allowed are {', '.join(setting.choices)}")
        return str(value)
    if isinstance(setting.value, bool):
        return _switch(which, name, value)
    if isinstance(setting.value, str) or (setting.value is None and setting.least is None):
        return str(value)
    return _number(which, setting, value)


def _switch(which: str, name: str, value: Any) -> bool:
    words = {"true": True, "on": True, "1": True, "false": False, "off": False, "0": False}
    if str(value).lower() not in words:
        raise UsageError(f"{which} {name} = {value!r}; allowed are on and off")
    return words[str(value).lower()]


def _number(which: str, setting: Setting, value: Any) -> float:
    unit = f" {setting.unit}" if setting.unit else ""
    low = "" if setting.least is None else f"{setting.least:g}{unit} "
    high = "" if setting.most is None else f" {setting.most:g}{unit}"
    allowed = f"{low}to{high}" if low or high else "a number"
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise UsageError(f"{which} {setting.name} = {value!r}; allowed is {allowed}") from None
    least = float("-inf") if setting.least is None else setting.least
    most = float("inf") if setting.most is None else setting.most
    if not least <= number <= most:
        raise UsageError(f"{which} {setting.name} = {number:g}{unit}; allowed is {allowed}")
    return int(number) if isinstance(setting.value, int) and number.is_integer() else number
