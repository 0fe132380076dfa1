"""Requests about the station itself: who it is, how it is, who holds it, what it can do.

Owns these verbs; each reads its parameters, asks one object and returns.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from fringed.config import FAULTS, effective
from fringed.errors import FringedError, UsageError
from fringed.messages import Event, StationState
from fringed.serving.house import House
from fringed.serving.leases import Leases
from fringed.serving.records import iso_now
from fringed.serving.requests import LATER, Call, Verb
from fringed.wire import TOPIC_EVENT

_log = logging.getLogger(__name__)


class Simulator(Protocol):
    """What can be ordered of a simulated rig."""

    def set_scene(
        self, scene: Mapping[str, Any], done: Callable[[Any], None], failed: Callable[[FringedError], None]
    ) -> None:
        """Put another scene in front of it; `done`, with the former scene, or `failed` is called later."""

    def order_fault(self, fault: str, count: int) -> None:
        """Have the next `count` frames struck by a fault."""


@dataclass
class StationVerbs:
    """The verbs, on what they need."""

    house: House
    leases: Leases
    hello: Callable[[bool], dict[str, Any]]
    state: Callable[[], StationState]
    reload: Callable[[], dict[str, list[str]]]
    simulator: Simulator | None

    def table(self) -> dict[str, Verb]:
        """Return the verbs by name."""
        return {
            "hello": self._hello, "status": self._status, "config": self._config, "plugins": self._plugins,
            "lease.acquire": self._acquire, "lease.renew": self._renew, "lease.release": self._release,
            "lease.break": self._break, "quarantine.clear": self._clear, "reload": self._reload,
            "simulate.scene": self._scene, "simulate.fault": self._fault,
        }  # fmt: skip

    def _hello(self, call: Call) -> Any:
        call.allow()
        return self.hello(call.remote)

    def _status(self, call: Call) -> Any:
        call.allow()
        return self.state()

    def _config(self, call: Call) -> Any:
        call.allow()
        return effective(self.house.present.config)

    def _plugins(self, call: Call) -> Any:
        call.allow()
        return {"plugins": list(self.house.hosts.plugins()), "schemas": self.house.hosts.schemas()}

    def _acquire(self, call: Call) -> Any:
        call.allow("holder", "ttl_s", "scope")
        holder, now = call.get("holder", str), self.house.reactor.now()
        lease = self.leases.acquire(holder[:200], call.get("ttl_s", float), call.get("scope", str, "rig"), now)
        _log.info("lease of the %s acquired by %s for %g s", lease.scope, lease.holder, lease.ttl_s)
        return {"token": lease.token, "expires_in_s": lease.ttl_s}

    def _renew(self, call: Call) -> Any:
        call.allow()
        lease = self.leases.renew(call.request.lease, self.house.reactor.now())
        return {"token": lease.token, "expires_in_s": lease.ttl_s}

    def _release(self, call: Call) -> Any:
        call.allow()
        lease = self.leases.release(call.request.lease, self.house.reactor.now())
        _log.info("lease of the %s released by %s", lease.scope, lease.holder)
        return {}

    def _break(self, call: Call) -> Any:
        call.allow("reason", "scope")
        reason = call.get("reason", str)
        lease = self.leases.force(call.get("scope", str, "rig"), self.house.reactor.now())
        holder = lease.holder if lease else ""
        _log.warning("lease of %r broken by %r: %s", holder, call.request.client, reason[:500])
        self.house.counters["leases_broken"] += bool(lease)
        detail = {"holder": holder, "by": call.request.client, "reason": reason[:500]}
        self.house.stream.publish(Event("lease.broken", iso_now(), "warning", f"held by {holder}", detail), TOPIC_EVENT)
        return {"broken": holder}

    def _clear(self, call: Call) -> Any:
        call.allow("subject")
        cleared = self.house.hosts.clear_quarantine(call.get("subject", str, ""))
        _log.warning("quarantine cleared by %r: %d", call.request.client, cleared)
        return {"cleared": cleared}

    def _reload(self, call: Call) -> Any:
        call.allow()
        return self.reload()

    def _scene(self, call: Call) -> Any:
        call.allow("scene")
        simulator = self._simulated(call)
        taking = [record.id for record in self.house.records.running if record.state == "acquiring"]
        if taking:  # its truth would be that of another scene
            raise UsageError(f"scan {taking[0]} is taking its sets; change the scene once it has, or cancel it")
        simulator.set_scene(call.get("scene", dict), lambda before: call.reply({"before": before}), call.fail)
        return LATER

    def _fault(self, call: Call) -> Any:
        call.allow("fault", "count")
        simulator = self._simulated(call)
        fault, count = call.get("fault", str), call.get("count", int, 1)
        if fault not in FAULTS or not 0 <= count <= 1_000_000:
            raise UsageError(
                f"simulate.fault {fault!r} x {count}; expected one of {', '.join(FAULTS)}, 0 to 1000000 times"
            )
        simulator.order_fault(fault, count)
        return {}

    def _simulated(self, call: Call) -> Simulator:
        self.leases.check(call.request.lease, self.house.reactor.now())
        if self.simulator is None:
            raise UsageError(f"{call.request.verb} needs a simulated rig; this station's camera is not simulated")
        return self.simulator
