"""Join the pixels of a wrapped phase strictly by cost, the cheapest pairs first, without sorting.

Owns the spanning tree of least cost, built by Boruvka's rounds: each group joins the neighbour to which
its cheapest pair leads, and all passes follow the order of memory. The result is that of joining one pair
after the other in the order of their costs. Knows nothing of how costs come about.

Groups are numbered from 0 in `first` (-1: unknown); `turns` are a pixel's multiples of 2 pi over its group.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.unwrap.reliability import turns_between

_INFINITE = np.float32(np.inf)
_UNSET = np.int32(-2)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def _jump(p: Any, q: Any) -> Any:
    """Return the turns of q over p that bring them within pi."""
    return np.int32(turns_between(p - q))


@njit(**_options)
def _candidates(cost: Any, phase: Any, pad: Any) -> None:
    """Copy a row between two pixels that nobody chooses: the cost, infinite where unknown, and the phase."""
    costs, phases = pad
    for x in range(cost.size):
        costs[x + 1] = cost[x] if cost[x] == cost[x] else _INFINITE
        phases[x + 1] = phase[x]


@njit(**_options)
def _point_row(base: int, here: Any, above: Any, below: Any, out: Any) -> None:
    """Point the pixels of a row, the first of which is number `base`; ties go to the pair that comes first."""
    costs, phases = here
    parent, over = out
    left, right, up, down = costs[:-2], costs[2:], above[0][1:], below[0][1:]
    own = phases[1:]
    values = (phases[:-2], phases[2:], above[1][1:], below[1][1:])
    width = np.int32(parent.size)
    for x in range(parent.size):
        least, step, value = up[x], -width, values[2][x]
        nearer = left[x] < least
        least, step, value = (left[x], np.int32(-1), values[0][x]) if nearer else (least, step, value)
        nearer = right[x] < least
        least, step, value = (right[x], np.int32(1), values[1][x]) if nearer else (least, step, value)
        nearer = down[x] < least
        least, step, value = (down[x], width, values[3][x]) if nearer else (least, step, value)
        alone = least == _INFINITE
        parent[x] = np.int32(base + x) + (np.int32(0) if alone else step)
        over[x] = np.int32(0) if alone else np.int32(turns_between(value - own[x]))


@njit(**_options)
def point_rows(start: int, stop: int, phase: Any, cost: Any, parent: Any, over: Any) -> None:
    """Point each pixel of some rows to its most reliable neighbour: that pair is the cheapest it has.

    Pixels without a phase point somewhere, too; `settle_tree` passes over them.
    """
    height, width = phase.shape
    costs = np.full((3, width + 2), _INFINITE, np.float32)
    phases = np.zeros((3, width + 2), np.float32)
    for row in range(start - 1, stop + 1):
        new, middle, old = row % 3, (row - 1) % 3, (row - 2) % 3
        if 0 <= row < height:
            _candidates(cost[row], phase[row], (costs[new], phases[new]))
        else:
            costs[new] = _INFINITE
        if row > start:
            base = (row - 1) * width
            out = (parent[base : base + width], over[base : base + width])
            here, above, below = (costs[middle], phases[middle]), (costs[old], phases[old]), (costs[new], phases[new])
            _point_row(base, here, above, below, out)


@njit(**_options)
def cut_circles(start: int, stop: int, parent: Any, over: Any) -> None:
    """Make the earlier of each two that point to each other a root."""
    for p in range(start, stop):
        if p < parent[p] and parent[parent[p]] == p:
            parent[p], over[p] = p, 0


@njit(**_options)
def settle_tree(known: Any, parent: Any, over: Any, first: Any, turns: Any) -> int:
    """Number the trees of `parent` from 0 in `first`, count `turns` from their roots, and return how many."""
    first[:] = _UNSET
    count = np.int32(0)
    for start in range(first.size):
        if first[start] != _UNSET:
            continue
        if known[start] != known[start]:
            first[start], turns[start] = -1, 0
            continue
        node, total = np.int32(start), np.int32(0)
        while first[node] == _UNSET and parent[node] != node:
            total += over[node]
            node = parent[node]
        if first[node] == _UNSET:
            first[node], turns[node] = count, 0
            count += np.int32(1)
        label, total = first[node], total + turns[node]
        end, node = node, np.int32(start)
        while node != end:
            first[node], turns[node] = label, total
            total -= over[node]
            node = parent[node]
    return int(count)


@njit(**_options)
def _dearest(pair: Any, across: Any) -> bool:
    """Tell whether a pair is the dearest of the four around a corner: then it is in no cheapest tree.

    `across` are the pixels opposite to the two of `pair`; NaN costs compare as False.
    """
    return bool(pair[1] > across[0] and pair[0] > across[1])


@njit(**_options)
def _is_needless(row: int, x: int, step: Any, cost: Any) -> bool:
    """Tell whether the pair of a pixel and its right (0, 1) or lower (1, 0) neighbour is in no cheapest tree."""
    height, width = cost.shape
    down, right = step
    pair = (cost[row, x], cost[row + down, x + right])
    if (down and x + 1 < width) or (right and row + 1 < height):
        if _dearest(pair, (cost[row + right, x + down], cost[row + 1, x + 1])):
            return True
    if down and x > 0:
        return _dearest(pair, (cost[row, x - 1], cost[row + 1, x - 1]))
    if right and row > 0:
        return _dearest(pair, (cost[row - 1, x], cost[row - 1, x + 1]))
    return False


@njit(**_options)
def count_rows(start: int, stop: int, cost: Any, first: Any, counts: Any) -> None:
    """Write for each row how many of its pairs may still join groups."""
    height, width = cost.shape
    for row in range(start, stop):
        count = 0
        for x in range(width):
            own = first[row, x]
            if own >= 0:
                if x + 1 < width and first[row, x + 1] >= 0 and first[row, x + 1] != own:
                    count += 0 if _is_needless(row, x, (0, 1), cost) else 1
                if row + 1 < height and first[row + 1, x] >= 0 and first[row + 1, x] != own:
                    count += 0 if _is_needless(row, x, (1, 0), cost) else 1
        counts[row] = count


@njit(**_options)
def list_rows(start: int, stop: int, fields: Any, ends: Any, pairs: Any) -> None:
    """Write the pairs of each row, up to where `ends` says that they end: groups a and b, turns of b over a, cost."""
    phase, cost, first, turns = fields
    a, b, between, price = pairs
    height, width = cost.shape
    for row in range(start, stop):
        i = ends[row - 1] if row > 0 else 0
        for x in range(width if ends[row] > i else 0):
            own = first[row, x]
            for down in range(2):
                right = 1 - down
                if own < 0 or row + down == height or x + right == width:
                    continue
                other = first[row + down, x + right]
                if other < 0 or other == own or _is_needless(row, x, (down, right), cost):
                    continue
                a[i], b[i] = own, other
                jump = _jump(phase[row, x], phase[row + down, x + right])
                between[i] = turns[row, x] + jump - turns[row + down, x + right]
                price[i] = cost[row, x] + cost[row + down, x + right]
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
        if group < parent[group] and parent[parent[group]] == group:
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
    labels, turns = np.empty(groups, np.int32), np.empty(groups, np.int32)
    regions = settle_tree(labels, parent, over, labels, turns)
    parent[:], over[:] = labels, turns
    return regions
