"""Which calibration is in force: the one that the configuration names, or one that somebody put in force.

Owns that rule and the checks before one is put in force; the acts are remembered by `recording.adoption`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import msgspec

from fringed.assembly.loading import load_calibration
from fringed.config import StationConfig
from fringed.data import Calibration
from fringed.devices.building import Devices
from fringed.errors import DataError, FringedError, UsageError
from fringed.recording import Store
from fringed.recording.adoption import NAME, Adoption, AdoptionFile
from fringed.serving.house import InForce
from fringed.serving.records import iso_now
from fringed.serving.verbs_calibration import Known

_log = logging.getLogger(__name__)
OPEN = ("adopted", "simulated")
"""What `calibration` may say for others to be put in force; anything else is a file's path, empty is none."""
_WORDS = {"": "none is configured", "adopted": "none is adopted yet", "simulated": "exact, the simulated rig's own"}


class Adopter:
    """The rule, on the store, the file of acts, and the rig that a calibration has to fit."""

    def __init__(self, store: Store, devices: Devices, rig: str) -> None:
        self._store, self._devices, self._rig = store, devices, rig
        self._file = AdoptionFile(store.data_dir / NAME)

    def read(self, config: StationConfig) -> InForce:
        """Return what is in force with a configuration, at start and at a reload.

        An adopted calibration that cannot be had or does not fit is said and logged, and what the configuration says
        by itself holds.

        Raises
        ------
        ConfigurationError
            the configured file cannot be used.
        """
        stack = self._file.stack
        if config.calibration not in OPEN or not stack:
            return self._configured(config)
        try:
            return self._loaded(stack[-1])
        except FringedError as error:
            found = self._configured(config)
            problem = f"the adopted calibration {stack[-1].id} is not in force: {error.message}"
            _log.error("%s; in force: %s", problem, found.origin)
            return InForce(found.calibration, found.origin, problem)

    def use(self, config: StationConfig, item: str, by: str) -> InForce:
        """Check a recorded calibration and write down that it is in force from now on.

        Raises
        ------
        UsageError
            the configuration names a file, or none at all.
        DataError
            it is something else, or of another rig or size.
        NotFound, RecordingError, StorageError
            it cannot be read, or the act cannot be written.
        """
        self._check_open(config)
        found = self._store.load(item)
        if not isinstance(found, Calibration):
            raise DataError(f"{item} is a {type(found).__name__}; expected the id of a Calibration (`fringe list`)")
        self._check_fits(found)
        act = Adoption(action="use", id=item, hash=found.hash, rig=found.rig, time=iso_now(), by=by)
        self._file.append(act)
        return InForce(found, _origin(act))

    def revert(self, config: StationConfig, everything: bool, by: str) -> InForce:
        """Go back to the calibration before the one in force, or to what the configuration says by itself.

        Raises
        ------
        UsageError
            as above, or there is nothing to go back from.
        DataError, NotFound, RecordingError, StorageError
            the one before cannot be had or does not fit; nothing changes.
        """
        self._check_open(config)
        stack = self._file.stack
        if not stack:
            raise UsageError("no calibration has been adopted, so there is none to go back from; adopt one with `use`")
        before = stack[-2] if len(stack) > 1 and not everything else None
        found = self._loaded(before) if before else self._configured(config)
        gone = "" if before is None else stack[-1].id
        digest = found.calibration.hash if found.calibration else ""
        self._file.append(Adoption(action="revert", id=gone, hash=digest, rig=self._rig, time=iso_now(), by=by))
        return found

    def known(self, config: StationConfig) -> Known:
        """Return what is configured, whether another can be put in force, and every act, the newest first."""
        refusal = ""
        try:
            self._check_open(config)
        except UsageError as error:
            refusal = error.message
        return {
            "configured": config.calibration, "refusal": refusal,
            "adopted": [act.id for act in reversed(self._file.stack)],
            "history": [msgspec.to_builtins(act) for act in reversed(self._file.history)],
        }  # fmt: skip

    def _configured(self, config: StationConfig) -> InForce:
        found = load_calibration(config, self._devices.rig)
        return InForce(found, _WORDS.get(config.calibration, f"the configured file {config.calibration}"))

    def _loaded(self, act: Adoption) -> InForce:
        found = self._store.load(act.id)
        if not isinstance(found, Calibration) or found.hash != act.hash:
            digest = getattr(found, "hash", type(found).__name__)
            raise DataError(
                f"the recording {act.id} holds {digest}, not {act.hash} that was adopted; adopt another one"
            )
        self._check_fits(found)
        return InForce(found, _origin(act))

    def _check_open(self, config: StationConfig) -> None:
        if config.calibration in OPEN:
            return
        if not config.calibration:
            raise UsageError(
                'the configuration says calibration = "", which is none for good; leave the line out or say "adopted", '
                "and reload it (SIGHUP)"
            )
        raise UsageError(
            f"the configuration names the file {config.calibration}, which holds until it is changed: set calibration "
            f'= "adopted" there and reload it (SIGHUP), or name another file'
        )

    def _check_fits(self, found: Calibration) -> None:
        """Raise DataError with both values where it is not of this rig."""
        if found.rig and found.rig != self._rig:
            raise DataError(
                f"it is of the rig {found.rig!r}, this station's is {self._rig!r}; calibrate this one with "
                "`fringe calibrate`"
            )
        for name, lens in (("camera", found.camera), ("projector", found.projector)):
            there = _size_of(lambda name=name: getattr(self._devices, name).size_px)  # type: ignore[misc]
            if there is not None and there != (lens.width_px, lens.height_px):
                raise DataError(
                    f"it is of a {name} with {lens.width_px} x {lens.height_px} pixels, this station's has {there[0]} "
                    f"x {there[1]}; calibrate this one with `fringe calibrate`"
                )


def _size_of(ask: Callable[[], Any]) -> tuple[int, int] | None:
    """Return a device's size, None where it does not tell: one that is absent, or not opened yet."""
    try:
        width, height = ask()
    except Exception:  # noqa: BLE001  a driver may be anybody's plug-in; scans check the size again
        return None
    return (int(width), int(height)) if width > 0 and height > 0 else None


def _origin(act: Adoption) -> str:
    return f"{act.id}, adopted {act.time[:19].replace('T', ' ')} by {act.by}"
