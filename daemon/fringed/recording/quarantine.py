"""What is not tried again, kept across restarts as one small JSON file.

Owns that file; knows nothing of why something was quarantined.
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path

import msgspec

from fringed.messages import QuarantineEntry
from fringed.recording.disk import make_folder, replace_file, storage_errors

log = logging.getLogger(__name__)


class QuarantineFile:
    """The entries, in memory and on the disk."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._entries = self._load()

    def entries(self) -> tuple[QuarantineEntry, ...]:
        """Return the entries, oldest first."""
        return self._entries

    def add(self, entry: QuarantineEntry) -> None:
        """Add an entry, in place of one of the same subject and pipeline; raises StorageError."""
        with self._lock:
            others = [e for e in self._entries if (e.subject, e.pipeline) != (entry.subject, entry.pipeline)]
            self._save((*others, entry))

    def clear(self, subject: str = "") -> int:
        """Drop the entries of a subject, or all; return how many; raises StorageError."""
        with self._lock:
            kept = tuple(e for e in self._entries if subject and e.subject != subject)
            cleared = len(self._entries) - len(kept)
            if cleared:
                self._save(kept)
            return cleared

    def _save(self, entries: tuple[QuarantineEntry, ...]) -> None:
        self._entries = entries  # in force even where the disk refuses to remember it
        with storage_errors(self._path.parent):
            make_folder(self._path.parent)
            replace_file(self._path, msgspec.json.format(msgspec.json.encode(entries), indent=1))

    def _load(self) -> tuple[QuarantineEntry, ...]:
        try:
            return msgspec.json.decode(self._path.read_bytes(), type=tuple[QuarantineEntry, ...])
        except FileNotFoundError:
            return ()
        except ValueError as error:
            aside = self._path.with_suffix(".damaged")
            log.error("the quarantine %s is damaged (%s); it is put aside as %s", self._path, error, aside.name)
            with storage_errors(self._path.parent):
                self._path.rename(aside)
            return ()
        except OSError as error:
            log.error("the quarantine %s cannot be read: %s", self._path, error)
            return ()
