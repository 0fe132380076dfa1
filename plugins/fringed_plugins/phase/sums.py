"""Sums over any number of frames of one group, four at a time: the general least squares, and streaming's memory.

Owns the loops that add; `closed_forms.fit_at` reads the result. The frames' first is subtracted from all of them (the
pivot): the squares then add up to the size of the fringes' own, not of the background's, and the residual, which is
what the fit leaves of them, loses no more than some 1e-6 of the squared modulation to rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from fringed_plugins.compiled import kept
from fringed_plugins.phase import level_kernel
from fringed_plugins.phase.closed_forms import Sums
from fringed_plugins.phase.level_kernel import BLOCK_PX, options

_ZERO = np.float32(0)


@njit(**options)
def new_sums(like: Any, count: int, normal: Any) -> Sums:
    """Return empty sums of `count` pixels; the pivot is of the type of `like`."""
    return Sums(
        np.empty(count, like.dtype), np.empty(count, np.float32), np.empty(count, np.float32),
        np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32), normal,
    )  # fmt: skip


@njit(**options)
def sums_between(sums: Sums, start: int, stop: int, normal: Any) -> Sums:
    """Return the sums of pixels `start` to `stop`, with their group's normal matrix."""
    return Sums(
        sums.pivot[start:stop], sums.light[start:stop], sums.cosine[start:stop],
        sums.sine[start:stop], sums.square[start:stop], sums.brightest[start:stop], normal,
    )  # fmt: skip


@njit(**options)
def begin_sums(first: Any, sums: Sums) -> None:
    """Set a block's sums to nothing; `first` is the block of the frame that becomes their pivot."""
    pivot, light, cosine, sine = sums.pivot, sums.light, sums.cosine, sums.sine
    square, brightest = sums.square, sums.brightest
    for x in range(first.size):
        pivot[x] = first[x]
        light[x] = _ZERO
        cosine[x] = _ZERO
        sine[x] = _ZERO
        square[x] = _ZERO
        brightest[x] = np.float32(first[x])


@njit(**options)
def fold(rows: Any, weights: Any, sums: Sums) -> None:
    """Add four frames, less the pivot, to a block's sums; `weights` (3, 4) is their part of the fit's matrix.

    What stands for no frame is the pivot's, which adds nothing.
    """
    f0, f1, f2, f3 = rows
    a0, a1, a2, a3 = weights[0, 0], weights[0, 1], weights[0, 2], weights[0, 3]
    c0, c1, c2, c3 = weights[1, 0], weights[1, 1], weights[1, 2], weights[1, 3]
    s0, s1, s2, s3 = weights[2, 0], weights[2, 1], weights[2, 2], weights[2, 3]
    pivot, light, cosine, sine = sums.pivot, sums.light, sums.cosine, sums.sine
    square, brightest = sums.square, sums.brightest
    for x in range(f0.size):
        p = np.float32(pivot[x])
        d0, d1, d2, d3 = np.float32(f0[x]) - p, np.float32(f1[x]) - p, np.float32(f2[x]) - p, np.float32(f3[x]) - p
        light[x] += a0 * d0 + a1 * d1 + a2 * d2 + a3 * d3
        cosine[x] += c0 * d0 + c1 * d1 + c2 * d2 + c3 * d3
        sine[x] += s0 * d0 + s1 * d1 + s2 * d2 + s3 * d3
        square[x] += (d0 * d0 + d1 * d1) + (d2 * d2 + d3 * d3)
        high = d0 if d0 > d1 else d1
        other = d2 if d2 > d3 else d3
        high = (high if high > other else other) + p
        brightest[x] = high if high > brightest[x] else brightest[x]


@kept(level_kernel, **options)
def fold_blocks(start: int, stop: int, frames: Any, begins: bool, weights: Any, sums: Sums) -> None:
    """Add four `frames` (4, pixels) to the sums of blocks `start` to `stop`; where it `begins`, from nothing."""
    for block in range(start, stop):
        a, b = block * BLOCK_PX, min((block + 1) * BLOCK_PX, frames.shape[1])
        here = sums_between(sums, a, b, sums.normal)
        if begins:
            begin_sums(frames[0, a:b], here)
        fold((frames[0, a:b], frames[1, a:b], frames[2, a:b], frames[3, a:b]), weights, here)
