"""A HITACHI projector's control: lamp, input, blank, freeze, errors, hours and a neutral picture.

Owns the device behind one line; knows nothing of patterns or of how the picture reaches it. One thread uses it.
Everything is asked anew: nothing that a projector's remote control can change is remembered, except when the lamp
was switched.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fringed.devices.projector.hitachi_line import Answer, HitachiLine
from fringed.devices.projector.hitachi_picture import NeutralPicture, judged_settings
from fringed.devices.projector.hitachi_power import Lamp, LampTimes, PowerTracker, Seen
from fringed.errors import DeviceAbsent, DeviceError, DeviceStalled, ProtocolError
from fringed.hookspecs import Clock
from fringed.protocols.hitachi import Ack, Data
from fringed.protocols.hitachi_commands import ERROR_TEXTS, INPUTS, POWER_ON, entry_of

_TIMES_SET = 3
_LOOK_S = 0.5
_WARNINGS = (6, 8)
"""Errors that a projector still works with: the lamp past its time, the filter due."""


@dataclass(frozen=True)
class ErrorStatus:
    """What the projector says is wrong; code 0 is nothing."""

    code: int

    @property
    def text(self) -> str:
        """The published meaning."""
        return ERROR_TEXTS.get(self.code, f"a code that nobody published ({self.code})")

    @property
    def stops(self) -> bool:
        """Whether nothing can be measured with it."""
        return self.code != 0 and self.code not in _WARNINGS


@dataclass(frozen=True)
class ControlSettings:
    """What a laboratory chooses; `neutral` overrides the table's numbers, `unchecked` names what is not judged."""

    input: str = "rgb1"
    lamp: LampTimes = field(default_factory=LampTimes)
    neutral: Mapping[str, int] = field(default_factory=dict)
    unchecked: tuple[str, ...] = ()


class HitachiControl:
    """A projector on one line. A line that is lost is opened again, once per command."""

    def __init__(self, line: HitachiLine, clock: Clock, settings: ControlSettings | None = None) -> None:
        self._line, self._clock, self._settings = line, clock, settings or ControlSettings()
        self._power = PowerTracker(self._settings.lamp)
        self._open = False
        self._asked_s = 0.0
        judged = judged_settings(self._settings.input, self._settings.neutral, self._settings.unchecked)
        self.picture = NeutralPicture(line.name, judged, self.value, self._do)

    @property
    def name(self) -> str:
        """What messages call it."""
        return self._line.name

    @property
    def lamp(self) -> Lamp | None:
        """What the lamp did when it was looked at last."""
        return self._power.lamp

    def open(self) -> Lamp:
        """Open the line and look; raises DeviceError."""
        self._line.open()
        self._open = True
        return self.look()

    def close(self) -> None:
        """Close the line; the lamp stays as it is."""
        self._open = False
        self._line.close()

    # The lamp.

    def look(self) -> Lamp:
        """Ask what the lamp does.

        Raises
        ------
        DeviceStalled
            nothing answers and nothing explains it, or warming or cooling takes too long.
        """
        power = self._quiet("power get")
        ready = power == POWER_ON and self._quiet("input get") is not None
        lamp = self._power.see(Seen(power, ready), self._clock.now())
        if self._power.overdue(self._clock.now()):
            raise DeviceStalled(
                f"{self.name}: {lamp.name.lower()} does not end; usual are about {self._usual_s(lamp):g} s. See its "
                "indicators, let it cool down, switch it off at the mains, and see its manual on errors"
            )
        return lamp

    def power_on(self) -> None:
        """Switch the lamp on, if it is off; warm-up begins.

        Raises
        ------
        DeviceError
            it is cooling down, or an error keeps it off.
        """
        lamp = self.look()
        if lamp is Lamp.COOLING:
            raise DeviceError(f"{self.state_text()}; it can be switched on again then")
        if lamp is Lamp.STANDBY:
            self._switch("power on", on=True)

    def power_off(self) -> None:
        """Switch the lamp off, if it is on; cool-down begins.

        Raises
        ------
        DeviceError
            it is still warming up.
        """
        lamp = self.look()
        if lamp is Lamp.WARMING:
            raise DeviceError(f"{self.state_text()}; it can be switched off then")
        if lamp is Lamp.ON:
            self._switch("power off", on=False)

    def wait_for(self, lamp: Lamp, timeout_s: float) -> None:
        """Wait until the lamp does that; raises DeviceStalled after `timeout_s`."""
        end_s = self._clock.now() + timeout_s
        while self.look() is not lamp:
            if self._clock.now() > end_s:
                raise DeviceStalled(f"{self.state_text()}; {lamp.name} was awaited for {timeout_s:g} s")
            self._clock.sleep(min(_LOOK_S, timeout_s / 10))

    def state_text(self) -> str:
        """Say what the lamp does, and about how much longer."""
        words = {Lamp.STANDBY: "is off", Lamp.WARMING: "warms up", Lamp.ON: "is on", Lamp.COOLING: "cools down"}
        text = f"{self.name}: the lamp {words[self.lamp]}" if self.lamp else f"{self.name}: not asked yet"
        left_s = self._power.left_s(self._clock.now())
        return text + (f", ready in about {left_s:.0f} s" if self._power.switching else "")

    # Settings.

    def select_input(self, input: str) -> None:
        """Select "rgb1" or "rgb2"."""
        self._set(f"input {input}", "input get")

    def input(self) -> str:
        """Return the input; a number where it is neither."""
        code = self._get("input get")
        return next((name for name, known in INPUTS.items() if known == code), str(code))

    def blank(self, on: bool) -> None:
        """Blank the picture in black, or show it: the only shutter that there is."""
        if on:
            self._set("blank colour black", "blank colour get")
        self._set(f"blank {'on' if on else 'off'}", "blank get")

    def blanked(self) -> bool:
        """Whether it is blanked."""
        return self._get("blank get") == 1

    def freeze(self, on: bool) -> None:
        """Freeze the picture, or let it follow the signal."""
        self._set(f"freeze {'on' if on else 'off'}", "freeze get")

    def frozen(self) -> bool:
        """Whether it is frozen."""
        return self._get("freeze get") == 1

    def error(self) -> ErrorStatus:
        """Return what the projector says is wrong."""
        return ErrorStatus(self._get("error get"))

    def lamp_hours(self) -> int:
        """Return the lamp's hours."""
        return self._get("lamp hours get")

    def filter_hours(self) -> int:
        """Return the filter's hours."""
        return self._get("filter hours get")

    def auto_adjust(self) -> None:
        """Let it find the analogue signal's position and phase anew."""
        self._do("auto adjust")

    def value(self, name: str) -> int | None:
        """Return the answer to a get by its name in the table; None where the projector refuses it."""
        answer = self._exchange(name)
        return answer.value if isinstance(answer, Data) else None

    def keep_alive(self, every_s: float) -> Lamp | None:
        """Notice a lost line at once, and look when nothing was asked for `every_s`; raises DeviceError."""
        self._require_open()
        try:
            self._line.watch()
        except DeviceAbsent:
            self._reopen()
        return self.look() if self._clock.now() - self._asked_s >= every_s else self.lamp

    # Below.

    def _switch(self, name: str, on: bool) -> None:
        """Switch the lamp. A reply that was lost or drowned in power-on noise is no failure: the next look tells."""
        try:
            acknowledged = isinstance(self._exchange(name), Ack)
        except (DeviceStalled, ProtocolError):
            acknowledged = False
        if not acknowledged and (code := self._quiet("error get")) and ErrorStatus(code).stops:
            raise DeviceError(f"{self.name} refuses {name!r}: {ErrorStatus(code).text}. Mend that first")
        self._power.told(on, self._clock.now())

    def _quiet(self, name: str) -> int | None:
        """Return a value; None for a refusal, or for silence and noise while the lamp switches."""
        try:
            answer = self._exchange(name)
        except (DeviceStalled, ProtocolError):
            if not self._power.switching:
                raise
            return None
        return answer.value if isinstance(answer, Data) else None

    def _get(self, name: str) -> int:
        answer = self._exchange(name)
        if isinstance(answer, Data):
            return answer.value
        raise self._refused(name)

    def _do(self, name: str) -> None:
        if not isinstance(self._exchange(name), Ack):
            raise self._refused(name)

    def _set(self, name: str, get: str) -> None:
        """Set and read back: an acknowledgement is one byte, and noise may be that byte."""
        wanted, seen = entry_of(name).command.setting, -1
        for _ in range(_TIMES_SET):
            self._do(name)
            seen = self._get(get)
            if seen == wanted:
                return
        raise DeviceError(f"{self.name} acknowledged {name!r} and stays at {seen}; expected {wanted}: set it by hand")

    def _refused(self, name: str) -> DeviceError:
        return DeviceError(
            f"{self.name} cannot execute {name!r} now (1c 00 00); {self.state_text().partition(': ')[2]}"
        )

    def _exchange(self, name: str) -> Answer:
        self._require_open()
        self._asked_s = self._clock.now()
        try:
            return self._line.exchange(name)
        except DeviceAbsent:
            self._reopen()
            return self._line.exchange(name)

    def _reopen(self) -> None:
        """Open the line afresh: TCP 9715 hangs up after 30 s, and a cable may have been put back."""
        self._line.close()
        self._line.open()

    def _require_open(self) -> None:
        if not self._open:
            raise DeviceAbsent(f"{self.name} is closed: open it")

    def _usual_s(self, lamp: Lamp) -> float:
        return self._settings.lamp.warm_up_s if lamp is Lamp.WARMING else self._settings.lamp.cool_down_s
