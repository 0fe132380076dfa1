"""Sparse blocks of voxels: which ones the surface passes, and where their neighbours are.

Owns keys and their order; a block is SIDE voxels wide, its coordinates are whole numbers of blocks from an origin.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fringed_plugins.registration.meshing.distances import SIDE

Array = npt.NDArray[Any]
_BITS = 20
_HALF = 1 << (_BITS - 1)


def keys_of(blocks: Array) -> Array:
    """Return sortable keys (n,) int64 of block coordinates (n, 3), each from -2^19 to 2^19 - 1."""
    b = blocks.astype(np.int64) + _HALF
    key: Array = (b[..., 0] << 2 * _BITS) | (b[..., 1] << _BITS) | b[..., 2]
    return key


def blocks_of(keys: Array) -> Array:
    """Return the block coordinates (n, 3) of keys.

    Examples
    --------
    >>> blocks_of(keys_of(np.array([[-1, 0, 7]])))
    array([[-1,  0,  7]])
    """
    mask = (1 << _BITS) - 1
    return np.stack([keys >> 2 * _BITS, keys >> _BITS & mask, keys & mask], axis=-1) - _HALF


def touched(points: Array, voxel: float, reach: float) -> Array:
    """Return the sorted keys of all blocks within `reach` of points (n, 3), at most half a block; a little more.

    Points are first brought to cells of two voxels, of which there are far fewer.
    """
    cell = 2.0 * voxel
    cells = np.floor(points / cell).astype(np.int64)
    corner = blocks_of(np.unique(keys_of(cells))) * cell
    side = SIDE * voxel
    found = []
    axis = [np.floor((corner + off) / side).astype(np.int64) for off in (-reach, 0.5 * cell, cell + reach)]
    for x in axis:
        for y in axis:
            for z in axis:
                found.append(np.unique(keys_of(np.stack([x[:, 0], y[:, 1], z[:, 2]], axis=1))))
    return np.unique(np.concatenate(found))


def neighbour(keys: Array, step: tuple[int, int, int]) -> Array:
    """Return where in sorted `keys` each block's neighbour is, -1 where it is not."""
    wanted = keys_of(blocks_of(keys) + np.array(step))
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, at, -1)


def padded(values: Array, keys: Array, first: int, last: int) -> Array:
    """Return blocks first to last with one more layer at the far sides, (n, SIDE + 1, ...); NaN where none is."""
    chosen = keys[first:last]
    out = np.full((len(chosen), SIDE + 1, SIDE + 1, SIDE + 1), np.nan, np.float32)
    cubes = values.reshape(-1, SIDE, SIDE, SIDE)
    out[:, :SIDE, :SIDE, :SIDE] = cubes[first:last]
    coordinates = blocks_of(chosen)
    for n in range(1, 8):
        step = (n & 1, n >> 1 & 1, n >> 2 & 1)
        wanted = keys_of(coordinates + np.array(step))
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        there = np.flatnonzero(keys[at] == wanted)
        to: Any = tuple(slice(SIDE, None) if s else slice(0, SIDE) for s in step)
        of: Any = tuple(slice(0, 1) if s else slice(0, SIDE) for s in step)
        out[(there, *to)] = cubes[(at[there], *of)]
    return out
