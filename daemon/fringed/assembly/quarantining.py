"""Keeps the quarantine across restarts: what the dispatcher gives up is written down by the store.

Owns the comparison of the two; the disk is touched in the recorder's thread only.
"""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

from fringed.messages import QuarantineEntry
from fringed.recording import Store
from fringed.serving.house import House
from fringed.workers.quarantine import Quarantine

_log = logging.getLogger(__name__)


class QuarantineKeeper:
    """Called every second; restores once, then follows."""

    def __init__(self, house: House, quarantine: Quarantine, store: Store) -> None:
        self._house = house
        self._quarantine = quarantine
        self._store = store
        quarantine.restore(store.quarantine())
        self._written = quarantine.entries

    def __call__(self) -> None:
        """Write down what has changed."""
        entries = self._quarantine.entries
        if entries == self._written:
            return
        old, self._written = self._written, entries
        for entry in entries:
            if entry not in old:
                _log.error("%s with pipeline %r is quarantined: %s", entry.subject, entry.pipeline, entry.reason)
        work = partial(_write, self._store, old, entries)
        self._house.in_thread(self._house.recorder, work, _ignore, _ignore)


def _write(store: Store, old: tuple[QuarantineEntry, ...], new: tuple[QuarantineEntry, ...]) -> None:
    for subject in {entry.subject for entry in old if entry not in new}:
        store.clear_quarantine(subject)
    known = store.quarantine()
    for entry in new:
        if entry not in known:
            store.add_quarantine(entry)


def _ignore(_: Any) -> None:
    return
