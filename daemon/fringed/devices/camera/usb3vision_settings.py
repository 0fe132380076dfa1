"""A USB3 Vision camera's own settings, beside those of a scan: what `fringe device` shows and sets.

Owns which features these are; those that the camera has not are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from fringed.errors import ProtocolError, UsageError
from fringed.hookspecs import Setting
from fringed.protocols.u3v_features import Features

OWN: Mapping[str, tuple[str, str]] = {
    "DeviceTemperature": ("degC", "temperature within the camera"),
    "BlackLevel": ("", "what no light gives, in the camera's own unit"),
    "TriggerActivation": ("", "which edge of the line triggers"),
    "TriggerDelay": ("us", "from the pulse to the exposure"),
    "LineDebouncerTime": ("us", "how long a pulse must last"),
    "DeviceLinkThroughputLimit": ("B/s", "how fast the camera sends"),
    "ReverseX": ("", "mirrors the picture: a calibration holds for one way only"),
    "ReverseY": ("", "turns the picture over: a calibration holds for one way only"),
    "OffsetX": ("px", "where its frames begin: a calibration holds for one place only"),
    "OffsetY": ("px", "where its frames begin: a calibration holds for one place only"),
}
_READ_ONLY = frozenset({"DeviceTemperature"})


def own_settings(features: Features) -> tuple[Setting, ...]:
    """Ask the camera for all of them; one that it does not tell has no value."""
    return tuple(_setting(features, name) for name in OWN if features.has(name))


def adjust(features: Features, name: str, value: bool | float | str) -> None:
    """Set one.

    Raises
    ------
    UsageError
        a setting that this camera has not, or a value that it cannot take.
    """
    there = ", ".join(own for own in OWN if features.has(own) and own not in _READ_ONLY) or "none"
    if name not in OWN or name in _READ_ONLY or not features.has(name):
        raise UsageError(f"the setting {name!r} cannot be set; this camera has {there}")
    choices = features.choices(name)
    if choices and value not in choices:
        raise UsageError(f"{name} {value!r} is asked; expected one of {', '.join(choices)}")
    if not choices:
        low, high = features.limits(name)
        if isinstance(value, str) or not low <= value <= high:
            raise UsageError(f"{name} {value!r} is asked; expected a number from {low:g} to {high:g}")
    features.set(name, value)


def _setting(features: Features, name: str) -> Setting:
    unit, text = OWN[name]
    choices = features.choices(name)
    value: int | float | str | None
    try:
        value = features.choice(name) if choices else features.number(name)
        least, most = (None, None) if choices else (_finite(limit) for limit in features.limits(name))
    except ProtocolError as error:  # not available now, or described in a way that is not read
        return Setting(name, None, unit, writable=False, verified=False, help=error.message)
    return Setting(name, value, unit, least, most, choices, name not in _READ_ONLY, False, text)


def _finite(limit: float) -> float | None:
    return limit if math.isfinite(limit) else None
