"""Residues of a wrapped phase, and cuts that balance them.

Owns Goldstein's growing boxes and the filling of what the cuts leave; knows nothing of files and types.

A residue lies between four pixels, at the corner of (row, x) and (row + 1, x + 1); it is known by (row, x). A
cut runs from corner to corner and blocks the pairs of pixels that it crosses: 1 in `blocked` for a pixel's
pair with its right neighbour, 2 for that with the one below. So no pixel is lost to a cut.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.unwrap.reliability import turns_between

GROUND = 4  # a corner with an unknown pixel: charges may go there
_options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**_options)
def charge_rows(start: int, stop: int, phase: Any, charge: Any) -> None:
    """Write the charge of each corner below some rows: -1, 0, 1, or GROUND where a pixel is unknown."""
    for row in range(start, stop):
        a, c = phase[row], phase[row + 1]
        b, d = a[1:], c[1:]
        for x in range(charge.shape[1]):
            turns = turns_between(a[x] - b[x]) + turns_between(b[x] - d[x])
            turns += turns_between(d[x] - c[x]) + turns_between(c[x] - a[x])
            charge[row, x] = np.int8(turns) if abs(turns) < np.float32(3) else np.int8(GROUND)


@njit(**_options)
def _cut(row: int, x: int, to_row: int, to_x: int, blocked: Any) -> None:
    """Block the pairs between two corners; a corner outside the picture is reached across its edge."""
    while row != to_row or x != to_x:
        if abs(to_row - row) >= abs(to_x - x):
            below = to_row > row
            blocked[row + 1 if below else row, x + 1 if x < 0 else x] |= 1
            row += 1 if below else -1
        else:
            right = to_x > x
            blocked[row + 1 if row < 0 else row, x + 1 if right else x] |= 2
            x += 1 if right else -1


@njit(**_options)
def _visit(charge: Any, cluster: Any, member: int, target: Any, blocked: Any) -> int:
    """Look at one corner of a box around a member; cut to it if it has a free charge, and return what it adds.

    `GROUND` stands for the edge of the picture or of what is known: the cluster is balanced.
    """
    row, x = target
    members, count, taken = cluster
    height, width = charge.shape
    if 0 <= row < height and 0 <= x < width:
        found = charge[row, x]
        if found == 0 or (found != GROUND and taken[row, x] != 0):
            return 0
        if found != GROUND:
            taken[row, x] = 1
            members[count[0]] = row * width + x
            count[0] += 1
    else:
        found = np.int8(GROUND)
    _cut(members[member] // width, members[member] % width, row, x, blocked)
    return int(found)


@njit(**_options)
def _ring(charge: Any, cluster: Any, member: int, radius: int, total: int, blocked: Any) -> int:
    """Look at the corners at one distance from a member until the charge is balanced; return the charge."""
    height, width = charge.shape
    row, x = cluster[0][member] // width, cluster[0][member] % width
    for dy in range(-radius, radius + 1):
        if row + dy < -1 or row + dy > height:
            continue
        step = 1 if abs(dy) == radius else 2 * radius
        for dx in range(-radius, radius + 1, step):
            if x + dx < -1 or x + dx > width:
                continue
            inside = 0 <= row + dy < height and 0 <= x + dx < width
            if not inside and dy != 0 and dx != 0:
                continue  # straight out of the picture, not askew
            found = _visit(charge, cluster, member, (row + dy, x + dx), blocked)
            total = 0 if found == GROUND else total + found
            if total == 0:
                return 0
    return total


@njit(**_options)
def place_cuts(charge: Any, longest: int, blocked: Any) -> int:
    """Cut between residues until their charges balance, in growing boxes; return how many clusters stay charged.

    Around each residue that has no partner yet, boxes grow to `longest`; a free residue inside joins the
    cluster, which is finished when its charge is 0 or it reaches ground.
    """
    width = charge.shape[1]
    taken = np.zeros(charge.shape, np.uint8)
    members, reached = np.empty(charge.size, np.int32), np.empty(charge.size, np.int32)
    count, left = np.zeros(1, np.int64), 0
    cluster = (members, count, taken)
    for start in range(charge.size):
        row, x = start // width, start % width
        if charge[row, x] == 0 or charge[row, x] == GROUND or taken[row, x] != 0:
            continue
        members[0], reached[0], taken[row, x], count[0] = start, 0, 1, 1
        total, radius = int(charge[row, x]), 1
        while total != 0 and radius <= longest:
            member = 0
            while total != 0 and member < count[0]:
                before = count[0]
                while total != 0 and reached[member] < radius:
                    reached[member] += 1
                    total = _ring(charge, cluster, member, reached[member], total, blocked)
                reached[before : count[0]] = 0
                member += 1
            radius += 1
        left += 1 if total != 0 else 0
    return left


@njit(**_options)
def _open_pairs(p: int, width: int, blocked: Any) -> Any:
    """Return for the neighbours left, right, above and below whether the pair with them is inside and not blocked."""
    x = p % width
    left = x > 0 and not blocked[p - 1] & 1
    right = x + 1 < width and not blocked[p] & 1
    up = p >= width and not blocked[p - width] & 2
    return left, right, up, p + width < blocked.size and not blocked[p] & 2


@njit(**_options)
def fill(phase: Any, width: int, blocked: Any, groups: Any) -> int:
    """Write the number, from 0, of each connected group of pixels, and turns over its first; count them. All flat."""
    first, turns = groups
    queue = np.empty(phase.size, np.int32)
    count = np.int32(0)
    for i in range(phase.size):
        first[i] = -1
    for start in range(phase.size):
        if first[start] >= 0 or np.isnan(phase[start]):
            continue
        first[start], turns[start], queue[0] = count, 0, start
        head, tail = 0, 1
        while head < tail:
            p = queue[head]
            head += 1
            left, right, up, down = _open_pairs(p, width, blocked)
            for step, is_open in ((-1, left), (1, right), (-width, up), (width, down)):
                if is_open and first[p + step] < 0 and not np.isnan(phase[p + step]):
                    q = p + step
                    first[q] = count
                    turns[q] = turns[p] + np.int32(turns_between(phase[p] - phase[q]))
                    queue[tail] = q
                    tail += 1
        count += np.int32(1)
    return int(count)


@njit(**_options)
def part(first: Any, size: Any, apart: Any) -> None:
    """Mark the pixels of the smaller of two regions where they touch: what is left is connected by itself."""
    height, width = first.shape
    for row in range(height):
        for x in range(width):
            for down in range(2):
                y, z = row + down, x + 1 - down
                if y < height and z < width:
                    a, b = first[row, x], first[y, z]
                    if a >= 0 and b >= 0 and a != b:
                        if size[a] > size[b] or (size[a] == size[b] and a < b):
                            apart[y, z] = 1
                        else:
                            apart[row, x] = 1
