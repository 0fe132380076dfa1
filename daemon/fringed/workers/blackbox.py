"""A page of memory that survives its worker: what it was doing when it died.

Owns the page; a message would not do, because a process that dereferences null takes its unsent messages
along. The supervisor creates it, the worker writes it, both by file descriptor.
"""

from __future__ import annotations

import mmap
import os

_SIZE = 512


class BlackBox:
    """The last words of one worker; its process inherits `descriptor`."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._page = mmap.mmap(descriptor, _SIZE)

    @classmethod
    def create(cls) -> BlackBox:
        """Make an empty one."""
        descriptor = os.memfd_create("fringed-worker", os.MFD_CLOEXEC)
        os.ftruncate(descriptor, _SIZE)
        return cls(descriptor)

    def write(self, text: str) -> None:
        """Replace the last words."""
        raw = text.encode()[: _SIZE - 1]
        self._page[: len(raw) + 1] = raw + b"\0"

    def read(self) -> str:
        """Return the last words."""
        return self._page[:].split(b"\0", 1)[0].decode(errors="replace")

    def close(self) -> None:
        """Let go of the page."""
        if self.descriptor >= 0:
            self._page.close()
            os.close(self.descriptor)
            self.descriptor = -1
