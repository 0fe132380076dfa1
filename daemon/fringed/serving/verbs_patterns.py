"""Requests about patterns: what an encoder would project, without projecting it.

Owns this verb. A worker makes the patterns, as for a scan; nothing is recorded and the rig is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from fringed import wire
from fringed.data import PatternSequence
from fringed.errors import DeviceAbsent, UsageError
from fringed.messages import ErrorInfo, Reply, StageCall
from fringed.serving.house import House
from fringed.serving.requests import LATER, Call, Verb
from fringed.serving.schemas import check_stages
from fringed.serving.sequences import Sequences

_WAITING_MAX = 32
_SIZE_MAX_PX = 16384


class Panel(Protocol):
    """What knows the projector's size."""

    def size_px(self) -> tuple[int, int]:
        """Return width and height; raises DeviceAbsent where there is no projector."""
        ...


@dataclass
class PatternVerbs:
    """The verb, on what it needs."""

    house: House
    sequences: Sequences
    panel: Panel
    waiting: int = 0

    def table(self) -> dict[str, Verb]:
        """Return the verb by its name."""
        return {"patterns": self._patterns}

    def _patterns(self, call: Call) -> Any:
        """Answer with the PatternSequence that a scan with this encoder would project.

        The size is the projector's where it is not given, the tone curve that of the calibration in force.
        """
        call.allow("encoder", "params", "width_px", "height_px")
        if self.waiting >= _WAITING_MAX:
            raise UsageError(f"{self.waiting} requests for patterns wait already; wait for some of them")
        stage = StageCall("patterns", "encoder", call.get("encoder", str), call.get("params", dict, {}))
        check_stages((stage,), self.house.hosts.schemas())
        size_px = self._size(call)
        calibration = self.house.present.calibration
        curve = calibration.tone_curve if calibration else None
        self.waiting += 1
        self.sequences.get(stage, size_px, curve, partial(self._made, call), partial(self._failed, call))
        return LATER

    def _size(self, call: Call) -> tuple[int, int]:
        width, height = call.get("width_px", int, 0), call.get("height_px", int, 0)
        if not width and not height:
            try:
                return self.panel.size_px()
            except DeviceAbsent as error:
                raise UsageError("patterns: this station has no projector; give width_px and height_px") from error
        if not (1 <= width <= _SIZE_MAX_PX and 1 <= height <= _SIZE_MAX_PX):
            raise UsageError(
                f"patterns: width_px is {width} and height_px {height}; give both, 1 to {_SIZE_MAX_PX}, or neither"
            )
        return width, height

    def _made(self, call: Call, sequence: PatternSequence) -> None:
        self.waiting -= 1
        work = partial(wire.prepare, Reply(call.request.id, sequence))  # dithered patterns are many bytes to checksum
        self.house.in_thread(self.house.loader, work, call.reply, call.fail)

    def _failed(self, call: Call, error: ErrorInfo) -> None:
        self.waiting -= 1
        call.refuse(error)
