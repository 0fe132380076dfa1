"""The store: every frame set and product as a file of its own, found by id, listed newest first.

Owns the data folder. Several threads may use it; a file becomes visible whole or not at all, so nothing
needs repairing after a kill at any moment.
"""

from __future__ import annotations

import fcntl
import logging
import os
import threading
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy.typing as npt

from fringed.data import RECORDED, PatternSequence
from fringed.errors import DataError, NotFound, RecordingError, StorageError, UsageError
from fringed.messages import QuarantineEntry
from fringed.recording import disk, hdf5, places
from fringed.recording.facts import time_of
from fringed.recording.partial import Partial
from fringed.recording.preface import Summary, clipped
from fringed.recording.quarantine import QuarantineFile
from fringed.recording.sealing import check_whole, read_preface
from fringed.recording.writer import SetWriter
from fringed.tree import join
from fringed.wire import KINDS, Encoded, prepare

log = logging.getLogger(__name__)

CACHED_SUMMARIES = 20_000
QUARANTINE = "quarantine.json"


class Store:
    """The recordings of one station, in one folder."""

    def __init__(self, data_dir: Path) -> None:
        self.data_dir = data_dir
        self._summaries: OrderedDict[str, Summary] = OrderedDict()
        self._lock = threading.Lock()
        self._quarantine: QuarantineFile | None = None

    def recover(self) -> int:
        """Make the folder if need be, remove what dead writers left, and return how many files that were.

        Raises
        ------
        StorageError
            the folder cannot be made, read or written.
        """
        with disk.storage_errors(self.data_dir, making=not self.data_dir.exists()):
            disk.make_folder(self.data_dir)
            probe = self.data_dir / f"probe-{os.getpid()}{places.PART}"
            probe.write_bytes(b"writable?")
            probe.unlink()
        removed = [path for path in places.parts(self.data_dir) if _remove_dead(path)]
        if removed:
            log.warning(
                "%d unfinished recordings removed from %s: %s",
                len(removed), self.data_dir, ", ".join(p.name for p in removed[:5]),
            )  # fmt: skip
        return len(removed)

    def begin_set(
        self, set_id: str, sequence: PatternSequence, shape: tuple[int, ...], dtype: npt.DTypeLike
    ) -> SetWriter:
        """Begin a frame set of frames `(height, width)`, or `(n, height, width)`, of uint8 or uint16.

        Raises
        ------
        StorageError
            no room, or no right, to write it.
        """
        return SetWriter(self.data_dir, set_id, sequence, shape, dtype, self._remember)

    def save(self, product: Any, record_id: str = "", encoded: Encoded | None = None) -> Path:
        """Record a frame set or product under its own id, or `record_id` where it has none; return its path.

        Give `encoded`, the result of `wire.prepare`, if it is at hand: it is not encoded twice then.

        Raises
        ------
        DataError
            it has no id, or is of a kind that is not recorded.
        UsageError
            that id is recorded already, or is no id.
        StorageError
            the disk refuses; nothing stays visible.
        """
        own_id = getattr(product, "id", "")
        record_id = record_id or own_id
        kind = type(product).__name__
        if type(product) not in RECORDED:
            raise DataError(f"a {kind} is not recorded; there are {', '.join(c.__name__ for c in RECORDED)}")
        if not record_id:
            raise DataError(f"this {kind} has no id; give it one with data.new_id() before it is recorded")
        if own_id not in ("", record_id):
            raise DataError(f"this {kind} is called {own_id}; it cannot be recorded as {record_id}")
        encoded = encoded or prepare(product)
        partial = Partial(self.data_dir, record_id, kind, encoded.headers, encoded)
        for header, buffer in zip(encoded.headers, encoded.buffers, strict=True):
            partial.write(header["path"], buffer)
        self._remember(partial.path, partial.commit(encoded))
        return partial.path

    def load(self, record_id: str, verify: bool = True) -> Any:
        """Return the object recorded under an id, every checksum verified.

        Raises
        ------
        NotFound
            there is none.
        RecordingError
            the file is foreign, truncated or damaged.
        """
        path = places.find(self.data_dir, record_id)
        content = load_file(path, verify)
        if getattr(content, "id", record_id) not in (record_id, ""):
            raise RecordingError(f"{path.name} was renamed: it holds {content.id}; give it its name back")
        return content

    def path_of(self, record_id: str) -> Path:
        """Return the file of an id; raises NotFound."""
        return places.find(self.data_dir, record_id)

    def list(
        self, kind: str | None = None, scan: str | None = None, limit: int = 100, before: str | None = None
    ) -> list[dict[str, Any]]:
        """Return the newest recordings as dicts: id, kind, created, scan, role, bytes, simulated, replayed, summary.

        `before` is an id (or the beginning of one): only older ones are listed. A damaged file is listed
        with what is wrong as its summary.
        """
        wanted = places.kind_named(kind) if kind else ""
        if limit < 0:
            raise UsageError(f"limit is {limit}; expected 0 or more")
        found: list[dict[str, Any]] = []
        for record_id, its_kind, path in places.newest_first(self.data_dir, before or ""):
            if len(found) >= limit:
                break
            if wanted and its_kind != wanted:
                continue
            summary = self._summary(record_id, its_kind, path)
            if summary is not None and (not scan or summary.scan == scan):
                found.append(msgspec.structs.asdict(summary))
        return found

    def free_bytes(self) -> int:
        """Return the room left for recordings; 0 where the folder is gone."""
        return disk.free_bytes(self.data_dir)

    def quarantine(self) -> tuple[QuarantineEntry, ...]:
        """Return what is not tried again."""
        return self._quarantined().entries()

    def add_quarantine(self, entry: QuarantineEntry) -> None:
        """Remember an entry; raises StorageError where it could not be written down (it is in force all the same)."""
        self._quarantined().add(entry)

    def clear_quarantine(self, subject: str = "") -> int:
        """Drop the entries of a subject, or all of them; return how many."""
        return self._quarantined().clear(subject)

    def _quarantined(self) -> QuarantineFile:
        with self._lock:
            if self._quarantine is None:
                self._quarantine = QuarantineFile(self.data_dir / QUARANTINE)
            return self._quarantine

    def _remember(self, path: Path, summary: Summary) -> None:
        with self._lock:
            self._summaries[path.name] = summary
            while len(self._summaries) > CACHED_SUMMARIES:
                self._summaries.popitem(last=False)

    def _summary(self, record_id: str, kind: str, path: Path) -> Summary | None:
        known = self._summaries.get(path.name)
        if known is not None:
            return known
        try:
            summary = summary_of_file(path)
            if summary.id != record_id:
                raise RecordingError(f"{path.name} was renamed: it holds {summary.id}")
        except FileNotFoundError:  # removed since its folder was read
            return None
        except (RecordingError, OSError) as error:
            return Summary(id=record_id, kind=kind, created=time_of(record_id), summary=clipped(f"unreadable: {error}"))
        self._remember(path, summary)
        return summary


def summary_of_file(path: Path) -> Summary:
    """Read a file's summary, and no more than its first block.

    Raises
    ------
    RecordingError
        a foreign file or a damaged block.
    OSError
        it cannot be opened.
    """
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return read_preface(fd, path.name).summary
    finally:
        os.close(fd)


def load_file(path: Path, verify: bool = True) -> Any:
    """Read any recording by its path.

    Raises
    ------
    NotFound
        there is no such file.
    RecordingError
        it is foreign, truncated or damaged.
    StorageError
        it may not be read, or the disk fails.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise NotFound(f"there is no recording {path}") from error
    except OSError as error:
        raise StorageError(f"{path} cannot be read: {error.strerror}; check its rights and the disk") from error
    try:
        with disk.storage_errors(path.parent):
            found = read_preface(fd, path.name)
            check_whole(fd, found, path.name)
        kind, tree, arrays = hdf5.read(path, fd, verify)
        if kind not in KINDS or KINDS[kind] not in RECORDED:
            raise RecordingError(f"{path.name} holds a {kind[:40]!r}; this release reads {', '.join(sorted(KINDS))}")
        return join(tree, KINDS[kind], arrays, KINDS)
    except RecordingError:
        raise
    except DataError as error:
        raise RecordingError(f"{path.name} holds what this release cannot read: {error}") from error
    finally:
        os.close(fd)


def _remove_dead(path: Path) -> bool:
    """Remove a partial file unless a living writer holds its lock; return whether it was removed."""
    with suppress(OSError):
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
            return True
        except BlockingIOError:
            log.info("%s is being written by another process", path)
        finally:
            os.close(fd)
    return False
