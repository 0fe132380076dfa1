"""Tables of the last few rigs, made once and kept.

Owns the lock and the order of forgetting; knows nothing of what is kept.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Generic, TypeVar

Kept = TypeVar("Kept")


class Recent(Generic[Kept]):
    """The last `count` results, by what they were made of.

    Examples
    --------
    >>> made = []
    >>> recent = Recent[int](1)
    >>> [recent.get(key, lambda: made.append(key) or 2 * len(made)) for key in (b"a", b"a", b"b", b"a")]
    [2, 2, 4, 6]
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._lock = threading.Lock()
        self._kept: OrderedDict[bytes, Kept] = OrderedDict()

    def get(self, key: bytes, make: Callable[[], Kept]) -> Kept:
        """Return what was made for `key`, or make it; two threads may make the same at once."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = make()
        with self._lock:
            self._kept[key] = made
            while len(self._kept) > self._count:
                self._kept.popitem(last=False)
        return made


def key_of(*parts: Any) -> bytes:
    """Return the bytes of arrays, numbers and texts, one after the other."""
    return b"|".join(part.tobytes() if hasattr(part, "tobytes") else repr(part).encode() for part in parts)
