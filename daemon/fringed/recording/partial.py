"""A recording while it is written: a `.part` file with a lock that tells a living writer from a dead one.

Owns the way from nothing to a visible file: lay out, write, seal, sync, rename, sync the folder.
"""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fringed.data import Array
from fringed.errors import StorageError, UsageError
from fringed.recording import hdf5
from fringed.recording.disk import free_bytes, make_folder, storage_errors, sync_folder, write_at
from fringed.recording.facts import summary_of
from fringed.recording.places import PART, place
from fringed.recording.preface import LARGE_BYTES, Summary
from fringed.recording.sealing import seal
from fringed.wire import Encoded

_METADATA_BYTES = 256 * 1024  # what HDF5 adds to the arrays, amply


class Partial:
    """One file on its way to be visible. Not for several threads at once.

    Every method raises StorageError where the disk refuses; the partial file is then gone.
    """

    def __init__(
        self, root: Path, record_id: str, kind: str, headers: hdf5.Headers, encoded: Encoded | None = None
    ) -> None:
        self.path = place(root, record_id, kind)
        self.record_id = record_id
        self._root = root
        self._part = self.path.with_name(self.path.name + PART)
        self._needed = sum(hdf5.nbytes(header) for header in headers) + _METADATA_BYTES
        self._sizes = {header["path"]: hdf5.nbytes(header) for header in headers}
        self._annotated = encoded is not None
        self._described = frozenset(header["path"] for header in headers if "xxh3" in header)
        self._fd = -1
        if self.path.exists():
            raise UsageError(f"{record_id} is recorded already; a recording is never overwritten: give it a new id")
        self._open(headers, encoded)

    def _open(self, headers: hdf5.Headers, encoded: Encoded | None) -> None:
        with self._or_abort():
            make_folder(self.path.parent)
            if free_bytes(self.path.parent) < self._needed:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._fd = os.open(self._part, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._offsets = hdf5.lay_out(self._part, headers, encoded, self.record_id)
            os.posix_fallocate(self._fd, 0, os.fstat(self._fd).st_size)

    def write(self, path: str, data: Array, at_byte: int = 0) -> None:
        """Write an array's bytes, or a part of them from `at_byte` on."""
        offset = self._offsets[path]
        if offset is None:
            return
        self._check_open()
        with self._or_abort():
            write_at(self._fd, data, offset + at_byte)

    def commit(self, encoded: Encoded) -> Summary:
        """Make the file lasting and visible; return its summary."""
        self._check_open()
        with self._or_abort():
            if not self._annotated:
                hdf5.annotate(self._part, encoded, self.record_id, self._described)
            extents = [
                (offset, self._sizes[path])
                for path, offset in self._offsets.items()
                if offset is not None and self._sizes[path] >= LARGE_BYTES
            ]
            summary = seal(self._fd, summary_of(encoded, self.record_id, 0), extents)
            os.fsync(self._fd)
            # The next recording takes these pages again. Fresh ones cost up to 3 ms a MB on a virtual machine, and an
            # endless recording would push everything else out of the page cache.
            os.posix_fadvise(self._fd, 0, 0, os.POSIX_FADV_DONTNEED)
            self._part.rename(self.path)
            self._part = self.path  # where the folder cannot be synced, giving up removes that
            sync_folder(self.path.parent)
            os.close(self._fd)
            self._fd = -1
        return summary

    def abort(self) -> None:
        """Remove what was written; harmless when done already."""
        if self._fd < 0:
            return
        with suppress(OSError):
            self._part.unlink()
        os.close(self._fd)
        self._fd = -1

    def _check_open(self) -> None:
        if self._fd < 0:
            raise StorageError(f"{self.record_id} is not being written any more: it was committed or given up")

    @contextmanager
    def _or_abort(self) -> Iterator[None]:
        """Turn errors of the disk into StorageError, and remove the partial file on any error."""
        try:
            with storage_errors(self._root, self._needed):
                yield
        except BaseException:
            self.abort()
            raise
