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
_ROUNDS = (0.36, 0.64, 0.86, 1.0)  # part of the rows that is done after each round of bands


def thread_count(threads: int = 0) -> int:
    """Return how many threads to use: `threads`, or one per core when it is 0."""
    return min(threads, _MAX_THREADS) if threads > 0 else min(os.cpu_count() or 1, _MAX_THREADS)


def run_rows(kernel: Callable[..., Any], rows: int, *arguments: Any, threads: int = 0) -> None:
    """Call `kernel(start, stop, *arguments)` for bands of rows that together cover `range(rows)`.

    Bands are a few times more than threads and shrink, so that a core that is busy elsewhere does not hold up
    the rest, and all end at about the same time. The first exception of a band is raised.
    """
    count = thread_count(threads)
    if count == 1 or rows < 4 * count:
        kernel(0, rows, *arguments)
        return
    edges = _band_edges(rows, count)
    taken = iter(range(len(edges) - 1))

    def work() -> None:
        for band in taken:
            kernel(edges[band], edges[band + 1], *arguments)

    pending = [_executor().submit(work) for _ in range(count - 1)]
    work()
    for future in pending:
        future.result()


def _band_edges(rows: int, count: int) -> list[int]:
    """Return where bands begin and end: `count` bands for each of a few rounds, the last of them the smallest."""
    edges, begin = [0], 0.0
    for end in _ROUNDS:
        edges += [round(rows * (begin + (end - begin) * (i + 1) / count)) for i in range(count)]
        begin = end
    return edges


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
