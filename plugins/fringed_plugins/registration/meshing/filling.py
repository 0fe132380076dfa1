"""The signed distance where nobody has looked, so that a mesh can be closed.

Owns a coarse field over a whole box: fused distances near the surface, outside where a view looks through and at the
box's border, and in between the membrane over both. Where no fine voxel is known, its sign is the mesh's.

References
----------
Curless & Levoy 1996 for what is seen to be empty; Davis, Marschner, Garr & Levoy 2002 fill by diffusion: the membrane
is where that ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates, zoom

from fringed_plugins.registration.meshing.blocks import blocks_of, keys_of, neighbour
from fringed_plugins.registration.meshing.distances import SIDE
from fringed_plugins.registration.meshing.volume import MOST_BLOCKS, Seen, Volume, fused, points_of
from fringed_plugins.registration.result import Report
from fringed_plugins.registration.transforms import FloatArray

Array = npt.NDArray[Any]
CELLS = 96  # along the longest side of the box
MARGIN = 0.12  # of the extent, on every side
BAND = 2.5  # cells
SWEEPS = 40  # at each of the levels
CHUNK = 500  # blocks between two reports
ROUNDS = 64


@dataclass(frozen=True)
class Field:
    """Signed distances (nx, ny, nz) known everywhere, at `first` (3,) + `cell` x index, relative to the volume."""

    values: Array
    first: FloatArray
    cell: float

    def at(self, places: Array) -> Array:
        """Return the field at places (..., 3) relative to the volume's origin, trilinear; outside beyond the box."""
        index = np.moveaxis((places - self.first) / self.cell, -1, 0)
        found: Array = map_coordinates(self.values, index, order=1, mode="nearest", output=np.float32)
        return found


def membrane(views: Sequence[Seen], origin: FloatArray, voxel: float, report: Report, threads: int) -> Field:
    """Return the coarse field of all views."""
    spread = [points_of(seen) - origin for seen in views]
    low = np.min([points.min(0) for points in spread], axis=0)
    high = np.max([points.max(0) for points in spread], axis=0)
    margin = MARGIN * float((high - low).max())
    cell = max(2 * voxel, float((high - low).max()) * (1 + 2 * MARGIN) / CELLS)
    first = low - margin - SIDE * cell * 0.5
    count = np.ceil((high + margin - first) / (SIDE * cell)).astype(int)
    blocks = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 3)
    volume = fused(views, keys_of(blocks), (origin + first, cell, BAND * cell), report, threads)
    values, free = (_dense(part, count) for part in (volume.values, volume.free))
    known = ~np.isnan(values)
    values[~known & (free > 0)] = BAND * cell
    known |= free > 0
    for axis in range(3):
        for end in (0, -1):
            np.moveaxis(values, axis, 0)[end] = BAND * cell
            np.moveaxis(known, axis, 0)[end] = True
    return Field(_stretched(values, known, report), first, cell)


def _dense(values: Array, count: Array) -> Array:
    """Return blocks (b, 512) of a whole box, in the order of their keys, as one array."""
    cubes = values.reshape(*count, SIDE, SIDE, SIDE).transpose(0, 3, 1, 4, 2, 5)
    return np.ascontiguousarray(cubes.reshape(count * SIDE))


def _stretched(values: Array, known: Array, report: Report) -> Array:
    """Return the values with what is not known where the known ones pull it: Laplace's equation, coarse to fine."""
    report(0.9, "closing what nobody has seen")
    start = np.where(known, values, 0).astype(np.float32)
    if min(values.shape) >= 16:
        halves = tuple(n // 2 for n in values.shape)
        shape = tuple(n for half in halves for n in (half, 2))
        inside = tuple(slice(0, 2 * half) for half in halves)
        count = known[inside].reshape(shape).sum(axis=(1, 3, 5))
        mean = start[inside].reshape(shape).sum(axis=(1, 3, 5)) / np.maximum(count, 1)
        less = _stretched(mean, count > 0, report)
        factors = [n / half for n, half in zip(values.shape, halves, strict=True)]
        guess = zoom(less, factors, order=1, grid_mode=True, mode="nearest")
        start = np.where(known, start, guess).astype(np.float32)
    free = ~known
    inner = (slice(1, -1),) * 3
    unknown = free[inner]
    for sweep in range(SWEEPS):
        report(0.8 + 0.1 * sweep / SWEEPS, "closing what nobody has seen")
        total = np.zeros_like(start[inner])
        for axis in range(3):
            for shift in (slice(0, -2), slice(2, None)):
                total += start[tuple(shift if a == axis else slice(1, -1) for a in range(3))]
        np.copyto(start[inner], total / 6, where=unknown)
    return start


def closed(volume: Volume, field: Field, report: Report) -> Volume:
    """Return a volume that is known everywhere, and has every block in which its sign changes.

    Raises
    ------
    ValueError
        it would not fit in memory.
    """
    keys = np.union1d(volume.keys, _crossed(volume, field))
    values = _spread(volume, keys, field, report)
    for _ in range(ROUNDS):
        report(0.5, "closing what nobody has seen")
        more = _leaking(keys, values, volume.voxel, field)
        if not len(more):
            break
        larger = np.union1d(keys, more)
        _limit(len(larger), volume.voxel)
        values, keys = _spread(volume, larger, field, report), larger
    blocks = blocks_of(keys)  # cells at a block's corner reach into all around it
    whole = keys
    for n in range(27):
        report(0.9, "closing what nobody has seen")
        whole = np.union1d(whole, keys_of(blocks + np.array((n % 3 - 1, n // 3 % 3 - 1, n // 9 - 1))))
    _limit(len(whole), volume.voxel)
    values = _spread(volume, whole, field, report)
    return Volume(whole, values, np.zeros((0, 0), np.uint8), volume.origin, volume.voxel, volume.truncation)


def _limit(count: int, voxel: float) -> None:
    if count > 2 * MOST_BLOCKS:
        raise ValueError(
            f"a voxel of {voxel:.3g} needs {count:,} blocks to close the mesh; {2 * MOST_BLOCKS:,} fit: take a "
            "larger voxel, or leave the mesh open"
        )


def places_of(keys: Array, voxel: float, layer: tuple[slice, ...] = (slice(None),) * 3) -> Array:
    """Return where voxels of blocks are, (b, ..., 3), relative to the volume's origin."""
    inside = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1)[layer]
    corner = (blocks_of(keys) * SIDE)[(slice(None), *([None] * (inside.ndim - 1)))]
    places: Array = (corner + inside) * voxel
    return places


def _crossed(volume: Volume, field: Field) -> Array:
    """Return the keys of all blocks that a cell of the field with a change of sign reaches into."""
    negative = field.values < 0
    some, every = np.zeros_like(negative[1:, 1:, 1:]), np.ones_like(negative[1:, 1:, 1:])
    for n in range(8):
        part = negative[tuple(slice(1, None) if n >> a & 1 else slice(0, -1) for a in range(3))]
        some |= part
        every &= part
    cells = np.argwhere(some & ~every)
    side = SIDE * volume.voxel
    low = field.first + cells * field.cell
    most = int(np.ceil(field.cell / side)) + 1
    found = []
    for n in range(most**3):
        step = np.array([n % most, n // most % most, n // most**2])
        block = np.floor(low / side).astype(np.int64) + step
        reaches = (block * side <= low + field.cell).all(1)
        found.append(np.unique(keys_of(block[reaches])))
    return np.unique(np.concatenate(found)) if len(cells) else np.zeros(0, np.int64)


def _spread(volume: Volume, keys: Array, field: Field, report: Report) -> Array:
    """Return values (b, 512) of the blocks of `keys`: the volume's where known, else the field's."""
    values = np.full((len(keys), SIDE**3), np.nan, np.float32)
    at = np.searchsorted(keys, volume.keys)
    values[at] = volume.values
    for start in range(0, len(keys), CHUNK):
        report(0.95, "closing what nobody has seen")
        part = values[start : start + CHUNK]
        guess = field.at(places_of(keys[start : start + CHUNK], volume.voxel)).reshape(part.shape)
        np.copyto(part, guess, where=np.isnan(part))
    return values


def _leaking(keys: Array, values: Array, voxel: float, field: Field) -> Array:
    """Return the keys of missing blocks across whose border the sign would change."""
    cubes = values.reshape(-1, SIDE, SIDE, SIDE)
    found = []
    for axis in range(3):
        for step, own, other in ((1, SIDE - 1, 0), (-1, 0, SIDE - 1)):
            way = (step * (axis == 0), step * (axis == 1), step * (axis == 2))
            alone = np.flatnonzero(neighbour(keys, way) < 0)
            if not len(alone):
                continue
            beyond = keys_of(blocks_of(keys[alone]) + np.array(way))
            layer = tuple(slice(other, other + 1) if a == axis else slice(None) for a in range(3))
            theirs = field.at(places_of(beyond, voxel, layer)) < 0
            mine = np.take(cubes[alone], [own], axis=axis + 1) < 0
            found.append(beyond[(mine != theirs).any(axis=(1, 2, 3))])
    return np.unique(np.concatenate(found)) if found else np.zeros(0, np.int64)
