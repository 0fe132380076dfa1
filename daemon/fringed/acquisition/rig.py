"""A rig as it is handed to the acquisition, and each of its devices with its state.

Owns what happens when a device is opened, fails and is opened again; every failure leaves here as a
DeviceError that names the device. Knows nothing of patterns or sets.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from fringed.acquisition.states import check_transition
from fringed.data import Truth
from fringed.errors import DeviceAbsent, DeviceError, FringedError
from fringed.hookspecs import Camera, Projector
from fringed.messages import DeviceState, DeviceStateName

log = logging.getLogger(__name__)
DARK: tuple[DeviceStateName, ...] = ("STANDBY", "WARMING", "COOLING")
"""What a projector with a `lamp_state` may be instead of at fault."""


@dataclass(frozen=True)
class Rig:
    """The devices of one station, built and not opened; `truth_provider(role)` only for a simulated one."""

    camera: Camera
    projector: Projector
    camera_driver: str
    projector_driver: str
    truth_provider: Callable[[str], Truth | None] | None = None

    @property
    def simulated(self) -> bool:
        """Whether anything of it is simulated."""
        return self.camera.simulated or self.projector.simulated

    @property
    def replayed(self) -> bool:
        """Whether its frames are recordings."""
        return self.camera.replayed


@dataclass(frozen=True)
class Station:
    """Who takes the frames: the rig's name, the calibration's hash, the software."""

    rig: str = ""
    calibration: str = ""
    software: str = ""


class Device:
    """One device, its state and its identity. `report` is told of every change."""

    def __init__(
        self, which: str, driver: str, device: Camera | Projector, report: Callable[[str, DeviceState], None]
    ) -> None:
        self.which, self.driver = which, driver
        self._device, self._report = device, report
        self.state: DeviceStateName = "ABSENT"
        self.identity = ""
        self.detail = "not opened yet"
        self._tried = False

    @property
    def is_open(self) -> bool:
        """Whether it can be used."""
        return self.state not in ("ABSENT", "CONNECTING", "FAULT", *DARK)

    def snapshot(self) -> DeviceState:
        """Return its state as a message."""
        return DeviceState(self.state, self.driver, self.identity, self.detail)

    def go(self, state: DeviceStateName, detail: str = "") -> None:
        """Move to `state` and report it; raises AcquisitionError where that is not legal."""
        if (state, detail) == (self.state, self.detail):
            return
        if state != self.state:
            check_transition(self.which, self.state, state)
        self.state, self.detail = state, detail
        self._report(self.which, self.snapshot())

    def open(self) -> None:
        """Open it, if it is not.

        Raises
        ------
        DeviceError
            it cannot be opened; the state says why.
        """
        if self.is_open:
            return
        reason = self.detail
        check_transition(self.which, self.state, "CONNECTING")
        self.state, self.detail = "CONNECTING", ""
        first = not self._tried  # an absent device is tried again and again: say it once
        if first:
            self._report(self.which, self.snapshot())
        self._tried = True
        try:
            with self.guarded("open"):
                self.identity = self._opened()
        except DeviceError as error:
            changed = first or error.message != reason
            self.state, self.detail = self._state_of(error), error.message
            self._shut()
            if changed:
                self._report(self.which, self.snapshot())
            raise
        self._tried = False
        self.go("IDLE")

    def _opened(self) -> str:
        """Open it; a driver that refuses its options or files is a device that cannot be had."""
        try:
            return self._device.open()
        except DeviceError:
            raise
        except FringedError as error:
            raise DeviceError(f"the {self.which}'s driver {self.driver!r} does not open: {error.message}") from error

    def fail(self, error: DeviceError) -> None:
        """Take note that it failed, and close it, so that it can be opened afresh."""
        if not self.is_open:
            return
        state = self._state_of(error)
        self._shut()
        self.go(state, error.message)

    def _state_of(self, error: DeviceError) -> DeviceStateName:
        """Return what a failed device is: gone, a projector whose lamp is not on, or at fault."""
        lamp = getattr(self._device, "lamp_state", "")
        dark = next((state for state in DARK if state == lamp), None)
        return "ABSENT" if isinstance(error, DeviceAbsent) else dark or "FAULT"

    def close(self) -> None:
        """Close it; harmless when closed."""
        if self.is_open:
            self._shut()
            self.go("ABSENT", "closed")

    def _shut(self) -> None:
        with suppress(FringedError), self.guarded("close"):
            self._device.close()

    @contextmanager
    def guarded(self, doing: str) -> Iterator[None]:
        """Let only errors of this software out; mark those of this device as its own."""
        try:
            yield
        except DeviceError as error:
            blame(error, self)
            raise
        except FringedError:
            raise
        except Exception as error:  # a driver may be anybody's plug-in
            log.exception("the %s's driver %s failed to %s", self.which, self.driver, doing)
            wrapped = DeviceError(
                f"the {self.which}'s driver {self.driver!r} raised {type(error).__name__} at {doing}: {error}"
            )
            blame(wrapped, self)
            raise wrapped from error


def blame(error: DeviceError, device: Device) -> None:
    """Note on `error` which device raised it."""
    error.fringed_device = device  # type: ignore[attr-defined]


def culprit(error: DeviceError) -> Device | None:
    """Return the device that raised `error`, if one did."""
    found = getattr(error, "fringed_device", None)
    return found if isinstance(found, Device) else None
