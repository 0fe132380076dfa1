"""Which settings of the projector change a picture's pixels or grey levels, and what they have to be.

Owns the table of neutral values, and how to bring a projector there; knows nothing of lines. That keystone and
magnification are neutral at 0 is assumed; the codes of gamma 1 and of the normal picture mode are published for sibling
models. Brightness and contrast can be reset, and no neutral number of theirs is known, so they are not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from fringed.errors import DeviceError
from fringed.protocols.hitachi_commands import GAMMA_1_DEFAULT, PICTURE_NORMAL


@dataclass(frozen=True)
class Setting:
    """A setting that has to be neutral. `reset` is sent, again and again up to `steps` times, until it is."""

    name: str
    get: str
    reset: str
    neutral: int
    steps: int
    why: str


MAGNIFY_STEPS = 100


def neutral_settings(input: str) -> tuple[Setting, ...]:
    """Return the settings, in the order to reset them: a picture mode brings its own gamma."""
    return (
        Setting("picture mode", "picture mode get", "picture mode normal", PICTURE_NORMAL, 1, "changes grey levels"),
        Setting("gamma", "gamma get", "gamma 1 default", GAMMA_1_DEFAULT, 1, "bends grey levels"),
        Setting("keystone", "keystone get", "keystone reset", 0, 1, "resamples every pixel"),
        Setting("magnify", "magnify get", "magnify decrement", 0, MAGNIFY_STEPS, "resamples every pixel"),
        Setting("frame lock", f"frame lock {input} get", f"frame lock {input} on", 1, 1, "drops pictures when off"),
    )


SETTINGS = tuple(setting.name for setting in neutral_settings("rgb1"))
ALSO_RESET = ("brightness reset", "contrast reset")


def deviation(setting: Setting, value: int | None) -> str:
    """Say what is wrong with a setting; nothing where it is neutral. None: the projector does not tell."""
    if value == setting.neutral:
        return ""
    if value is None:
        return (
            f"{setting.name} cannot be read: check it in the projector's menu, then add {setting.name!r} to "
            "projector.options.unchecked"
        )
    return f"{setting.name} is {value}; expected {setting.neutral} ({setting.why})"


def judged_settings(input: str, neutral: Mapping[str, int], unchecked: tuple[str, ...]) -> tuple[Setting, ...]:
    """Return the table with a laboratory's own neutral numbers, without what it does not want judged."""
    return tuple(
        replace(each, neutral=neutral.get(each.name, each.neutral))
        for each in neutral_settings(input)
        if each.name not in unchecked
    )


class NeutralPicture:
    """Judge and reset a projector's picture. `value` asks for a setting, None where it is refused; `do` sends."""

    def __init__(
        self, name: str, judged: tuple[Setting, ...], value: Callable[[str], int | None], do: Callable[[str], None]
    ) -> None:
        self._name, self._judged, self._value, self._do = name, judged, value, do

    def problems(self) -> list[str]:
        """Return what is not neutral, each with the value seen and the value expected."""
        told = (deviation(each, self._value(each.get)) for each in self._judged)
        return [problem for problem in told if problem]

    def require(self) -> None:
        """Raise DeviceError where the picture is not neutral: it names each setting to reset."""
        if problems := self.problems():
            raise DeviceError(
                f"{self._name} changes the picture, so nothing is measured: {'; '.join(problems)}. Reset it in the "
                "projector's menu, or set projector.options.reset_picture = true"
            )

    def reset(self) -> None:
        """Bring every judged setting to neutral, and brightness and contrast to their defaults.

        Raises
        ------
        DeviceError
            one that the projector does not bring there: it names it.
        """
        for name in ALSO_RESET:
            self._do(name)
        for setting in self._judged:
            for _ in range(setting.steps):
                if self._value(setting.get) in (None, setting.neutral):
                    break
                self._do(setting.reset)
        self.require()
