"""The workers that said READY: what they have, and who takes the next job.

Owns one record for each; starts and ends none.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from fringed.messages import Job, PluginInfo, StageCall, WorkerReady

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class Peer:
    """One worker that said READY. It works on the first of `jobs`."""

    name: str
    pid: int
    capacity: int
    heard_s: float
    plugins: tuple[PluginInfo, ...]
    schemas: Mapping[str, Any]
    takes_feeds: bool = False
    jobs: list[str] = field(default_factory=list)
    done: int = 0

    @classmethod
    def of(cls, ready: WorkerReady, name: str, now: float) -> Peer:
        """Return the record of a worker that just said READY."""
        schemas = {kind: table for kind, table in ready.schemas.items() if isinstance(table, Mapping)}
        return cls(name, ready.pid, min(ready.credits, 64), now, ready.plugins, schemas, ready.feeds)

    @property
    def credits(self) -> int:
        """How many more jobs it takes."""
        return max(0, self.capacity - len(self.jobs))

    def provides(self, stages: Iterable[StageCall]) -> bool:
        """Tell whether it has every plug-in that the stages need."""
        return all(stage.plugin in self.schemas.get(stage.kind, ()) for stage in stages)


class Roster(dict[str, Peer]):
    """All of them, by name."""

    def __init__(self) -> None:
        super().__init__()
        self._told: set[tuple[str, str]] = set()

    def join(self, peer: Peer) -> None:
        """Take one in; each plug-in that it could not load is logged once."""
        self[peer.name] = peer
        for info in peer.plugins:
            if info.error and (info.name, info.error) not in self._told:
                self._told.add((info.name, info.error))
                _log.warning("the plug-in %s (%s) is broken: %s", info.name, info.distribution, info.error[-500:])

    def choose(self, job: Job, avoid: str, rank: Callable[[str, Job], int]) -> Peer | None:
        """Return a worker with a free credit and the plug-ins, rather not `avoid`; None where all are busy.

        `rank` tells how fit a worker is: 0 not at all, 3 before everybody else.
        """
        able: Iterable[Peer] = [peer for peer in self.values() if peer.provides(job.stages)]
        able = able or self.values()  # nobody has the plug-in: let one tell which there are
        ranked = [(rank(peer.name, job), peer) for peer in able if peer.credits > 0]
        fit = [(rank == 3, peer.name != avoid, rank, peer.credits, peer) for rank, peer in ranked if rank]
        return max(fit, key=lambda one: one[:4])[-1] if fit else None

    def plugins(self) -> tuple[PluginInfo, ...]:
        """Return what the workers loaded, each plug-in once, sorted; a broken one only where none works."""
        found: dict[tuple[str, str], PluginInfo] = {}
        for info in (info for peer in self.values() for info in peer.plugins):
            key = (info.name, info.distribution)
            if key not in found or found[key].error:
                found[key] = info
        return tuple(found[key] for key in sorted(found))

    def schemas(self) -> dict[str, dict[str, Any]]:
        """Return the JSON Schemas of all parameters, by kind and name."""
        merged: dict[str, dict[str, Any]] = {}
        for peer in self.values():
            for kind, schemas in peer.schemas.items():
                merged.setdefault(kind, {}).update(schemas)
        return merged
