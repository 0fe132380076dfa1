"""Requests about the calibration in force: show it, put another one in force, go back to the one before.

Owns these verbs and the order of the act: checked and written down in the recorder's thread, then in force and
announced in the reactor's. Which one fits, and what is remembered, is the adopter's.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from fringed.config import StationConfig
from fringed.errors import UsageError
from fringed.messages import Event
from fringed.serving.house import House, InForce
from fringed.serving.leases import Leases
from fringed.serving.records import iso_now
from fringed.serving.requests import LATER, Call, Verb
from fringed.wire import TOPIC_EVENT

_log = logging.getLogger(__name__)
Known = dict[str, Any]


class Adopter(Protocol):
    """What knows the rule of which calibration holds."""

    def use(self, config: StationConfig, item: str, by: str) -> InForce:
        """Check a recorded calibration and write down that it holds; raises FringedError."""
        ...

    def revert(self, config: StationConfig, everything: bool, by: str) -> InForce:
        """Write down that the one before holds again, and return it; raises FringedError."""
        ...

    def known(self, config: StationConfig) -> Known:
        """Return what is configured, what has been adopted, and every act."""
        ...


@dataclass
class CalibrationVerbs:
    """The verbs, on what they need; `put_in_force` has the station use a calibration from now on."""

    house: House
    leases: Leases
    adopter: Adopter
    put_in_force: Callable[[InForce], None]

    def table(self) -> dict[str, Verb]:
        """Return the verbs by name."""
        return {"calibration": self._show, "calibration.use": self._use, "calibration.revert": self._revert}

    def _show(self, call: Call) -> Any:
        """Answer with the calibration in force, where it comes from, and every act, the newest first."""
        call.allow()
        return {"in_force": _told(self.house.present.in_force), **self.adopter.known(self.house.present.config)}

    def _use(self, call: Call) -> Any:
        call.allow("id")
        self._may_change(call)
        work = partial(self.adopter.use, self.house.present.config, call.get("id", str), call.request.client)
        return self._act(call, "calibration.adopted", work)

    def _revert(self, call: Call) -> Any:
        call.allow("all")
        self._may_change(call)
        everything = call.get("all", bool, False)
        work = partial(self.adopter.revert, self.house.present.config, everything, call.request.client)
        return self._act(call, "calibration.reverted", work)

    def _may_change(self, call: Call) -> None:
        """Let pass who may move the rig, while no set is taken: its frames name the calibration that they began with.

        Raises
        ------
        LeaseError
            somebody else holds the rig.
        UsageError
            a scan is under way.
        """
        self.leases.check(call.request.lease, self.house.reactor.now())
        taking = [record.id for record in self.house.records.running if record.state in ("encoding", "acquiring")]
        if taking:
            raise UsageError(f"scan {taking[0]} is taking its sets; change the calibration once it has, or cancel it")

    def _act(self, call: Call, name: str, work: Callable[[], InForce]) -> Any:
        def written(found: InForce) -> None:
            self.put_in_force(found)
            told = _told(found)
            _log.warning("%s by %r: %s (%s)", name, call.request.client, told["hash"] or "none", found.origin)
            detail = {**told, "by": call.request.client}
            self.house.stream.publish(Event(name, iso_now(), "info", found.origin, detail), TOPIC_EVENT)
            call.reply({"in_force": told})

        self.house.in_thread(self.house.recorder, work, written, call.fail)
        return LATER


def _told(found: InForce) -> dict[str, Any]:
    calibration = found.calibration
    return {
        "id": (calibration.id or calibration.hash) if calibration else "",
        "hash": calibration.hash if calibration else "",
        "source": calibration.source if calibration else "",
        "rig": calibration.rig if calibration else "",
        "origin": found.origin,
        "problem": found.problem,
    }
