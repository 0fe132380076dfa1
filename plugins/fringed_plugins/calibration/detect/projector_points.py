"""The projector's pixel at each point of a board: what lights it.

Owns the choice of windows, and which values cannot be: whole fringes off what their neighbours say.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fringed_plugins.calibration.detect.projector_kernel import surface_rows
from fringed_plugins.calibration.detect.smooth import grid_residuals
from fringed_plugins.parallel import run_rows

Float64Array = npt.NDArray[np.float64]

MOST_OFF_PX = 2.0  # from the smooth grid of the others: a wrong fringe order is 16 px and more
_OFF, _OFF_PX = 8.0, 0.25  # in a quiet view less: so many middle deviations, and so many pixels
_ROUGH = 8.0  # middle misfits: a window across a border of wrong orders
_HOPELESS = 30.0  # middle misfit: no deviations are wrong by that much, orders are
_NOISE = 0.6745  # the middle misfit of noise alone, in deviations


class Values(NamedTuple):
    """One coordinate at n points: `value` and `sigma` (n,) px, `gradient` (n, 2) by the camera's x and y."""

    value: Float64Array
    sigma: Float64Array
    gradient: Float64Array


def projector_at(
    px: Float64Array, radius_px: Float64Array, maps: tuple[npt.NDArray[Any], ...], *, threads: int = 0
) -> Values:
    """Return the projector's coordinate at `px` (n, 2), fitted to the pixels within `radius_px` (n,).

    `maps` are the coordinate and its deviation (height, width) in projector pixels, and the mask, 0 where kept. A
    surface of the second degree is fitted, weighted by the deviations, without what is far off it; its own deviation
    is inflated where it does not fit. NaN where fewer than 60 pixels or 60 % of them are left, and in a window that
    fits far worse than the others do.
    """
    count = len(px)
    out = (np.empty(count), np.empty(count), np.empty((count, 2)), np.empty(count))
    at = np.column_stack([px, radius_px]).astype(np.float64)
    kept = tuple(np.ascontiguousarray(part) for part in maps)
    run_rows(surface_rows, count, kept, at, out, threads=threads)
    fits = out[3][np.isfinite(out[3])]
    if len(fits):
        rough = out[3] > min(_ROUGH * max(float(np.median(fits)), _NOISE), _HOPELESS)
        for part in out[:3]:
            part[rough] = np.nan
    return Values(out[0], out[1], out[2])


def wrong_orders(board: Float64Array, columns: Float64Array, rows: Float64Array) -> npt.NDArray[np.bool_]:
    """Return the points (n,) of a flat `board` (n, 2) whose projector pixel is off the smooth grid of the others."""
    known = np.isfinite(columns) & np.isfinite(rows)
    wrong = np.zeros(len(board), bool)
    if known.sum() >= 8:
        residual = grid_residuals(board[known], np.stack([columns[known], rows[known]], -1))
        off = np.abs(residual).max(axis=1)
        if np.isfinite(off).all():
            wrong[np.flatnonzero(known)] = off > min(MOST_OFF_PX, _OFF * float(np.median(off)) + _OFF_PX)
    return wrong
