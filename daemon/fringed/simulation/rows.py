"""Run a kernel on blocks of rows, on every core.

Owns the pool of threads that kernels share (decision 0001); knows nothing of what they compute.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

BLOCKS_PER_THREAD = 4  # rows differ in cost: a block of sky is done at once


def threads() -> int:
    """Return the number of cores that this process may use."""
    return max(1, len(os.sched_getaffinity(0)))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads(), thread_name_prefix="rows")


def for_rows(height: int, work: Callable[[int, int], None]) -> None:
    """Call `work(first, end)` on blocks of rows that cover `range(height)`, at once on all cores."""
    count = min(height, threads() * BLOCKS_PER_THREAD)
    edges = [height * i // count for i in range(count + 1)]
    if count == 1 or threads() == 1:
        work(0, height)
        return
    for done in [_pool().submit(work, a, b) for a, b in pairwise(edges)]:
        done.result()
