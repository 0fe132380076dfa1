"""What the lamp does, from what the projector answers and when it was told to switch.

Owns the judgement; knows no port and asks no clock. A projector answers 0, 1 or 2 (off, on, cooling) to a power
get. What it answers during warm-up is not published beyond "commands are refused", so a refusal, silence, or "on"
with everything else refused all mean warming. How long either takes is assumed, and said as an estimate only.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from fringed.protocols.hitachi_commands import POWER_COOLING, POWER_OFF

_LIMIT = 4.0
"""A lamp that takes so many times its usual time has failed."""
_BEGIN_S = 5.0
"""A projector may still say "off" for so long after it acknowledged to switch on [A]."""


class Lamp(Enum):
    """The lamp's states, by the names that the station shows."""

    STANDBY = "STANDBY"
    WARMING = "WARMING"
    ON = "ON"
    COOLING = "COOLING"


@dataclass(frozen=True)
class LampTimes:
    """How long the lamp takes, in seconds; both assumed."""

    warm_up_s: float = 30.0
    cool_down_s: float = 90.0


@dataclass(frozen=True)
class Seen:
    """One look. `power` is what the projector answered, None for refused or silent; `ready`: it takes commands."""

    power: int | None
    ready: bool


class PowerTracker:
    """Follow the lamp."""

    def __init__(self, times: LampTimes) -> None:
        self._times = times
        self._told: tuple[Lamp, float] | None = None
        self._since_s = 0.0
        self.lamp: Lamp | None = None

    def told(self, on: bool, now_s: float) -> None:
        """Take note that the projector acknowledged to switch."""
        self._told = (Lamp.WARMING if on else Lamp.COOLING, now_s)
        self._go(self._told[0], now_s)

    def see(self, seen: Seen, now_s: float) -> Lamp:
        """Take a look into account and return what the lamp does."""
        return self._go(self._judged(seen, now_s), now_s)

    @property
    def switching(self) -> bool:
        """Whether silence and refusals are to be expected now."""
        return self.lamp in (Lamp.WARMING, Lamp.COOLING)

    def left_s(self, now_s: float) -> float:
        """Return about how long warming or cooling still takes; 0 when it does neither."""
        usual_s = {Lamp.WARMING: self._times.warm_up_s, Lamp.COOLING: self._times.cool_down_s}.get(
            self.lamp or Lamp.ON, 0.0
        )
        return max(0.0, self._since_s + usual_s - now_s)

    def overdue(self, now_s: float) -> bool:
        """Whether it takes so long that something has failed."""
        usual_s = self._times.warm_up_s if self.lamp is Lamp.WARMING else self._times.cool_down_s
        return self.switching and now_s - self._since_s > _LIMIT * usual_s + _BEGIN_S

    def _judged(self, seen: Seen, now_s: float) -> Lamp:
        if seen.power is None:
            return self.lamp if self.lamp in (Lamp.WARMING, Lamp.COOLING) else Lamp.WARMING
        if seen.power == POWER_COOLING:
            return Lamp.COOLING
        if seen.power == POWER_OFF:
            told_on = self._told is not None and self._told[0] is Lamp.WARMING
            beginning = told_on and self._told is not None and now_s - self._told[1] < _BEGIN_S
            return Lamp.WARMING if beginning and self.lamp is Lamp.WARMING else Lamp.STANDBY
        if self.lamp is Lamp.COOLING and self._told is not None and now_s - self._told[1] < _BEGIN_S:
            return Lamp.COOLING  # "on" for a moment after it acknowledged to switch off
        return Lamp.ON if seen.ready else Lamp.WARMING

    def _go(self, lamp: Lamp, now_s: float) -> Lamp:
        if lamp is not self.lamp:
            self.lamp, self._since_s = lamp, now_s
        return lamp
