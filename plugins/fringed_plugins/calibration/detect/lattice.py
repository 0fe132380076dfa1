"""Numbers for the marks of a grid: which column and row each one is, as far as they hang together.

Owns the walk from neighbour to neighbour. The image of a circle says what perspective does to lengths beside it, so
neighbours are looked for at the distance that the board has, in the ellipse's own measure.
"""

from __future__ import annotations

import heapq

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]

_NEAR, _FAR = 0.72, 1.32  # of the pitch, in an ellipse's own measure
_OFF = 0.3  # of a step: how far a neighbour may be from where it is expected


def walk(px: Float64Array, shape: Float64Array, pitch: Float64Array) -> tuple[Int32Array, npt.NDArray[np.bool_]]:
    """Return lattice coordinates (n, 2) and which points (n,) have some: the largest part that hangs together.

    `px` (n, 2) and `shape` (n, 3) are ellipses, `pitch` (n,) the distance of neighbours over each one's radius.
    The lattice's x and y are right-handed as the picture's are: y is a quarter turn clockwise from x as one sees it.
    """
    best = (np.zeros((len(px), 2), np.int32), np.zeros(len(px), bool))
    if len(px) < 4:
        return best
    near = _neighbours(px, shape, pitch)
    left = set(range(len(px)))
    for seed in sorted(left, key=lambda k: -len(near[k])):
        if seed not in left or len(near[seed]) < 2:
            continue
        places = _grown(px, near, seed)
        left -= set(places)
        if len(places) > best[1].sum():
            coordinates, known = np.zeros((len(px), 2), np.int32), np.zeros(len(px), bool)
            for point, place in places.items():
                coordinates[point], known[point] = place, True
            best = (coordinates, known)
        if best[1].sum() >= len(left):
            break
    return best


def _neighbours(px: Float64Array, shape: Float64Array, pitch: Float64Array) -> list[list[int]]:
    """Return for each point those that lie a pitch away in its own measure."""
    from scipy.spatial import cKDTree

    _, order = cKDTree(px).query(px, k=min(9, len(px)))
    near: list[list[int]] = []
    for k, others in enumerate(order):
        matrix = np.array([[shape[k, 0], shape[k, 1]], [shape[k, 1], shape[k, 2]]])
        far = np.linalg.norm((px[others] - px[k]) @ matrix.T, axis=1) / pitch[k]
        near.append([int(o) for o, f in zip(others, far, strict=True) if o != k and _NEAR < f < _FAR])
    return near


def _basis(px: Float64Array, near: list[list[int]], seed: int) -> tuple[Float64Array, Float64Array] | None:
    """Return the steps along x and y at the seed, from two neighbours that are no opposites."""
    steps = [px[k] - px[seed] for k in near[seed]]
    first = steps[0]
    for other in steps[1:]:
        sine = float(first[0] * other[1] - first[1] * other[0]) / float(np.linalg.norm(first) * np.linalg.norm(other))
        if abs(sine) > 0.4:
            return first, other if sine > 0 else -other
    return None


def _grown(px: Float64Array, near: list[list[int]], seed: int) -> dict[int, tuple[int, int]]:
    """Return the numbers of everything that can be reached from the seed, the surest step first."""
    from scipy.spatial import cKDTree

    basis = _basis(px, near, seed)
    if basis is None:
        return {seed: (0, 0)}
    tree = cKDTree(px)
    places, taken = {seed: (0, 0)}, {(0, 0): seed}
    queue: list[tuple[float, int, int, int, tuple[Float64Array, Float64Array]]] = []
    count = 0

    def offer(point: int, steps: tuple[Float64Array, Float64Array]) -> None:
        nonlocal count
        for axis in (0, 1):
            for sign in (1, -1):
                off, other = tree.query(px[point] + sign * steps[axis])
                part = float(off / np.linalg.norm(steps[axis]))
                if part < _OFF and other != point:
                    count += 1
                    heapq.heappush(queue, (part, count, int(other), point * 4 + axis * 2 + (sign < 0), steps))

    offer(seed, basis)
    while queue:
        _, _, point, origin, steps = heapq.heappop(queue)
        parent, axis, sign = origin // 4, origin // 2 % 2, -1 if origin % 2 else 1
        place = list(places[parent])
        place[axis] += sign
        if point in places or (place[0], place[1]) in taken:
            continue
        places[point] = (place[0], place[1])
        taken[place[0], place[1]] = point
        own = [steps[0], steps[1]]
        own[axis] = sign * (px[point] - px[parent])
        offer(point, (own[0], own[1]))
    return places
