"""Requests about a device's own settings: read and set between two scans.

Owns these verbs; the devices are the acquisition thread's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from fringed.errors import FringedError
from fringed.hookspecs import Setting
from fringed.serving.house import House
from fringed.serving.leases import Leases
from fringed.serving.requests import LATER, Call, Verb

Ask = Callable[..., Any]


@dataclass
class DeviceVerbs:
    """The verbs, on what they need; `ask(which, done, failed, name, value)` queues a question."""

    house: House
    leases: Leases
    ask: Ask

    def table(self) -> dict[str, Verb]:
        """Return the verbs by name."""
        return {"device.get": self._get, "device.set": self._set}

    def _get(self, call: Call) -> Any:
        call.allow("device")
        self._queue(call, "", None)
        return LATER

    def _set(self, call: Call) -> Any:
        call.allow("device", "name", "value")
        self.leases.check(call.request.lease, self.house.reactor.now())
        self._queue(call, call.get("name", str), call.request.params.get("value"))
        return LATER

    def _queue(self, call: Call, name: str, value: Any) -> None:
        def done(found: list[Setting]) -> None:
            answer = {"settings": [asdict(setting) for setting in found]}
            self.house.reactor.post(partial(call.reply, answer))

        def failed(error: FringedError) -> None:
            self.house.reactor.post(partial(call.fail, error))

        self.ask(call.get("device", str), done, failed, name, value)
