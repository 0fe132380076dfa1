"""Split rows of an image over a few threads, for kernels that release the GIL.

Owns one small pool for the whole process; knows nothing of what the kernels compute. Numba's own
`parallel=True` is not used: its threading layer is not safe when several Python threads call it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

_lock = threading.Lock()
_pool: ThreadPoolExecutor | None = None
_MAX_THREADS = 64


def thread_count(threads: int = 0) -> int:
    """Return how many threads to use: `threads`, or one per core when it is 0."""
    return min(threads, _MAX_THREADS) if threads > 0 else min(os.cpu_count() or 1, _MAX_THREADS)


def run_rows(kernel: Callable[..., Any], rows: int, *arguments: Any, threads: int = 0) -> None:
    """Call `kernel(start, stop, *arguments)` for bands of rows that together cover `range(rows)`.

    Bands are a few times more than threads, so that a core that is busy elsewhere does not hold up
    the rest. The first exception of a band is raised.
    """
    count = thread_count(threads)
    if count == 1 or rows < 4 * count:
        kernel(0, rows, *arguments)
        return
    bands = min(4 * count, rows)
    edges = [rows * i // bands for i in range(bands + 1)]
    taken = iter(range(bands))

    def work() -> None:
        for band in taken:
            kernel(edges[band], edges[band + 1], *arguments)

    pending = [_executor().submit(work) for _ in range(count - 1)]
    work()
    for future in pending:
        future.result()


def _executor() -> ThreadPoolExecutor:
    global _pool
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(thread_count(), thread_name_prefix="rows")
        return _pool


def _forget_pool() -> None:
    """Drop the pool in a forked child: its threads stayed with the parent."""
    global _pool
    _pool = None


os.register_at_fork(after_in_child=_forget_pool)
