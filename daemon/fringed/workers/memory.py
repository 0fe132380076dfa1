"""What a process holds of the machine's memory, and how it keeps what it will need again.

Owns three settings of glibc's malloc and one line of /proc; knows nothing else.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
_LARGEST_MMAP_THRESHOLD = 32 * 1024 * 1024  # glibc refuses more


def keep_freed_pages(keep_mb: int) -> bool:
    """Keep up to `keep_mb` of freed memory at the heap's end; return whether this C library can.

    A frame set of 17 MB is otherwise mapped, faulted in and unmapped on each of its ways, which takes three times
    as long as copying it. Call it before the process starts its first thread.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:  # not glibc
        return False
    wanted = ((_M_ARENA_MAX, 1), (_M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD), (_M_TRIM_THRESHOLD, keep_mb << 20))
    accepted = [int(mallopt(option, value)) for option, value in wanted]
    return 0 not in accepted


def resident_mb(pid: int) -> float:
    """Return the memory that a process holds, in MB; 0 when it is gone."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
