"""Requests about recordings: list, get, import. The disk is touched in the loader's and recorder's threads only.

Owns these verbs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from fringed import wire
from fringed.data import RECORDED, PatternSequence, new_id
from fringed.errors import RequestTimeout, UsageError
from fringed.messages import Reply
from fringed.serving.house import House
from fringed.serving.records import iso_now
from fringed.serving.requests import LATER, Call, Verb


@dataclass
class RecordVerbs:
    """The verbs, on what they need."""

    house: House
    software: str

    def table(self) -> dict[str, Verb]:
        """Return the verbs by name."""
        return {"list": self._list, "get": self._get, "import": self._import}

    def _list(self, call: Call) -> Any:
        call.allow("kind", "scan", "limit", "before")
        kind, scan, before = (call.get(name, str, "") for name in ("kind", "scan", "before"))
        limit = call.get("limit", int, 100)
        if not 0 <= limit <= 100_000:
            raise UsageError(f"list: limit is {limit}; expected 0 to 100000")
        work = partial(self.house.store.list, kind or None, scan or None, limit, before or None)
        self.house.in_thread(self.house.loader, partial(self._encoded, call, work), call.reply, call.fail)
        return LATER

    def _get(self, call: Call) -> Any:
        call.allow("id")
        calibration = self.house.present.calibration
        if calibration is not None and call.get("id", str) in {calibration.hash, calibration.id or calibration.hash}:
            return calibration  # the one in force is a configured file, or the simulated rig's own
        work = partial(self.house.store.load, call.get("id", str))
        self.house.in_thread(self.house.loader, partial(self._encoded, call, work), call.reply, call.fail)
        return LATER

    def _import(self, call: Call) -> Any:
        call.allow("content")
        content = given(call.request.params.get("content"), self.software)

        def recorded(_: wire.Encoded) -> None:
            call.reply({"id": content.id})

        self.house.record(content, recorded, call.fail, lambda: True)
        return LATER

    def _encoded(self, call: Call, work: Callable[[], Any]) -> wire.Encoded:
        """Load and encode the reply in the loader's thread, unless nobody waits for it any more."""
        if self.house.reactor.now() > call.deadline_s:
            raise RequestTimeout(
                f"{call.request.verb} waited longer than its deadline for the disk; try again, or later"
            )
        return wire.prepare(Reply(call.request.id, work()))


def given(content: Any, software: str) -> Any:
    """Return a data object that somebody gave, with an id of this station and marked as given.

    Raises
    ------
    UsageError
        it is not of a kind that is recorded by itself.
    """
    if not isinstance(content, RECORDED) or isinstance(content, PatternSequence):
        kinds = ", ".join(cls.__name__ for cls in RECORDED if cls is not PatternSequence)
        raise UsageError(f"a {type(content).__name__} is not recorded; there are {kinds}")
    item: Any = content
    old = item.provenance
    provenance = replace(
        old,
        plugin=old.plugin or "given",
        inputs=(*old.inputs, *((item.id,) if item.id else ())),
        software=old.software or software,
        created=old.created or iso_now(),
    )
    return replace(item, id=new_id(), provenance=provenance)
