"""A triangular mean along both axes, with running sums: its cost does not depend on its length.

Owns the loops; sums and differences run in float64, so that they do not drift over an image.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from fringed_plugins.parallel import run_rows

Float32Array = npt.NDArray[np.float32]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _down(start: int, stop: int, values: Any, length: int, out: Any) -> None:
    """Write the weighted sum over rows y - length < row < y + length, for rows `start` to `stop`."""
    height, width = values.shape
    total, before, after = np.zeros(width), np.zeros(width), np.zeros(width)
    nothing = np.zeros(width, np.float32)
    for k in range(1 - length, length + 1):
        row = start + k
        if 0 <= row < height:
            weight = float(length - abs(k))
            target = before if k <= 0 else after
            source = values[row]
            for x in range(width):
                total[x] += weight * source[x]
                target[x] += source[x]
    scale = 1.0 / (length * length)
    for y in range(start, stop):
        gone = values[y + 1 - length] if y + 1 >= length else nothing
        here = values[y + 1] if y + 1 < height else nothing
        come = values[y + 1 + length] if y + 1 + length < height else nothing
        row = out[y]
        for x in range(width):
            row[x] = np.float32(total[x] * scale)
            total[x] += after[x] - before[x]
            before[x] += np.float64(here[x]) - np.float64(gone[x])
            after[x] += np.float64(come[x]) - np.float64(here[x])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _along(start: int, stop: int, values: Any, length: int) -> None:
    """Do the same along each row, in place."""
    width = values.shape[1]
    scale = 1.0 / (length * length)
    padded = np.zeros(width + 2 * length + 1, np.float32)
    gone, here, come = padded[1:], padded[length + 1 :], padded[2 * length + 1 :]
    for y in range(start, stop):
        row = values[y]
        padded[length : length + width] = row
        total, before, after = 0.0, 0.0, 0.0
        for k in range(1, length + 1):
            after += padded[length + k]
            total += (length - k) * padded[length + k]
        before = float(padded[length])
        total += length * before
        for x in range(width):
            row[x] = np.float32(total * scale)
            total += after - before
            before += np.float64(here[x]) - np.float64(gone[x])
            after += np.float64(come[x]) - np.float64(here[x])


def triangle_mean(values: Float32Array, length: int, threads: int = 0) -> Float32Array:
    """Return `values` (height, width) under a triangle of twice `length` along both axes, zero beyond the borders.

    Examples
    --------
    >>> triangle_mean(np.eye(1, 7, 3, dtype=np.float32), 1)
    array([[0., 0., 0., 1., 0., 0., 0.]], dtype=float32)
    >>> triangle_mean(np.eye(1, 7, 3, dtype=np.float32), 2) * 4
    array([[0. , 0. , 0.5, 1. , 0.5, 0. , 0. ]], dtype=float32)
    """
    source = np.ascontiguousarray(values, np.float32).view()
    source.flags.writeable = False
    out = np.empty(source.shape, np.float32)
    run_rows(_down, len(source), source, length, out, threads=threads)
    run_rows(_along, len(source), out, length, threads=threads)
    return out
