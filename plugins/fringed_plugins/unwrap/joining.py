"""Join the bulk of a wrapped phase, where the order of joining cannot matter.

Owns runs of pixels along rows and how rows meet; knows nothing of how costs come about. "The most
reliable pair first" builds the spanning tree of least cost, and where no closed loop of pairs contradicts
itself every spanning tree gives the same turns (multiples of 2 pi). So pairs that are cheaper than every
loop around a residue are joined in the order of memory, many at a time; `contracting` does the rest. A
contradiction that shows up on the way is counted: the result is then void.

Per pixel, `first` names the pixel where its run began and `turns` its turns over that one; per such pixel,
`parent` and `over` are a union-find with the same meaning.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.unwrap.reliability import turns_between

_INFINITE = np.float32(np.inf)
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def _jump(p: Any, q: Any) -> Any:
    """Return the turns of q over p that bring them within pi."""
    return np.int32(turns_between(p - q))


@njit(**_options)
def bound_rows(start: int, stop: int, phase: Any, cost: Any, bound: Any, residues: Any) -> None:
    """Write for each row how many residues lie below it, and the least cost that joins all pairs around one."""
    width = phase.shape[1]
    for row in range(start, stop):
        a, c, least = phase[row], phase[row + 1], _INFINITE
        b, d = a[1:], c[1:]
        e, g = cost[row], cost[row + 1]
        f, h = e[1:], g[1:]
        found = 0
        for x in range(width - 1):
            charge = turns_between(a[x] - b[x]) + turns_between(b[x] - d[x])
            charge += turns_between(d[x] - c[x]) + turns_between(c[x] - a[x])
            dearest = max(e[x] + f[x], g[x] + h[x], e[x] + g[x], f[x] + h[x])
            charged = abs(charge) > np.float32(0.5)
            found += 1 if charged else 0
            dearest = dearest if charged else _INFINITE
            least = dearest if dearest < least else least
        bound[row], residues[row] = least, found


@njit(**_options)
def _root(parent: Any, over: Any, start: Any) -> Any:
    """Return the root of `start`, halving the path on the way."""
    while True:
        up = parent[start]
        top = parent[up]
        if up == top:
            return up
        over[start] += over[up]
        parent[start] = top
        start = top


@njit(**_options)
def _turns_to_root(parent: Any, over: Any, start: Any) -> Any:
    total = np.int32(0)
    while parent[start] != start:
        total += over[start]
        start = parent[start]
    return total


@njit(**_options)
def _unite(parent: Any, over: Any, a: Any, b: Any, between: Any) -> bool:
    """Join b to a, with b's turns over a; return False where they were joined with other turns already."""
    root_a, root_b = _root(parent, over, a), _root(parent, over, b)
    between = between + _turns_to_root(parent, over, a) - _turns_to_root(parent, over, b)
    if root_a == root_b:
        return bool(between == 0)
    if root_a < root_b:  # the earlier pixel: the tree grows with the picture, and stays in the cache
        parent[root_b], over[root_b] = root_a, between
    else:
        parent[root_a], over[root_a] = root_b, -between
    return True


@njit(**_options)
def _runs(base: int, phase: Any, cost: Any, limit: Any, groups: Any) -> None:
    """Find the runs of one row whose pairs cost less than `limit`; its first pixel is number `base`."""
    first, turns, parent, over = groups
    before, run, total = np.float32(np.nan), np.int32(-1), np.int32(0)
    for x in range(phase.size):
        here = cost[x]
        if here + before < limit:
            total += _jump(phase[x - 1], phase[x])
        elif not np.isnan(here):
            run, total = np.int32(base + x), np.int32(0)
            parent[run], over[run] = run, total
        else:
            run, total = np.int32(-1), np.int32(0)
        first[x], turns[x] = run, total
        before = here


@njit(**_options)
def _meet(above: Any, here: Any, limit: Any, parent: Any, over: Any) -> int:
    """Join the runs of two rows across pairs cheaper than `limit`; return how many loops contradict themselves.

    `above` and `here` are (phase, cost, first, turns) of a row each.
    """
    phase0, cost0, first0, turns0 = above
    phase1, cost1, first1, turns1 = here
    last0, last1, last_between, bad = np.int32(-1), np.int32(-1), np.int32(0), 0
    for x in range(phase1.size):
        if cost0[x] + cost1[x] < limit:
            between = turns0[x] + _jump(phase0[x], phase1[x]) - turns1[x]
            if first0[x] != last0 or first1[x] != last1 or between != last_between:
                last0, last1, last_between = first0[x], first1[x], between
                if not _unite(parent, over, last0, last1, between):
                    bad += 1
    return bad


@njit(**_options)
def join_rows(start: int, stop: int, fields: Any, limit: Any, groups: Any, bad: Any) -> None:
    """Join the pixels of rows `start` to `stop` across pairs cheaper than `limit`; row `start` stays open above.

    `fields` are (phase, cost); `bad` counts contradictions for each row, -1 marks the open one.
    """
    phase, cost = fields
    first, turns, parent, over = groups
    width = phase.shape[1]
    for row in range(start, stop):
        _runs(row * width, phase[row], cost[row], limit, (first[row], turns[row], parent, over))
        if row == start:
            bad[row] = -1
        else:
            above = (phase[row - 1], cost[row - 1], first[row - 1], turns[row - 1])
            bad[row] = _meet(above, (phase[row], cost[row], first[row], turns[row]), limit, parent, over)


@njit(**_options)
def join_seams(fields: Any, limit: Any, groups: Any, bad: Any) -> int:
    """Join the rows that `join_rows` left open; return how many loops contradict themselves in all."""
    phase, cost = fields
    first, turns, parent, over = groups
    total = 0
    for row in range(bad.size):
        if bad[row] < 0:
            bad[row] = 0
            if row > 0:
                above = (phase[row - 1], cost[row - 1], first[row - 1], turns[row - 1])
                bad[row] = _meet(above, (phase[row], cost[row], first[row], turns[row]), limit, parent, over)
        total += bad[row]
    return int(total)


@njit(**_options)
def settle_runs(groups: Any) -> int:
    """Write the number, from 0, of each pixel's group, and its turns over the root; count them; `parent` is used up."""
    first, turns, parent, over = groups
    count = np.int32(0)
    for row in range(first.shape[0]):
        last, label, extra = np.int32(-1), np.int32(-1), np.int32(0)
        for x in range(first.shape[1]):
            own = first[row, x]
            if own != last:
                last, label, extra = own, np.int32(-1), np.int32(0)
                if own >= 0:
                    root = own
                    while parent[root] >= 0 and parent[root] != root:
                        extra += over[root]
                        root = parent[root]
                    if parent[root] == root:
                        parent[root] = ~count
                        count += np.int32(1)
                    label = ~parent[root]
            first[row, x] = label
            turns[row, x] += extra
    return int(count)
