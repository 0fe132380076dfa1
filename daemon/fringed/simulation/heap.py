"""Give memory back to the system after work that needed much of it for a moment.

Owns the call to the C library; where that has none, nothing happens.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


@cache
def _trim() -> Any:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError):  # another C library than glibc
        return None


def return_memory() -> None:
    """Return freed heap to the system: tracing a scene leaves some 50 MB of it, a fifth of the daemon's allowance."""
    trim = _trim()
    if trim is not None:
        trim(0)
