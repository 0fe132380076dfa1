"""Join groups of pixels strictly by cost, the cheapest pairs first, without sorting.

Owns the spanning tree of least cost, built by Boruvka's rounds: each group joins the neighbour to which
its cheapest pair leads, and all passes follow the order of memory. The result is that of joining one pair
after the other in the order of their costs. Knows nothing of how costs and groups come about.

Groups are numbered from 0 in `first` (-1: unknown); `turns` are a pixel's multiples of 2 pi over its group.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.unwrap.basins import root_of
from fringed_plugins.unwrap.reliability import turns_between

_INFINITE = np.float32(np.inf)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def _jump(p: Any, q: Any) -> Any:
    """Return the turns of q over p that bring them within pi."""
    return np.int32(turns_between(p - q))


@njit(**_options)
def _settle_all(parent: Any, over: Any) -> int:
    """Replace each node's parent by its tree's number, from 0, and its turns by those over the root; count them."""
    count, numbers = np.int32(0), np.full(parent.size, -1, np.int32)
    for start in range(parent.size):
        root, total = np.int32(start), np.int32(0)
        while parent[root] != root:
            total += over[root]
            root = parent[root]
        node = np.int32(start)
        while node != root:
            after, own = parent[node], over[node]
            parent[node], over[node] = root, total
            total -= own
            node = after
        if numbers[root] < 0:
            numbers[root] = count
            count += np.int32(1)
    for start in range(parent.size):
        parent[start] = numbers[parent[start]]
    return int(count)


@njit(**_options)
def _useful(here: Any, above: Any, below: Any, group: Any, other: Any, flags: Any) -> int:
    """Flag the pairs of a row that may be in the cheapest tree, and return how many.

    1: the pair with the right neighbour, 2: that with the one below. They join two groups, and are not the
    dearest of the four around a corner: that one is in no cheapest tree, whatever the phases. `here`,
    `above` and `below` are costs between two NaN, which compare as False; `other` are the groups below.
    """
    c0, c1, c2 = here[:-2], here[1:], here[2:]
    u1, u2, d0, d1, d2 = above[1:], above[2:], below[:-2], below[1:], below[2:]
    count, next_group = np.int64(0), group[1:]
    for x in range(flags.size):
        own, right, down = group[x], next_group[x], other[x]
        needless = (c2[x] > d1[x]) & (c1[x] > d2[x]) | (c2[x] > u1[x]) & (c1[x] > u2[x])
        first = np.uint8(1) if (own >= 0) & (right >= 0) & (own != right) & (not needless) else np.uint8(0)
        needless = (d1[x] > c2[x]) & (c1[x] > d2[x]) | (d1[x] > c0[x]) & (c1[x] > d0[x])
        second = np.uint8(1) if (own >= 0) & (down >= 0) & (own != down) & (not needless) else np.uint8(0)
        flags[x] = first + np.uint8(2) * second
        count += np.int64(first) + np.int64(second)
    return int(count)


@njit(**_options)
def flag_rows(start: int, stop: int, cost: Any, first: Any, flags: Any, counts: Any) -> None:
    """Flag for each row the pairs that may still join groups, and count them."""
    height, width = cost.shape
    costs = np.full((3, width + 2), np.float32(np.nan), np.float32)
    groups = np.full((2, width + 1), -1, np.int32)
    for row in range(start - 1, stop + 1):
        new, middle, old = row % 3, (row - 1) % 3, (row - 2) % 3
        inside = 0 <= row < height
        costs[new, 1 : width + 1] = cost[row] if inside else np.full(width, np.float32(np.nan), np.float32)
        groups[row % 2, :width] = first[row] if inside else np.full(width, -1, np.int32)
        if row > start:
            own, other = groups[(row - 1) % 2], groups[row % 2]
            counts[row - 1] = _useful(costs[middle], costs[old], costs[new], own, other, flags[row - 1])


@njit(**_options)
def list_rows(start: int, stop: int, fields: Any, flags: Any, ends: Any, pairs: Any) -> None:
    """Write the pairs of each row, up to where `ends` says that they end: groups a and b, turns of b over a, cost."""
    phase, cost, first, turns = fields
    a, b, between, price = pairs
    for row in range(start, stop):
        i = ends[row - 1] if row > 0 else 0
        for x in range(flags.shape[1] if ends[row] > i else 0):
            if flags[row, x] & 1:
                a[i], b[i], price[i] = first[row, x], first[row, x + 1], cost[row, x] + cost[row, x + 1]
                between[i] = turns[row, x] + _jump(phase[row, x], phase[row, x + 1]) - turns[row, x + 1]
                i += 1
            if flags[row, x] & 2:
                a[i], b[i], price[i] = first[row, x], first[row + 1, x], cost[row, x] + cost[row + 1, x]
                between[i] = turns[row, x] + _jump(phase[row, x], phase[row + 1, x]) - turns[row + 1, x]
                i += 1


@njit(**_options)
def _choose(count: int, pairs: Any, best: Any, least: Any) -> None:
    """Write for each group the number of its cheapest pair."""
    a, b, _, price = pairs
    for i in range(count):
        here, p, q = price[i], a[i], b[i]
        if here < least[p]:
            least[p], best[p] = here, i
        if here < least[q]:
            least[q], best[q] = here, i


@njit(**_options)
def _follow(active: Any, pairs: Any, best: Any, parent: Any, over: Any) -> None:
    """Point each group to the one that its cheapest pair leads to."""
    a, b, between, _ = pairs
    for group in active:
        i = best[group]
        if i >= 0:
            forward = b[i] == group
            parent[group] = a[i] if forward else b[i]
            over[group] = between[i] if forward else -between[i]
    for group in active:
        if root_of(parent, group) == group:
            parent[group], over[group] = group, 0


@njit(**_options)
def _settle(active: Any, parent: Any, over: Any, best: Any, least: Any) -> int:
    """Point the active groups to their roots; put the roots first in `active` and return how many."""
    kept = 0
    for k in range(active.size):
        group = active[k]
        root, total = group, np.int32(0)
        while parent[root] != root:
            total += over[root]
            root = parent[root]
        node = group
        while parent[node] != root and node != root:
            after, own = parent[node], over[node]
            parent[node], over[node] = root, total
            total -= own
            node = after
        best[group], least[group] = -1, _INFINITE
        if root == group:
            active[kept] = group
            kept += 1
    return kept


@njit(**_options)
def _contract(count: int, pairs: Any, parent: Any, over: Any) -> int:
    """Rewrite the pairs to lead between roots, leave out those within one, and return how many remain."""
    a, b, between, price = pairs
    kept = 0
    for i in range(count):
        p, q = a[i], b[i]
        root_p, root_q = parent[p], parent[q]
        if root_p != root_q:
            between[kept] = between[i] + over[p] - over[q]
            a[kept], b[kept], price[kept] = root_p, root_q, price[i]
            kept += 1
    return kept


@njit(**_options)
def join_groups(pairs: Any, parent: Any, over: Any) -> int:
    """Join groups along their cheapest pairs until none leads elsewhere; return the number of regions.

    `parent` becomes each group's region, numbered from 0, and `over` its turns over that; uses up `pairs`.
    """
    groups, count = parent.size, pairs[0].size
    active, best = np.arange(groups).astype(np.int32), np.full(groups, -1, np.int32)
    least = np.full(groups, _INFINITE, np.float32)
    for group in range(groups):
        parent[group], over[group] = group, 0
    while count > 0:
        _choose(count, pairs, best, least)
        _follow(active, pairs, best, parent, over)
        active = active[: _settle(active, parent, over, best, least)]
        count = _contract(count, pairs, parent, over)
    return int(_settle_all(parent, over))
