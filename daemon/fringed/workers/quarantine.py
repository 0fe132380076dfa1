"""What is not tried again: failures in a row, and those that are given up with their reason.

Owns the counts and entries; knows no worker.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime

from fringed.messages import ErrorInfo, QuarantineEntry


class Quarantine:
    """Failures in a row of each (subject, pipeline), and those that are given up."""

    def __init__(self, attempts: int) -> None:
        self.attempts = attempts
        self._failures: dict[tuple[str, str], int] = {}
        self._entries: dict[tuple[str, str], QuarantineEntry] = {}

    @property
    def entries(self) -> tuple[QuarantineEntry, ...]:
        """Everything that is not tried again, oldest first."""
        return tuple(self._entries.values())

    def find(self, subject: str, pipeline: str) -> QuarantineEntry | None:
        """Return why this is not tried again, or None."""
        return self._entries.get((subject, pipeline))

    def failed(self, subject: str, pipeline: str, reason: str) -> QuarantineEntry | None:
        """Count one failure; return the entry when it was one too many."""
        key = (subject, pipeline)
        count = self._failures[key] = self._failures.get(key, 0) + 1
        if count < self.attempts:
            return None
        created = datetime.now(UTC).isoformat(timespec="milliseconds")
        del self._failures[key]
        self._entries[key] = QuarantineEntry(subject, pipeline, reason, count, created)
        return self._entries[key]

    def restore(self, entries: Iterable[QuarantineEntry]) -> None:
        """Take over what an earlier run gave up."""
        self._entries.update({(entry.subject, entry.pipeline): entry for entry in entries})

    def succeeded(self, subject: str, pipeline: str) -> None:
        """Forget earlier failures: they were not the subject's."""
        self._failures.pop((subject, pipeline), None)

    def clear(self, subject: str = "") -> int:
        """Allow `subject` (empty: everything) again; return how many entries went."""
        keys = [key for key in self._entries if not subject or key[0] == subject]
        for key in keys:
            del self._entries[key]
        for key in [key for key in self._failures if not subject or key[0] == subject]:
            del self._failures[key]
        return len(keys)

    def refusal(self, subject: str, pipeline: str) -> ErrorInfo | None:
        """Return what to tell whoever asks for this again, or None where it may be tried."""
        entry = self.find(subject, pipeline)
        if entry is None:
            return None
        return ErrorInfo(
            "Quarantined",
            f"{subject} with pipeline {pipeline!r} is quarantined after {entry.attempts} failures: {entry.reason}; "
            f"when the cause is gone, allow it again with quarantine.clear",
        )
