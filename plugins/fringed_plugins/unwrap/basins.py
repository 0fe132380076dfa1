"""Join each pixel of a wrapped phase to its most reliable neighbour: Boruvka's first round.

Owns the basins that this makes and their numbering; `contracting` joins them. On pixels the cheapest pair
leads to the neighbour of least cost, so that nothing need be listed.
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

    Pixels without a phase point somewhere, too; `settle_rows` passes over them.
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
def root_of(parent: Any, node: Any) -> Any:
    """Return the earlier of two that point to each other, the node itself if it points to itself; else -1."""
    up = parent[node]
    if parent[up] != node:
        return np.int32(-1)
    return min(up, node)


@njit(**_options)
def settle_rows(start: int, stop: int, cost: Any, forest: Any, groups: Any, border: Any) -> None:
    """Write for each pixel the root of its basin, or where its path leaves rows `start` to `stop`, and turns over that.

    `forest` are (parent, over), `groups` (first, turns), all flat; `border` marks the rows that paths lead to.
    Roots are written as themselves, unknown pixels as -1.
    """
    parent, over = forest
    first, turns = groups
    width = cost.shape[1]
    low, high = start * width, stop * width
    known = cost.ravel()
    border[max(start - 1, 0)], border[min(stop, border.size - 1)] = 1, 1
    first[low:high] = _UNSET
    for begin in range(low, high):
        if np.isnan(known[begin]):
            first[begin], turns[begin] = -1, 0
        if first[begin] != _UNSET:
            continue
        node, total = np.int32(begin), np.int32(0)
        while low <= node < high and first[node] == _UNSET:
            if root_of(parent, node) == node:
                first[node], turns[node] = node, 0
            else:
                total += over[node]
                node = parent[node]
        label = node
        if low <= node < high:
            label, total = first[node], total + turns[node]
        end, node = node, np.int32(begin)
        while node != end:
            first[node], turns[node] = label, total
            total -= over[node]
            node = parent[node]


@njit(**_options)
def number_basins(width: int, parent: Any, groups: Any, border: Any) -> int:
    """Give the roots numbers from 0, kept in `parent` as complements; follow the marked rows to them; count them."""
    first, turns = groups
    count = np.int32(0)
    for pixel in range(first.size):
        if first[pixel] == pixel:
            parent[pixel] = ~count
            count += np.int32(1)
    for row in range(border.size):
        for pixel in range(row * width, (row + 1) * width if border[row] else 0):
            node = first[pixel]
            while node >= 0 and first[node] != node:
                turns[pixel] += turns[node]
                node = first[node]
            first[pixel] = node
    return int(count)


@njit(**_options)
def label_rows(start: int, stop: int, parent: Any, groups: Any, border: Any) -> None:
    """Write the numbers of the basins into some rows that are not marked; marked ones are only read."""
    first, turns = groups
    width = first.size // border.size
    for row in range(start, stop):
        for pixel in range(row * width, (row + 1) * width if not border[row] else 0):
            node = first[pixel]
            if node >= 0:
                if parent[node] >= 0:  # no root: where the path left its rows
                    turns[pixel] += turns[node]
                    node = first[node]
                first[pixel] = ~parent[node]


@njit(**_options)
def label_border(parent: Any, groups: Any, border: Any) -> None:
    """Write the numbers of the basins into the marked rows."""
    first, _ = groups
    width = first.size // border.size
    for row in range(border.size):
        for pixel in range(row * width, (row + 1) * width if border[row] else 0):
            first[pixel] = ~parent[first[pixel]] if first[pixel] >= 0 else first[pixel]
