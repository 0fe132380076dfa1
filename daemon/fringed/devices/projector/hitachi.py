"""The projector driver "hitachi": a HITACHI CP-X260's control, composed with any video output.

Owns when the lamp, the input and the picture are checked; the output owns the patterns. Nothing of the protocol is
confirmed on a CP-X260: see `fringed.protocols.hitachi_commands`.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Protocol

from fringed.config import validate
from fringed.data import PatternSequence
from fringed.devices.projector.hitachi_control import HitachiControl
from fringed.devices.projector.hitachi_options import HitachiOptions, control_of, transport_of
from fringed.devices.projector.hitachi_power import Lamp
from fringed.devices.projector.hitachi_settings import LAMP, OFF, ON, adjust, settings_of
from fringed.errors import ConfigurationError, DeviceError, Problem
from fringed.hookspecs import Clock, Driver, Projector, Setting, Watched

log = logging.getLogger(__name__)

__all__ = ["HITACHI", "HitachiControl", "HitachiOptions", "HitachiProjector", "create"]


class BuildContext(Protocol):
    """What a driver is told beside its options."""

    @property
    def station(self) -> str:
        """The station's name."""
        ...

    @property
    def clock(self) -> Clock:
        """The rig's clock."""
        ...


class HitachiProjector:
    """A projector with a control line and a video output."""

    def __init__(self, control: HitachiControl, output: Projector, clock: Clock, options: HitachiOptions) -> None:
        self._control, self._output, self._clock, self._options = control, output, clock, options
        self._checked_s: float | None = None
        self._off_wished = self._was_on = self._opened_resting = False

    @property
    def simulated(self) -> bool:
        """Whether its video output is simulated."""
        return self._output.simulated

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its panel."""
        return self._output.size_px

    @property
    def control(self) -> HitachiControl:
        """The lamp, the input and the rest, for whoever gets and sets them."""
        return self._control

    @property
    def lamp_state(self) -> str:
        """STANDBY, WARMING, ON or COOLING, as seen last; nothing before the first look."""
        return self._control.lamp.value if self._control.lamp else ""

    def open(self) -> str:
        """Open line and output and return the identity.

        A lamp that is off is switched on, unless the options say otherwise or somebody switched it off since: then it
        stays off, and only loading patterns is refused.

        Raises
        ------
        DeviceError
            the lamp warms up or cools down: it says about how long. Also where the projector reports an error or its
            picture is not neutral.
        """
        self._control.open()
        self._note()
        if self._control.lamp is Lamp.STANDBY and not self._resting:
            self._control.power_on()
        self._opened_resting = self._resting
        if self._resting:
            return f"HITACHI projector at {self._control.name}, its lamp off; {self._opened_output()}"
        self._require_on()
        self._control.select_input(self._options.input)
        picture = self._opened_output()
        self._prepare()
        hours = f"lamp {self._control.lamp_hours()} h, filter {self._control.filter_hours()} h"
        return f"HITACHI projector at {self._control.name}, {hours}; {picture}"

    def close(self) -> None:
        """Close output and line; the lamp stays as it is."""
        self._checked_s = None
        try:
            self._output.close()
        finally:
            self._control.close()

    def load(self, sequence: PatternSequence, role: str) -> None:
        """Prepare the patterns of one set; now and then, look at lamp and picture first. Raises DeviceError."""
        if self._checked_s is None or self._clock.now() - self._checked_s >= self._options.recheck_s:
            self._control.look()
            self._note()
            self._require_on()
            self._prepare()
        self._output.load(sequence, role)

    def show(self, index: int) -> float:
        """Show pattern `index` and return the time of its flip."""
        return self._output.show(index)

    def idle(self) -> None:
        """Show the output's idle picture."""
        self._output.idle()

    def check(self) -> None:
        """Keep the line alive while nothing is measured, and see that line, lamp and output are still there.

        Raises
        ------
        DeviceError
            one of them has gone, or the lamp is no longer on.
        """
        self._control.keep_alive(self._options.keep_alive_s)
        self._note()
        if self._resting != self._opened_resting:
            raise DeviceError(f"{self._control.state_text()}; the projector is opened afresh")
        if not self._resting:
            self._require_on()
        if isinstance(self._output, Watched):
            self._output.check()

    def settings(self) -> Sequence[Setting]:
        """Ask for lamp, input, blank, freeze, errors, hours and the picture; raises DeviceError."""
        found = settings_of(self._control)
        self._checked_s = None  # what was read counts: the next set asks for the picture again
        return found

    def adjust(self, name: str, value: bool | float | str) -> None:
        """Set one of them; raises DeviceError, or UsageError where it cannot be now."""
        adjust(self._control, name, value)
        self._checked_s = None
        if name == LAMP:
            self._off_wished = value == OFF

    @property
    def _resting(self) -> bool:
        """Whether the lamp is off because somebody wants that."""
        off = self._control.lamp in (Lamp.STANDBY, Lamp.COOLING)
        return off and (self._off_wished or not self._options.power_on)

    def _note(self) -> None:
        """Take note of what the lamp does. One that cools down after it was on was switched off by somebody."""
        lamp = self._control.lamp
        if lamp is Lamp.COOLING and self._was_on:
            self._off_wished = True
        if lamp is Lamp.ON:
            self._was_on, self._off_wished = True, False

    def _require_on(self) -> None:
        if self._control.lamp is Lamp.ON:
            return
        self._checked_s = None
        todo = f": switch it on, by `fringe device set projector {LAMP} {ON}` or its remote control"
        raise DeviceError(self._control.state_text() + (todo if self._resting else "; it is tried again by itself"))

    def _opened_output(self) -> str:
        picture = self._output.open()
        self._require_panel()
        return picture

    def _require_panel(self) -> None:
        seen, panel = self._output.size_px, self._options.panel_px
        if seen != panel:
            raise DeviceError(
                f"the video output has {seen[0]} x {seen[1]} pixels and the projector's panel {panel[0]} x {panel[1]}: "
                "it would resample every pattern. Set the output to the panel's size, or correct "
                "projector.options.panel_px"
            )

    def _prepare(self) -> None:
        """Make sure that what the output shows is what the panel shows."""
        error = self._control.error()
        if error.stops:
            raise DeviceError(f"{self._control.name} reports an error: {error.text}. Mend that first")
        if error.code:
            log.warning("%s works, and reports: %s", self._control.name, error.text)
        self._control.blank(False)
        self._control.freeze(False)
        if self._options.check_picture:
            self._require_neutral()
        self._checked_s = self._clock.now()

    def _require_neutral(self) -> None:
        problems = self._control.picture.problems()
        if problems and self._options.reset_picture:
            log.warning("%s: the picture is reset: %s", self._control.name, "; ".join(problems))
            self._control.picture.reset()
        elif problems:
            self._control.picture.require()


def create(options: HitachiOptions, context: BuildContext) -> HitachiProjector:
    """Build the driver; nothing is opened. Raises ConfigurationError."""
    control = control_of(options, transport_of(options), context.clock)
    return HitachiProjector(control, _output(options, context), context.clock, options)


def _output(options: HitachiOptions, context: BuildContext) -> Projector:
    from fringed.devices.building import built_in

    driver = built_in("projector", options.output_driver)
    if driver is None or driver is HITACHI:
        problem = Problem("projector.options.output_driver", repr(options.output_driver), "a video output: 'window'")
        raise ConfigurationError("1 problem:", (problem,))
    output: Projector = driver.create(validate(options.output, driver.Options, "projector.options.output"), context)
    return output


HITACHI = Driver(
    "hitachi",
    HitachiOptions,
    create,
    "HITACHI CP-X260 and its siblings by RS-232C or TCP, with any video output; bytes verified on siblings only",
)
