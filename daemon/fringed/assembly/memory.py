"""Give memory back that nobody uses: freed arrays, and the code of a compiler that has done its work.

Owns when; the C library and the kernel own how. numba's LLVM alone is 60 MB of code that the simulated rig runs
once, when its kernels are loaded; unmapped pages of it come back from the page cache should it run again.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from fringed.serving.status import memory_mb

INTERVAL_S = 3.0
_QUIET_LOOKS = 6  # between scans that follow each other, what was freed is soon needed again
WORTH_MB = 10.0
_LARGE_BYTES = 16 << 20
_DONTNEED = 4  # MADV_DONTNEED


class Trimmer:
    """Called every few seconds: where nothing has run for a while and memory has grown, give back what is free."""

    def __init__(self, busy: Callable[[], bool]) -> None:
        self._busy = busy
        self._left_mb = 0.0
        self._quiet = _QUIET_LOOKS
        self._libc = ctypes.CDLL(None)

    def __call__(self) -> None:
        """Look, and trim where it is worth it."""
        self._quiet = 0 if self._busy() else self._quiet + 1
        if self._quiet < _QUIET_LOOKS or memory_mb() < self._left_mb + WORTH_MB:
            return
        with suppress(AttributeError):  # glibc alone has it
            self._libc.malloc_trim(0)
        for begin, length in _large_code():
            self._libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(length), _DONTNEED)
        self._left_mb = memory_mb()


def _large_code() -> Iterator[tuple[int, int]]:
    """Yield address and length of large mappings of code: never written, so nothing is lost with their pages."""
    with suppress(OSError):
        for line in Path("/proc/self/maps").read_text().splitlines():
            span, mode, *rest = line.split(maxsplit=5)
            begin, end = (int(part, 16) for part in span.split("-"))
            if mode == "r-xp" and len(rest) == 4 and rest[3].startswith("/") and end - begin >= _LARGE_BYTES:
                yield begin, end - begin
